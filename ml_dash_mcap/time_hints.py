"""Hints for callers who gave a time of another kind where seconds are wanted."""

from __future__ import annotations

import datetime
import time
from typing import Any

_FIRST_IN_NS = 1e17
_FIRST_IN_US = 1e14
"""Times since 1970 in nanoseconds, and in microseconds, are larger than this from 1973 on."""


def seconds_hint(given: Any, name: str = "_ts") -> str:
    """Return how to make seconds of a value, as the end of an error message; empty for values that are no times.

    Args:
        given: A date, a duration, a time of NumPy, pandas, ROS or protobuf, text, or anything else.
        name: The name of the argument or field that takes the seconds.

    Example:
        >>> seconds_hint(datetime.datetime.now())
        '; pass seconds: _ts=when.timestamp()'
    """
    spelling = _spelling(given)
    return f"; pass seconds: {name}={spelling}" if spelling else ""


def unit_hint(number: float, name: str = "_ts") -> str:
    """Return how to make seconds of a number of nanoseconds, microseconds or milliseconds since 1970."""
    if number >= _FIRST_IN_NS:
        return f"; it looks like nanoseconds: pass {name}=ns / 10**9"
    if number >= _FIRST_IN_US:
        return f"; it looks like microseconds: pass {name}=us / 10**6"
    return f"; it looks like milliseconds: pass {name}=ms / 1000"


def _spelling(given: Any) -> str:
    if isinstance(given, datetime.datetime):  # pandas.Timestamp is one
        return "when.timestamp()"
    if isinstance(given, datetime.date):
        return "datetime.combine(day, time()).timestamp()"
    if isinstance(given, datetime.timedelta):
        return "duration.total_seconds()"
    if isinstance(given, time.struct_time):
        return "calendar.timegm(when), or time.mktime(when) for local time"
    if isinstance(given, str):
        return "datetime.fromisoformat(text).timestamp()" if _is_iso(given) else ""
    kind = getattr(getattr(given, "dtype", None), "kind", "")
    if kind == "M":
        if getattr(given, "ndim", 0):
            return "ns // 10**9 + ns % 10**9 / 1e9 with ns = when.astype('datetime64[ns]').astype('int64')"
        return "when.astype('datetime64[ns]').item() / 10**9"  # of two integers, which is rounded once
    if kind == "m":
        return "duration / numpy.timedelta64(1, 's')"
    return _spelling_by_attributes(given)


def _spelling_by_attributes(given: Any) -> str:
    """Return the hint for times of packages that are not imported here. Their attributes tell them."""
    for names, spelling in _ATTRIBUTES:
        if all(hasattr(given, name) for name in names):
            return spelling
        if isinstance(given, dict) and given.keys() >= set(names):
            inside = spelling
            for name in names:
                inside = inside.replace(f".{name}", f"[{name!r}]")
            return inside
    return ""


_ATTRIBUTES = (
    (("to_sec",), "stamp.to_sec()"),  # rospy.Time, and genpy's
    (("sec", "nanosec"), "stamp.sec + stamp.nanosec / 1e9"),  # builtin_interfaces/Time
    (("secs", "nsecs"), "stamp.secs + stamp.nsecs / 1e9"),  # a ROS 1 time as others spell it
    (("sec", "nsec"), "stamp.sec + stamp.nsec / 1e9"),  # foxglove's
    (("seconds", "nanos"), "stamp.seconds + stamp.nanos / 1e9"),  # google.protobuf.Timestamp
    (("nanoseconds", "seconds_nanoseconds"), "stamp.nanoseconds / 10**9"),  # rclpy.time.Time
)


def _is_iso(text: str) -> bool:
    """Whether a text is a date of ISO 8601, or begins like one (Python 3.10 reads no `Z`)."""
    try:
        datetime.date.fromisoformat(text[:10])
    except ValueError:
        return False
    return True
