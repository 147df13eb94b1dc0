"""Widens a time range by the nearest rows on both sides of it."""

from __future__ import annotations

import math

from .. import clock
from . import topic_rows
from .stored_topic import StoredTopic
from .time_order import TOLERANCE_NS


def widen(topic: StoredTopic, low: float, high: float) -> tuple[float, float]:
    """Return a time range that holds a topic's last row before another one too, and its first row after it.

    Looks at indexes only. A side without such a row is unbounded.

    Args:
        topic: Which one.
        low: First time stamp, in s.
        high: Last time stamp, in s.
    """
    start_ns, end_ns = topic_rows.to_ns_range(low, high)  # wider by what a row's double and its log time may differ
    before = topic.last_ns(start_ns - TOLERANCE_NS) if start_ns >= TOLERANCE_NS else None
    after = topic.first_ns(end_ns + TOLERANCE_NS) if end_ns >= 0 else None
    return (
        -math.inf if before is None else clock.to_seconds(max(before - TOLERANCE_NS, 0)),
        math.inf if after is None else clock.to_seconds(after + TOLERANCE_NS),
    )
