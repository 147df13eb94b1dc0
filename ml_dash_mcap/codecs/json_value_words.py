"""Tells what the values of many JSON rows are by their first and last bytes: numbers, true, false or null.

Arrow's parser of numbers reads more than JSON has, such as `inf`, `.5`, `1.`, `007` and `0x1F`. What begins and ends as
a number of JSON does, and is a number for Arrow, is one for JSON.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from . import byte_search
from .byte_search import Bytes, Marks, Places
from .json_pattern_rows import PatternRows
from .json_row_pattern import POINT
from .payloads import BLANKS_BEHIND

NO_WORD, NUMBER, NULL, FALSE, TRUE = range(5)
"""The kinds of words."""

_SPELLINGS = {NULL: b"null", FALSE: b"false", TRUE: b"true"}

_MINUS, _ZERO, _E, _X = b"-0ex"
_DIGITS = 10
_LOWER = np.uint8(0x20)


@dataclass(frozen=True, slots=True)
class ValueWords:
    """Values of rows that are no texts."""

    rows: PatternRows
    starts: Places
    """Where they start, [M, V]."""
    ends: Places
    """Where they end, [M, V]."""
    kinds: npt.NDArray[np.uint8] | None
    """What they are, [M, V]; None if all are numbers."""

    def cut(self, values: slice | npt.NDArray[np.intp]) -> ValueWords:
        """Return some of the values of each row."""
        kinds = None if self.kinds is None else self.kinds[:, values]
        return ValueWords(self.rows, self.starts[:, values], self.ends[:, values], kinds)

    def pick(self, which: Marks) -> ValueWords:
        """Return the values of some of the rows."""
        kinds = None if self.kinds is None else self.kinds[which]
        return ValueWords(self.rows.pick(which), self.starts[which], self.ends[which], kinds)


def read(rows: PatternRows, values: npt.NDArray[np.intp] | slice) -> ValueWords:
    """Return some values of the rows in which all of these may be words.

    Args:
        rows: The rows.
        values: Numbers of values that are no texts, [V].
    """
    starts, ends = rows.starts(values), rows.ends(values)
    are_sound = _begin_as_numbers(rows.data, starts)
    are_sound &= _are_digits(rows.data.take(ends - 1))
    kinds = None
    if not are_sound.all():
        kinds = _kinds(rows.data, starts, ends, are_sound)
        are_sound = kinds != NO_WORD
    odd = byte_search.pairs(rows.data, POINT, _E)
    if len(odd):  # a point before an exponent, as in `1.e5`
        are_sound &= np.searchsorted(odd, starts) == np.searchsorted(odd, ends)
    words = ValueWords(rows, starts, ends, kinds)
    return words if are_sound.all() else words.pick(np.asarray(are_sound.all(axis=1)))


def have_marks(words: ValueWords, which: Marks) -> Marks:
    """Tell which of some numbers, of those in [M, V], have a point or an exponent, which integers do not have, [X]."""
    data, starts, ends = words.rows.data, words.starts[which], words.ends[which]
    has_mark = data[ends - 2] == POINT  # as in 1.0: so are doubles without a fraction mostly written
    if not has_mark.all():
        at = byte_search.places_where(data, lambda part: (part == POINT) | byte_search.is_letter(part, _E))
        has_mark = np.searchsorted(at, starts) < np.searchsorted(at, ends)
    return np.asarray(has_mark)


def _begin_as_numbers(data: Bytes, starts: Places) -> Marks:
    """Tell which values begin with a minus, perhaps, and a digit, which is no 0 before a digit or an x."""
    first, second = data.take(starts), data.take(starts + 1)
    is_minus = first == _MINUS
    if is_minus.any():
        first = np.where(is_minus, second, first)
        second = np.where(is_minus, data.take(starts + 2), second)
    begins_oddly = _are_digits(second)
    begins_oddly |= (second | _LOWER) == _X
    begins_oddly &= first == _ZERO
    return np.asarray(_are_digits(first) & ~begins_oddly)


def _are_digits(data: Bytes) -> Marks:
    return np.asarray(data - np.uint8(_ZERO) < _DIGITS)  # bytes below 0 wrap around to large numbers


def _kinds(data: Bytes, starts: Places, ends: Places, is_number: Marks) -> npt.NDArray[np.uint8]:
    """Return what values are, in the shape of `starts`, of which some are numbers."""
    kinds = is_number.astype(np.uint8)  # NUMBER or NO_WORD
    others = np.flatnonzero(~is_number)
    at, end = starts.reshape(-1)[others], ends.reshape(-1)[others]
    first, last = np.ndarray((len(data) - BLANKS_BEHIND,), "<u4", data, strides=(1,))[at], data.take(end - 1)
    kinds_of_others = np.zeros(len(at), np.uint8)
    for kind, spelling in _SPELLINGS.items():
        is_it = (first == int.from_bytes(spelling[:4], "little")) & (last == spelling[-1])
        kinds_of_others[is_it & (end - at == len(spelling))] = kind
    kinds.reshape(-1)[others] = kinds_of_others
    return kinds
