"""Finds the rows that have a pattern among many payloads, and where in each of them its values lie.

Nothing is parsed: commas are looked for in all payloads at once. By these the texts between the values should lie at
certain places, and they are compared there byte by byte.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from . import byte_search
from .byte_search import Bytes, Marks, Places
from .json_row_pattern import COMMA, QUOTE, RowPattern
from .payloads import BLANKS_BEHIND, Payloads

_BACKSLASH, _SPACE = b"\\ "


@dataclass(frozen=True, slots=True)
class PatternRows:
    """The rows that have a pattern."""

    pattern: RowPattern
    data: Bytes
    """Of all payloads."""
    numbers: npt.NDArray[np.intp]
    """Of their payloads, [M]."""
    gaps: Places
    """Where the gaps between the values lie, [M, K + 1]."""

    def starts(self, values: npt.NDArray[np.intp] | slice) -> Places:
        """Return where values start, [M, V].

        Args:
            values: Their numbers in a row, [V].
        """
        return np.asarray(self.gaps[:, :-1][:, values] + self.pattern.gap_bytes[:-1][values])

    def ends(self, values: npt.NDArray[np.intp] | slice) -> Places:
        """Return where values end, [M, V]."""
        return self.gaps[:, 1:][:, values]

    def pick(self, which: Marks) -> PatternRows:
        """Return some of the rows."""
        return PatternRows(self.pattern, self.data, self.numbers[which], self.gaps[which])


def find(pattern: RowPattern, payloads: Payloads) -> PatternRows:
    """Return the rows of a pattern, whose texts are texts of JSON, without escapes.

    The other values are not looked at. There is no comma in them.
    """
    commas = byte_search.places(payloads.data, COMMA)
    if not pattern.has_texts:
        return _at_commas(pattern, payloads, commas)
    if len(commas) != len(payloads) * pattern.anchors.count:
        # Most commas in texts have a space behind them; it takes much longer to find the texts.
        commas = commas[pattern.may_follow_comma[payloads.data.take(commas + 1)]]
    if len(commas) != len(payloads) * pattern.anchors.count:
        commas = _outside_of_texts(pattern, payloads, commas)
    rows = _at_commas(pattern, payloads, commas)
    rows = _with_count(rows, payloads, lambda part: part == QUOTE, pattern.count(b'"'))
    rows = _with_count(rows, payloads, lambda part: part == _BACKSLASH, 0)
    return _with_count(rows, payloads, lambda part: part < _SPACE, pattern.count(bytes(range(_SPACE))))


def with_plain_values(rows: PatternRows, payloads: Payloads) -> PatternRows:
    """Return the rows that have no bracket and no quote but in the gaps.

    Whatever their values are, none of them changes the structure, unless the row is no JSON at all.
    """
    rows = _with_count(rows, payloads, byte_search.is_bracket, rows.pattern.count(b"[]{}"))
    return _with_count(rows, payloads, lambda part: part == QUOTE, rows.pattern.count(b'"'))


def _with_count(rows: PatternRows, payloads: Payloads, is_it: Callable[[Bytes], Marks], count: int) -> PatternRows:
    """Return the rows that have so many bytes of some kind, those of the gaps alone."""
    if len(rows.numbers) == len(payloads) and byte_search.count(payloads.data, is_it) == len(payloads) * count:
        return rows
    at = byte_search.places_where(payloads.data, is_it)
    return rows.pick(_counts(at, payloads)[1][rows.numbers] == count)


def _at_commas(pattern: RowPattern, payloads: Payloads, commas: Places) -> PatternRows:
    """Return the rows in which the gaps of a pattern lie where some commas are, which are as many as the gaps have."""
    count, everything = pattern.anchors.count, np.arange(len(payloads))
    if len(commas) == count * len(payloads):
        rows = _placed(pattern, payloads, everything, commas.reshape(len(payloads), count))
        if len(rows.numbers) == len(payloads):
            return rows
    firsts, counts = _counts(commas, payloads)
    numbers = np.flatnonzero(counts == count)
    return _placed(pattern, payloads, numbers, commas[firsts[numbers][:, None] + np.arange(count)])


def _counts(at: Places, payloads: Payloads) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return for each payload the first of some places that lies in it, [N], and how many do, [N]."""
    # Of the same type as `at`, which would be copied otherwise.
    firsts = np.searchsorted(at, payloads.starts.astype(np.int32))
    return firsts, np.searchsorted(at, payloads.ends.astype(np.int32)) - firsts


def _outside_of_texts(pattern: RowPattern, payloads: Payloads, commas: Places) -> Places:
    """Return the commas that do not lie in a value that is a text, in rows that have as many quotes as the pattern."""
    quotes = byte_search.places(payloads.data, QUOTE)
    firsts, counts = _counts(quotes, payloads)
    firsts = firsts[counts == pattern.count(b'"')]
    opening = (firsts[:, None] + pattern.quotes_of_texts).reshape(-1)
    low, high = np.searchsorted(commas, quotes[opening]), np.searchsorted(commas, quotes[opening + 1])
    steps = np.zeros(len(commas) + 1, np.int64)
    np.add.at(steps, low[low < high], 1)
    np.subtract.at(steps, high[low < high], 1)
    return np.asarray(commas[np.cumsum(steps[:-1]) == 0])


def _placed(pattern: RowPattern, payloads: Payloads, numbers: npt.NDArray[np.intp], commas: Places) -> PatternRows:
    """Return those of some rows in which the gaps lie where their commas, [M, C], say.

    Args:
        pattern: Of the rows.
        payloads: All of them.
        numbers: Of the rows, [M].
        commas: Where the commas of each row are.
    """
    anchors = pattern.anchors
    gaps = np.empty((len(numbers), len(pattern.gaps)), np.int32)
    gaps[:, 0] = payloads.starts[numbers]
    np.subtract(commas[:, anchors.numbers], anchors.places, out=gaps[:, 1:-1])
    gaps[:, -1] = payloads.ends[numbers] - pattern.gap_bytes[-1]
    rows = PatternRows(pattern, payloads.data, numbers, gaps)
    # First, so that no gap lies outside of the data.
    rows = _pick_all(rows, gaps[:, 1:] - gaps[:, :-1] >= pattern.gap_bytes[:-1] + ~pattern.is_text)
    return _pick_all(rows, _have_words(rows))


def _pick_all(rows: PatternRows, are_right: Marks) -> PatternRows:
    """Return the rows in which all of some things, [M, X], are right."""
    return rows if are_right.all() else rows.pick(np.asarray(are_right.all(axis=1)))


def _have_words(rows: PatternRows) -> Marks:
    """Tell which words of the pattern's gaps are in the rows, [M, W]."""
    words = rows.pattern.words
    at_each_byte = np.ndarray((len(rows.data) - BLANKS_BEHIND + 1,), "<u8", rows.data, strides=(1,))
    stored = at_each_byte[rows.gaps[:, words.gaps] + words.places]
    stored &= words.masks
    return np.asarray(stored == words.texts)
