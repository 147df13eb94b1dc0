"""A topic of messages of a bag that become rows."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ... import clock
from ...rows.plain_row import TIME_KEY
from ...topic import Topic


class MessageTopic(Topic):
    """A topic of messages from other software: each stays a row of its own, at its time to the nanosecond."""

    __slots__ = ()

    def append_at(self, rows: Iterable[dict[str, Any]], times_ns: Iterable[int]) -> None:
        """Take rows whose times are known in nanoseconds.

        Args:
            rows: Their fields. A `_ts` in them stays as it is; rows without it get one from their time.
            times_ns: The time of each, ns.
        """
        for row, time_ns in zip(rows, times_ns, strict=True):
            time_s = row.pop(TIME_KEY, None)
            time_s = time_s if isinstance(time_s, float) else clock.to_seconds(time_ns)
            self._put(self._encode(row, time_s, time_ns=time_ns), time_s)
