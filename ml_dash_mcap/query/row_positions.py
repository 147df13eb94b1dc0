"""Finds the time range in which the rows with some numbers lie."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .. import clock
from ..codecs.encoded_channel import Row
from . import topic_rows
from .stored_topic import StoredTopic
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


def find(topic: StoredTopic, low: float, high: float, start: int, limit: int | None) -> Place:
    """Return where `limit` rows from number `start` on lie; looks at message indexes, not into chunks.

    Args:
        topic: Which one.
        low: First time stamp of the range in which rows are counted, in s.
        high: Last time stamp, included, in s.
        start: Number of the first row wanted, from 0.
        limit: How many; None for all.
    """
    stop = math.inf if limit is None else start + limit
    if low > -math.inf or (start < _WORTH_ROWS and stop == math.inf):
        return Place(low, high, start)
    times = np.sort(topic.times(*topic_rows.to_ns_range(low, high)))
    if len(times) < _WORTH_ROWS or bool((np.diff(times) == 0).any()):  # rows may merge: numbers and messages differ
        return Place(low, high, start)
    # A range in seconds can be cut only where neighbours lie further apart than a double and its log time can.
    apart = np.flatnonzero(np.diff(times) > np.uint64(2 * TOLERANCE_NS)) + 1
    first, last = np.searchsorted(apart, start, side="right"), np.searchsorted(apart, stop)
    begin = int(apart[first - 1]) if first else 0
    end = int(apart[last]) if last < len(apart) else None
    from_s = clock.to_seconds(int(times[begin]) - TOLERANCE_NS) if begin else low
    to_s = high if end is None else min(high, clock.to_seconds(int(times[end]) - TOLERANCE_NS))
    return Place(from_s, to_s, start - begin)


def last_at(topic: StoredTopic, time: float) -> Row | None:
    """Return the last row at or before a time, in s, or None; looks into the one chunk that holds it."""
    _, end_ns = topic_rows.to_ns_range(-math.inf, time)
    while end_ns >= 0:
        latest = topic.last_ns(end_ns)
        if latest is None:
            return None
        rows = list(topic_rows.read(topic, clock.to_seconds(max(latest - TOLERANCE_NS, 0)), time))
        if rows:
            return rows[-1]
        end_ns = latest - 1  # its double lies after `time`, although its nanosecond does not
    return None
