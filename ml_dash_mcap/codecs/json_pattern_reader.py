"""Reads JSON rows of one pattern as columns: several times faster than a parser of JSON, which looks at each byte."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..rows.dotted import FIELD_PREFIX
from ..rows.field_choice import is_wanted
from ..rows.plain_row import TIME_KEY
from . import json_pattern_rows, json_row_pattern
from .codec import Columns
from .json_pattern_columns import PatternColumns
from .json_row_pattern import RowPattern
from .json_value_words import ValueWords
from .payloads import Payloads

_LEAST_ROWS = 8
"""A pattern is learnt of one row, and read from so many at least."""

_MOST_OTHERS = 8
"""At most one of so many rows may be without the pattern."""

_TRIES = 2
"""Patterns that are tried on one block."""

_MOST_PASSED = 64
"""Blocks that are not tried after a block without a pattern: twice as many each time, up to so many."""


@dataclass(frozen=True, slots=True)
class _Learnt:
    pattern: RowPattern
    wanted: PatternColumns
    """The wanted columns."""
    everything: PatternColumns
    """All columns of the pattern; the same object if all are wanted."""

    def read(self, payloads: Payloads) -> tuple[PatternColumns, ValueWords]:
        """Return the columns to make, and their values in the rows that have the pattern."""
        rows = json_pattern_rows.find(self.pattern, payloads)
        if self.wanted is not self.everything:
            plain = json_pattern_rows.with_plain_values(rows, payloads)
            if not _are_many(len(rows.numbers) - len(plain.numbers), len(rows.numbers)):
                return self.wanted, self.wanted.words(plain)
        # Brackets in texts are no reason to leave rows out, but then the other values have to be looked at.
        return self.everything, self.everything.words(rows)


class PatternReader:
    """Reads the rows of one channel. Any thread may call it; what one of them learns may be lost."""

    def __init__(self, columns: Sequence[str] | None) -> None:
        """Begin to read.

        Args:
            columns: Dotted names of the wanted columns; None for all.
        """
        self._wanted = columns
        self._learnt: _Learnt | None = None
        self._to_pass = 0
        self._passed = 0
        """How many blocks were, and are still to be, read in another way."""

    def read(self, payloads: Payloads) -> Columns | None:
        """Return the columns of most rows, and which are left out; None if they have no pattern in common.

        Where only some columns are wanted, the values of the others are not parsed: a row may come back with one of
        them that is no JSON.
        """
        if len(payloads) < _LEAST_ROWS or len(payloads.data) >= 2**31:
            return None
        if self._to_pass > 0:
            self._to_pass -= 1
            return None
        columns = self._read(payloads)
        self._passed = 0 if columns else min(2 * self._passed + 1, _MOST_PASSED)
        self._to_pass = self._passed
        return columns

    def _read(self, payloads: Payloads) -> Columns | None:
        if not _is_utf8(payloads.data):
            return None
        example = 0
        for _ in range(_TRIES):
            learnt = self._learnt or self._learn(payloads[example])
            if learnt is None:
                example = len(payloads) // 2
                continue
            columns, words = learnt.read(payloads)
            others = _others(words.rows.numbers, len(payloads))
            if not _are_many(len(others), len(payloads)):
                self._learnt = learnt
                arrays = columns.read(words)
                return None if arrays is None else Columns(arrays, others)
            self._learnt, example = None, int(others[0])
        return None

    def _learn(self, payload: bytes) -> _Learnt | None:
        pattern = json_row_pattern.learn(payload)
        if pattern is None:
            return None
        everything = PatternColumns(pattern.columns)
        columns = [column for column in pattern.columns if self._is_wanted(column.name)]
        is_all = len(columns) == len(pattern.columns)
        return _Learnt(pattern, everything if is_all else PatternColumns(columns), everything)

    def _is_wanted(self, name: str) -> bool:
        if name.split(".")[0] == TIME_KEY:
            return True
        return is_wanted(name, self._wanted) or is_wanted(FIELD_PREFIX + name, self._wanted)


def _are_many(others: int, count: int) -> bool:
    return others * _MOST_OTHERS > count


def _others(numbers: npt.NDArray[np.intp], count: int) -> npt.NDArray[np.intp]:
    """Return which of so many rows are not among some."""
    is_other = np.ones(count, np.bool_)
    is_other[numbers] = False
    return np.flatnonzero(is_other)


def _is_utf8(data: npt.NDArray[np.uint8]) -> bool:
    if not len(data) or data.view(np.int8).min() >= 0:
        return True
    try:
        data.tobytes().decode()
    except UnicodeDecodeError:
        return False
    return True
