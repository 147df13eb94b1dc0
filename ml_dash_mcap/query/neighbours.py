"""The rows of a time range and the nearest ones on both sides of it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from .. import clock
from ..mcap.file_index import replanned
from . import counts, plan, row_positions, topic_rows
from .file import File
from .time_order import TOLERANCE_NS


def widen(files: Sequence[File], topic: str, low: float, high: float) -> tuple[float, float]:
    """Return a time range that holds a topic's last row before another one too, and its first row after it.

    Looks at indexes only. A side without such a row is unbounded.

    Args:
        files: In the order of writing.
        topic: Its name.
        low: First time stamp, in s.
        high: Last time stamp, in s.
    """
    start_ns, end_ns = topic_rows.to_ns_range(low, high)  # wider by what a row's double and its log time may differ
    before = row_positions.last_ns(files, topic, start_ns - TOLERANCE_NS) if start_ns >= TOLERANCE_NS else None
    after = _first_ns(files, topic, end_ns + TOLERANCE_NS) if end_ns >= 0 else None
    return (
        -math.inf if before is None else clock.to_seconds(max(before - TOLERANCE_NS, 0)),
        math.inf if after is None else clock.to_seconds(after + TOLERANCE_NS),
    )


@replanned
def _first_ns(files: Sequence[File], topic: str, start_ns: int) -> int | None:
    """Return the earliest log time of a topic from one on, in ns."""
    indexes = [file.index for file in files]
    located = plan.chunks(indexes, [index.channels_of(topic) for index in indexes], start_ns, topic_rows.LAST_NS)
    first: int | None = None
    for one in located:
        if first is not None and one.chunk.start_ns > first:
            break
        times = counts.times_in(files[one.file], topic, one)
        times = times[times >= min(start_ns, topic_rows.LAST_NS)]
        if len(times):
            first = int(times.min()) if first is None else min(first, int(times.min()))
    return first
