"""Spells numbers of rows and times as text, for people who read a check."""

from __future__ import annotations


def rows_text(count: int) -> str:
    """Return a number of rows in words."""
    return f"{count} row{'' if count == 1 else 's'}"


def seconds_text(seconds: float) -> str:
    """Return a time or a duration in words, to the microsecond."""
    return f"{seconds:.6f}".rstrip("0").rstrip(".") + " s"


def brief_duration(seconds: float) -> str:
    """Return a duration in words, to three digits."""
    for size, unit in ((1.0, "s"), (1e-3, "ms"), (1e-6, "us")):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"
