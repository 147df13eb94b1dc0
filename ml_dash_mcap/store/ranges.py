"""Ranges of bytes that are read together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from .store import ByteRange


def coalesced(ranges: Iterable[ByteRange], gap_bytes: int) -> list[ByteRange]:
    """Return the ranges that hold all of some ranges, sorted: neighbours at most `gap_bytes` apart become one.

    Empty ranges are left out.
    """
    joined: list[ByteRange] = []
    for start, end in sorted(range_ for range_ in ranges if range_[0] < range_[1]):
        if joined and start - joined[-1][1] <= gap_bytes:
            joined[-1] = (joined[-1][0], max(joined[-1][1], end))
        else:
            joined.append((start, end))
    return joined


def cut(parts: Mapping[ByteRange, bytes], start: int, end: int) -> bytes:
    """Return the bytes of [start, end), which is empty or lies in one of the ranges that were read."""
    if start >= end:
        return b""
    low, data = next((low, data) for (low, high), data in parts.items() if low <= start and end <= high)
    return data[start - low : end - low]
