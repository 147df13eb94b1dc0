"""The rules for a row's time stamp, one for each of the two APIs."""

from __future__ import annotations

import math
import time
from typing import Any, Protocol

from . import clock
from .errors import OptionError, TimestampError
from .time_hints import seconds_hint, unit_hint

MISSING: Any = type("Missing", (), {"__repr__": lambda self: "<left out>", "__slots__": ()})()
"""Stands for an argument that was not given, such as a `_ts`."""

INHERIT = -1
"""As `_ts`: take the last time stamp used, where the rule allows it."""

# A wall clock in doubles has steps of 0.24 us today, so a microsecond later is always another time stamp.
_TICK_S = 1e-6


class LastUsed(Protocol):
    """An object that holds the last time stamp that was used."""

    lock: Any
    last_s: float | None


class Stamper(Protocol):
    """The rule of one recorder."""

    journal: LastUsed

    def resolve(self, given: Any, topic: str, last_s: float | None = None) -> float:
        """Return the time stamp to use, in seconds, for what was given as `_ts`.

        Args:
            given: What the caller passed as `_ts`.
            topic: For the error messages.
            last_s: The last one used, if it is not the journal's yet.
        """


def stamper(rule: str) -> Stamper:
    """Return the rule of a name, "strict" or "auto".

    Raises:
        OptionError: There is no such rule.
    """
    if rule == "strict":
        return Strict()
    if rule == "auto":
        return Automatic()
    raise OptionError(f"timestamps={rule!r}: it must be 'strict' or 'auto'")


class Strict:
    """ml-dash's rule: every row has its own time stamp."""

    journal: LastUsed

    def resolve(self, given: Any, topic: str, last_s: float | None = None) -> float:
        """Return the time stamp to use, in seconds.

        Raises:
            TimestampError: It is missing, not a number, not finite, negative or too large.
        """
        if given is MISSING:
            raise TimestampError(
                f"Timestamp '_ts' is required for track.append() (topic {topic!r}): pass _ts=<seconds>, or open the"
                ' recording with timestamps="auto"'
            )
        if isinstance(given, str):
            try:
                given = float(given)
            except ValueError as error:
                raise _not_numeric(given, topic) from error
        seconds = _to_float(given)
        if seconds is None:
            raise _not_numeric(given, topic)
        if seconds == INHERIT:
            raise TimestampError(
                f'append() on topic {topic!r}: _ts=-1 inherits the last time stamp only with timestamps="auto";'
                ' pass the time in seconds, or open the recording with timestamps="auto"'
            )
        return _in_range(seconds, topic)


class Automatic:
    """dreamlake's rule: a missing time stamp is the wall clock, -1 the last one used on any topic by any thread."""

    journal: LastUsed

    def __init__(self) -> None:
        self._last_automatic = 0.0

    def resolve(self, given: Any, topic: str, last_s: float | None = None) -> float:
        """Return the time stamp to use, in seconds.

        Raises:
            TimestampError: It is not a number, not finite, negative (but not -1) or too large.
        """
        if given is MISSING or given is None:
            return self._automatic()
        seconds = None if isinstance(given, str) else _to_float(given)
        if seconds is None:
            raise TimestampError(
                f"_ts must be a number (seconds since epoch), got {type(given).__name__} {given!r} on topic {topic!r}"
                f"{_hint(given)}"
            )
        if seconds == INHERIT:
            if last_s is None:
                last_s = self.journal.last_s
            return self._automatic() if last_s is None else last_s
        return _in_range(seconds, topic)

    def _automatic(self) -> float:
        """Return the wall clock, moved on where it is not later than last time."""
        with self.journal.lock:
            now = time.time()
            if now <= self._last_automatic:
                # Rows of one time stamp merge, so two rows that came without one must not get the same.
                now = self._last_automatic + _TICK_S
            self._last_automatic = now
            return now


def _to_float(given: Any) -> float | None:
    """Return a number as a float; None for a value that is no number (a bool counts as a mistake)."""
    if isinstance(given, (bool, str, bytes)) or given is None:
        return None
    # `float()` would also take an array of one element, and a datetime64 as its number of units.
    if getattr(getattr(given, "dtype", None), "kind", "f") not in "fiu" or getattr(given, "ndim", 0) != 0:
        return None
    try:
        return float(given)
    except (TypeError, ValueError):
        return None
    except OverflowError:
        return math.inf


def _in_range(seconds: float, topic: str) -> float:
    if not math.isfinite(seconds):
        raise TimestampError(f"append() on topic {topic!r}: _ts={seconds!r} is not a finite number of seconds")
    if seconds < 0:
        raise TimestampError(f"append() on topic {topic!r}: _ts={seconds!r} is negative; MCAP times start at 0")
    if seconds >= clock.END_S:
        raise TimestampError(
            f"append() on topic {topic!r}: _ts={seconds!r} is beyond the year 2262, where nanoseconds end"
            f"{unit_hint(seconds)}"
        )
    return seconds + 0.0  # -0.0 becomes 0.0


def _not_numeric(given: Any, topic: str) -> TimestampError:
    return TimestampError(
        f"Timestamp '_ts' must be numeric, got: {type(given)} ({given!r} on topic {topic!r}){_hint(given)}"
    )


def _hint(given: Any) -> str:
    """Return what to pass instead of a time that is no number."""
    if getattr(given, "ndim", 0) or isinstance(given, (list, tuple)):
        return "; append takes one row, append_columns many"
    return seconds_hint(given) or "; pass a number of seconds, such as time.time()"
