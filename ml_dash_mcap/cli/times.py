"""Times and sizes as people write and read them."""

from __future__ import annotations

import argparse
import re
from datetime import datetime, timedelta, timezone

from .. import clock

HELP = "in seconds, or as ISO 8601 (UTC if it names no zone)"

_FRACTION = re.compile(r"\.(\d+)")
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
_UNITS = ("kB", "MB", "GB", "TB")


def parse(text: str) -> float:
    """Return a time in seconds.

    Args:
        text: Seconds, such as "12.5", or ISO 8601, such as "2026-11-22T03:41:23.5Z".

    Raises:
        argparse.ArgumentTypeError: It is neither.
    """
    try:
        return float(text)
    except ValueError:
        pass
    six_digits = _FRACTION.sub(lambda match: f".{match[1][:6]:<06}", text.strip())  # all that Python 3.10 reads
    try:
        moment = datetime.fromisoformat(re.sub("[zZ]$", "+00:00", six_digits))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is neither a number of seconds nor a time in ISO 8601") from None
    return (moment if moment.tzinfo else moment.replace(tzinfo=timezone.utc)).timestamp()


def show(seconds: float | None) -> str:
    """Say a time: wall-clock time as ISO 8601 in UTC, to milliseconds, another one in seconds."""
    if seconds is None:
        return "-"
    if not clock.is_epoch_like(seconds):
        return f"{seconds:.3f} s"
    try:
        # Not `fromtimestamp`, which fails for years that the C library of some systems does not know.
        moment = _EPOCH + timedelta(milliseconds=round(seconds * 1000))
    except OverflowError:  # a clock that says a year beyond 9999
        return f"{seconds:.3f} s"
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def show_duration(seconds: float) -> str:
    """Say a duration: "0.500 s", "5 min 12.0 s", "2 h 03 min"."""
    if seconds < 60:
        return f"{seconds:.3f} s"
    minutes, rest = divmod(seconds, 60)
    if minutes < 60:
        return f"{minutes:.0f} min {rest:04.1f} s"
    return f"{minutes // 60:.0f} h {minutes % 60:02.0f} min"


def show_size(count: int) -> str:
    """Say a number of bytes: "512 B", "1.5 MB" (of 10**6 bytes)."""
    size, unit = float(count), "B"
    for larger in _UNITS:
        if size < 1000:
            break
        size, unit = size / 1000, larger
    return f"{size:.0f} B" if unit == "B" else f"{size:.1f} {unit}"
