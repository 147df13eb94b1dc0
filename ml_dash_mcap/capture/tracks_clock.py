"""Tells, while rows come in, whether the tracks' time stamps are those of the wall clock."""

from __future__ import annotations

import time
from collections.abc import Callable

NOW_S = 5.0
"""Time stamps this close to the wall clock are taken for it, in seconds. GPS time is 18 s ahead of it, TAI 37 s."""

_STAYS_S = 10.0
"""After a row whose time is now, the tracks count as on the wall clock for so long, in seconds. Rows that are delivered
late, and rows of a topic on another clock, do not change that."""


class TracksClock:
    """Compares the latest time stamp of a track with the wall clock, each time somebody looks.

    A time stamp that was not there at the last look was given since then. So it is a time of now if it lies between
    that look and this look, to within `NOW_S`. Without a new time stamp the answer stays, for a robot may stand still
    for hours.

    Any thread may call `look` and `time`. `append` does not, so nothing is measured on its way; the writer thread looks
    at each of its ticks.
    """

    __slots__ = ("_is_now", "_last_look", "_seen_now_s", "_wall")

    def __init__(self, wall: Callable[[], float] = time.time) -> None:
        """Begin with no time stamp.

        Args:
            wall: The wall clock, in seconds.
        """
        self._wall = wall
        # One tuple, so that a thread never reads the moment of one look and the time stamp of another.
        self._last_look: tuple[float, float | None] = (wall(), None)
        """When somebody looked, and the latest time stamp then, both in seconds."""
        self._is_now = True
        self._seen_now_s = float("-inf")

    def look(self, last_s: float | None) -> float:
        """Look at the latest time stamp of a track, in seconds; returns the wall clock's time."""
        now_s = self._wall()
        since_s, before_s = self._last_look
        self._last_look = (now_s, last_s)
        if last_s is None or last_s == before_s:
            return now_s
        if min(since_s, now_s) - NOW_S <= last_s <= max(since_s, now_s) + NOW_S:  # the wall clock may be set back
            self._is_now = True
            self._seen_now_s = now_s
        else:
            self._is_now = abs(now_s - self._seen_now_s) < _STAYS_S
        return now_s

    def time(self, last_s: float | None) -> tuple[float, bool]:
        """Return the tracks' time now, in seconds, and whether it is the wall clock's.

        It is the wall clock's where the tracks have it, or have no row yet. On any other clock (of a simulation, of a
        recording that is played back, GPS time, a monotonic one) it is the latest time stamp of a track: how fast such
        a clock goes on, and whether it does, only its rows tell.

        Args:
            last_s: The latest time stamp of a track, in seconds.
        """
        now_s = self.look(last_s)
        return (now_s, True) if last_s is None or self._is_now else (last_s, False)
