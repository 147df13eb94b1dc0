"""Finds and counts bytes in large arrays of bytes, in pieces that the processor's cache holds."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import numpy.typing as npt

Bytes = npt.NDArray[np.uint8]
Places = npt.NDArray[np.int32]
"""Places in less than 2 GiB; with eight bytes for each, all that is done with them would take longer."""
Marks = npt.NDArray[np.bool_]

_PIECE_BYTES = 256 * 1024
"""Larger temporary arrays are slower than the work on them: the system has to provide their memory each time."""

_LOWER = np.uint8(0x20)
"""The bit in which small letters differ from capitals, and braces from brackets."""

_COUNT = np.array([bin(byte).count("1") for byte in range(256)], np.uint8)
_FIRST = np.array([8 - byte.bit_length() for byte in range(256)], np.uint8)
"""How many bits of a byte are set, and which is the first of them."""


def places(data: Bytes, letter: int) -> Places:
    """Return where in some data a byte is."""
    parts = [_places(part == letter, start) for start, part in _pieces(data)]
    return _joined(parts)


def _places(marks: Marks, start: int) -> Places:
    # Twice as fast as `flatnonzero` where the marks are not next to each other, as commas behind numbers.
    bits = np.packbits(marks)
    at = np.flatnonzero(bits != 0)
    eights = bits.take(at)
    if not len(at) or _COUNT.take(eights).max() > 1:
        return _all(marks, start)
    every_eighth = at.astype(np.int32)
    every_eighth <<= 3
    every_eighth += _FIRST.take(eights)
    every_eighth += start
    return every_eighth


def _all(marks: Marks, start: int) -> Places:
    return np.asarray(np.flatnonzero(marks).astype(np.int32) + np.int32(start))


def _joined(parts: list[Places]) -> Places:
    return np.concatenate([np.empty(0, np.int32), *parts])


def places_where(data: Bytes, is_it: Callable[[Bytes], Marks]) -> Places:
    """Return where in some data there are bytes of some kind, as `is_it` tells of each byte."""
    return _joined([_all(is_it(part), start) for start, part in _pieces(data)])


def count(data: Bytes, is_it: Callable[[Bytes], Marks]) -> int:
    """Return how many bytes of some kind there are."""
    return sum(int(np.count_nonzero(is_it(part))) for _, part in _pieces(data))


def is_bracket(data: Bytes) -> Marks:
    """Tell which bytes are brackets or braces."""
    lower = data | _LOWER
    marks: Marks = lower == ord("{")
    marks |= lower == ord("}")
    return marks


def is_letter(data: Bytes, letter: int) -> Marks:
    """Tell which bytes are a letter, small or capital.

    Args:
        data: The bytes.
        letter: The small one.
    """
    return np.asarray((data | _LOWER) == letter)


def pairs(data: Bytes, first: int, letter: int) -> Places:
    """Return where a byte has a letter behind it, small or capital."""
    parts = []
    for start in range(0, len(data) - 1, _PIECE_BYTES):
        part = data[start : start + _PIECE_BYTES + 1]
        marks = is_letter(part[1:], letter)
        marks &= part[:-1] == first
        if marks.any():
            parts.append(_all(marks, start))
    return _joined(parts)


def _pieces(data: Bytes) -> Iterator[tuple[int, Bytes]]:
    for start in range(0, len(data), _PIECE_BYTES):
        yield start, data[start : start + _PIECE_BYTES]
