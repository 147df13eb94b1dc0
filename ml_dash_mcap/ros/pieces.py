"""The parts of ROS messages whose length each message says itself, in both wire formats."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from struct import Struct
from typing import Any

import numpy as np

_UnpackFrom = Callable[[bytes, int], tuple[Any, ...]]


def octets(data: bytes, at: int, count: int) -> bytes:
    """Read bytes."""
    end = at + count
    if end > len(data):
        raise _too_long(data, at, count)
    return data[at:end]


def text_packed(data: bytes, at: int, count: int) -> str:
    """Read a text of ROS 1, behind its length."""
    end = at + count
    if end > len(data):
        raise _too_long(data, at, count)
    return data[at:end].decode()


def text_aligned(data: bytes, at: int, count: int) -> str:
    """Read a text of CDR, behind its length: its last byte is a zero. Some writers send an empty one as no bytes."""
    if not count:
        return ""
    end = at + count
    if end > len(data):
        raise _too_long(data, at, count)
    if data[end - 1]:
        raise ValueError(f"the text at byte {at} does not end with a zero")
    return data[at : end - 1].decode()


def elements(read: Callable[[bytes, int], tuple[Any, int]], data: bytes, at: int, count: int) -> tuple[list[Any], int]:
    """Read values one by one; returns them and the place behind them."""
    found = []
    for _ in range(count):
        value, at = read(data, at)
        found.append(value)
    return found, at


def _texts_packed(data: bytes, at: int, count: int) -> tuple[list[str], int]:
    found = []
    for _ in range(count):
        (length,) = _LITTLE(data, at)
        at += 4
        found.append(text_packed(data, at, length))
        at += length
    return found, at


def _texts_aligned(unpack: _UnpackFrom) -> Callable[[bytes, int, int], tuple[list[str], int]]:
    def texts(data: bytes, at: int, count: int) -> tuple[list[str], int]:
        found, size = [], len(data)
        for _ in range(count):
            start = (at + 3 & -4) + 4
            (length,) = unpack(data, start - 4)
            at = start + length
            if at > size or (length and data[at - 1]):
                text_aligned(data, start, length)  # which says what is wrong
            found.append(data[start : at - 1].decode())
        return found, at

    return texts


def _too_long(data: bytes, at: int, count: int) -> ValueError:
    return ValueError(f"it says that {count} bytes follow byte {at}, and {max(0, len(data) - at)} do")


_LITTLE = Struct("<I").unpack_from
_SHARED = {"octets": octets, "elements": elements, "numbers": np.frombuffer}

PIECES: Mapping[tuple[str, bool], Mapping[str, Any]] = {
    ("<", False): {**_SHARED, "text": text_packed, "texts": _texts_packed},
    ("<", True): {**_SHARED, "text": text_aligned, "texts": _texts_aligned(_LITTLE)},
    (">", True): {**_SHARED, "text": text_aligned, "texts": _texts_aligned(Struct(">I").unpack_from)},
}
"""Byte order, and whether numbers are aligned, to what reads the pieces."""
