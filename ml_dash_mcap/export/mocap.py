"""Rows as the motion capture dict of ml-dash."""

from __future__ import annotations

from itertools import pairwise
from statistics import median
from typing import Any

from ..read import topics
from .selection import Selection

VERSION = "1.0"
TIME_NAME = "time"


def render(selection: Selection) -> dict[str, Any]:
    """Return `{"version", "metadata", "channels", "frames"}`, a frame being `{"time": s, "q": ...}`.

    A field that is itself called `time` is `fields.time` here.
    """
    frames = list(selection.flat_rows(TIME_NAME))
    times = [frame[TIME_NAME] for frame in frames]
    channels = {name for frame in frames for name in frame} - {TIME_NAME}
    description, tags, _ = topics.describe(selection.files, selection.topic)
    return {
        "version": VERSION,
        "metadata": {
            "topic": selection.topic,
            "description": description,
            "tags": list(tags),
            "fps": frame_rate(times),
            "duration": times[-1] - times[0] if times else 0.0,
            "frameCount": len(frames),
            "startTime": times[0] if times else 0.0,
            "endTime": times[-1] if times else 0.0,
        },
        "channels": sorted(channels),
        "frames": frames,
    }


def frame_rate(times: list[float]) -> float:
    """Return one over the median distance of frames, in Hz; 0.0 where there is none.

    Args:
        times: Of the frames, ascending, in s.
    """
    distances = [later - earlier for earlier, later in pairwise(times)]
    typical = median(distances) if distances else 0.0
    return 1 / typical if typical > 0 else 0.0
