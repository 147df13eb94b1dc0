"""Renders rows as the motion capture dict of ml-dash."""

from __future__ import annotations

import numpy as np

from ... import clock
from ...inspect import topics
from ...query.topic_part import TopicPart
from ...rows.result_dicts import Take
from .frame_numbers import mean_rate, spacing

VERSION = "1.0"
TIME_NAME = "time"


def render(part: TopicPart) -> Take:
    """Return `{"version", "metadata", "channels", "frames"}`, a frame being `{"time": s, "q": ...}`.

    A field that is itself called `time` is `fields.time` here.
    """
    frames = list(part.flat_rows(TIME_NAME))
    times = [frame[TIME_NAME] for frame in frames]
    channels = {name for frame in frames for name in frame} - {TIME_NAME}
    description, tags, _ = topics.describe(part.stored)
    return {
        "version": VERSION,
        "metadata": {
            "topic": part.topic,
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
    """Return the rate over all frames if they are evenly spaced, else one over their median distance, in Hz.

    Args:
        times: Of the frames, ascending, in s. 0.0 is returned for fewer than two.
    """
    times_ns = np.unique(clock.to_nanoseconds_each(np.array(times, np.float64))).astype(np.int64)
    distances = spacing(times_ns)
    if distances.frames is not None:
        return mean_rate(times_ns, distances.frames)
    return clock.NS_PER_S / float(np.median(np.diff(times_ns)))
