"""Where rows lie that are asked for by their number."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .. import clock
from ..codecs.decode import Row
from ..mcap.file_index import replanned
from . import counts, plan, topic_rows
from .file import File
from .time_order import TOLERANCE_NS

_WORTH_ROWS = 1000
"""So many rows are skipped faster than looked up."""


class Place(NamedTuple):
    """A time range in which rows that were asked for lie."""

    low: float
    """First time stamp, in s."""
    high: float
    """Last time stamp, included, in s."""
    skip: int
    """How many rows at its beginning are not meant."""


def find(files: Sequence[File], topic: str, low: float, high: float, start: int, limit: int | None) -> Place:
    """Return where `limit` rows from number `start` on lie; looks at message indexes, not into chunks.

    Args:
        files: In the order of writing.
        topic: Its name.
        low: First time stamp of the range in which rows are counted, in s.
        high: Last time stamp, included, in s.
        start: Number of the first row wanted, from 0.
        limit: How many; None for all.
    """
    stop = math.inf if limit is None else start + limit
    if low > -math.inf or (start < _WORTH_ROWS and stop == math.inf):
        return Place(low, high, start)
    times = np.sort(counts.times(files, topic, *topic_rows.to_ns_range(low, high)))
    if len(times) < _WORTH_ROWS or bool((np.diff(times) == 0).any()):  # rows may merge: numbers and messages differ
        return Place(low, high, start)
    apart = np.flatnonzero(np.diff(times) > np.uint64(2 * TOLERANCE_NS)) + 1
    first, last = np.searchsorted(apart, start, side="right"), np.searchsorted(apart, stop)
    begin = int(apart[first - 1]) if first else 0
    end = int(apart[last]) if last < len(apart) else None
    from_s = clock.to_seconds(int(times[begin]) - TOLERANCE_NS) if begin else low
    to_s = high if end is None else min(high, clock.to_seconds(int(times[end]) - TOLERANCE_NS))
    return Place(from_s, to_s, start - begin)


def last_at(files: Sequence[File], topic: str, time: float) -> Row | None:
    """Return the last row at or before a time, in s, or None; looks into the one chunk that holds it."""
    _, end_ns = topic_rows.to_ns_range(-math.inf, time)
    while end_ns >= 0:
        latest = last_ns(files, topic, end_ns)
        if latest is None:
            return None
        found = list(topic_rows.read(files, topic, clock.to_seconds(max(latest - TOLERANCE_NS, 0)), time))
        if found:
            return found[-1]
        end_ns = latest - 1  # its double lies behind, although its nanosecond does not
    return None


@replanned
def last_ns(files: Sequence[File], topic: str, end_ns: int) -> int | None:
    """Return the latest log time of a topic up to one, in ns."""
    indexes = [file.index for file in files]
    located = plan.chunks(indexes, [index.channels_of(topic) for index in indexes], 0, end_ns)
    last: int | None = None
    for one in sorted(located, key=lambda one: one.chunk.end_ns, reverse=True):
        if last is not None and one.chunk.end_ns < last:
            break
        times = counts.times_in(files[one.file], topic, one)
        times = times[times <= np.uint64(end_ns)]
        if len(times):
            last = int(times.max()) if last is None else max(last, int(times.max()))
    return last
