"""Functions that read texts and lists, whose length stands before them, out of a message in either wire format."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from struct import Struct
from typing import Any

import numpy as np

from .wire import Wire

_UnpackFrom = Callable[[bytes, int], tuple[Any, ...]]


def octets(data: bytes, at: int, count: int) -> bytes:
    """Read bytes."""
    end = at + count
    if end > len(data):
        raise _too_long(data, at, count)
    return data[at:end]


def _text_packed(errors: str) -> Callable[[bytes, int, int], str]:
    def text(data: bytes, at: int, count: int) -> str:
        """Read a text of ROS 1, behind its length."""
        end = at + count
        if end > len(data):
            raise _too_long(data, at, count)
        return data[at:end].decode("utf-8", errors)

    return text


def _text_aligned(errors: str) -> Callable[[bytes, int, int], str]:
    def text(data: bytes, at: int, count: int) -> str:
        """Read a text of CDR, behind its length: its last byte is a zero. Some send an empty one as no bytes."""
        if not count:
            return ""
        end = at + count
        if end > len(data):
            raise _too_long(data, at, count)
        if data[end - 1]:
            raise ValueError(f"the text at byte {at} does not end with a zero")
        return data[at : end - 1].decode("utf-8", errors)

    return text


def elements(read: Callable[[bytes, int], tuple[Any, int]], data: bytes, at: int, count: int) -> tuple[list[Any], int]:
    """Read values one after the other; returns them and the place behind the last."""
    values = []
    for _ in range(count):
        value, at = read(data, at)
        values.append(value)
    return values, at


def nothings(
    read: Callable[[bytes, int], tuple[Any, int]], weight: int, data: bytes, at: int, count: int
) -> tuple[list[Any], int]:
    """Read values that take no bytes.

    Their number is limited, because a message of a few bytes could claim billions.
    """
    if count * weight > MOST_NOTHINGS:
        raise ValueError(f"a list of {count} values that take no bytes; {MOST_NOTHINGS // weight} at most are read")
    return elements(read, data, at, count)


def divided(values: list[Any], lengths: tuple[int, ...]) -> list[Any]:
    """Return values as lists of lists, the innermost with so many as the last of `lengths`."""
    for length in reversed(lengths):
        values = [values[at : at + length] for at in range(0, len(values), length)] if length else []
    return values


def wrong_size(at: int, end: int) -> None:
    """Raise an error for a value that does not end where its size says that it ends."""
    raise ValueError(f"a value ends at byte {at}, and it says that it ends at byte {end}")


def _texts_packed(errors: str) -> Callable[[bytes, int, int], tuple[list[str], int]]:
    text = _text_packed(errors)

    def texts(data: bytes, at: int, count: int) -> tuple[list[str], int]:
        values = []
        for _ in range(count):
            (length,) = _LITTLE(data, at)
            at += 4
            values.append(text(data, at, length))
            at += length
        return values, at

    return texts


def _texts_aligned(unpack: _UnpackFrom, errors: str) -> Callable[[bytes, int, int], tuple[list[str], int]]:
    text = _text_aligned(errors)

    def texts(data: bytes, at: int, count: int) -> tuple[list[str], int]:
        values, size = [], len(data)
        for _ in range(count):
            start = (at + 3 & -4) + 4
            (length,) = unpack(data, start - 4)
            at = start + length
            if at > size or (length and data[at - 1]):
                text(data, start, length)  # raises the error that names the fault
            # An empty text that was sent as no bytes ends before it starts, so the slice is empty, as it should be.
            values.append(data[start : at - 1].decode("utf-8", errors))
        return values, at

    return texts


def _too_long(data: bytes, at: int, count: int) -> ValueError:
    return ValueError(f"it says that {count} bytes follow byte {at}, and {max(0, len(data) - at)} do")


_LITTLE = Struct("<I").unpack_from
_BIG = Struct(">I").unpack_from

MOST_NOTHINGS = 256
"""How many values that take no bytes a list may have."""

_SHARED = {
    "divided": divided,
    "octets": octets,
    "elements": elements,
    "nothings": nothings,
    "numbers": np.frombuffer,
    "wrong_size": wrong_size,
}


def pieces(wire: Wire, *, replaces: bool) -> Mapping[str, Any]:
    """Return what reads the pieces.

    Args:
        wire: What the bytes are in.
        replaces: Whether a text that is no UTF-8 gets U+FFFD for what is wrong, as ROS 1's Python has it, instead of a
            `UnicodeDecodeError`.
    """
    errors = "replace" if replaces else "strict"
    if not wire.is_cdr:
        return {**_SHARED, "text": _text_packed(errors), "texts": _texts_packed(errors)}
    unpack = _LITTLE if wire.order == "<" else _BIG
    return {**_SHARED, "text": _text_aligned(errors), "texts": _texts_aligned(unpack, errors)}
