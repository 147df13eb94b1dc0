"""Makes Arrow columns of the values of JSON rows of one pattern, in the types that `rows.table` gives the same rows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ..rows import zero_copy
from ..rows.arrow_types import is_number
from . import json_value_numbers, json_value_words
from .json_pattern_rows import PatternRows
from .json_row_pattern import PatternColumn
from .json_value_numbers import NotAllNumbersError
from .json_value_words import NULL, NUMBER, TRUE, ValueWords


class PatternColumns:
    """Makes columns of rows of one pattern, and learns which of them hold integers. Any thread may call it."""

    def __init__(self, columns: Sequence[PatternColumn]) -> None:
        """Begin with a pattern's columns, or some of them."""
        self._columns = columns
        words = [column for column in columns if not column.is_text]
        values = [np.arange(column.first, column.first + column.size) for column in words]
        self._values = _as_slice(np.concatenate([np.empty(0, np.intp), *values]))
        """The numbers of their values in a row, but for texts, [V]."""
        self._cuts = {}
        """Where in `_values` each column's values are."""
        end = 0
        for column in words:
            self._cuts[column.name] = slice(end, end := end + column.size)
        self._integers: frozenset[str] = frozenset()
        """The columns that lately had nothing but integers."""

    def words(self, rows: PatternRows) -> ValueWords:
        """Return the values of the columns, but for texts, in the rows in which all of them may be words of JSON."""
        return json_value_words.read(rows, self._values)

    def read(self, words: ValueWords) -> dict[str, pa.Array] | None:
        """Return the columns of rows by name; None where Arrow has no type for one.

        Args:
            words: Those that `words` returned, of one row or more.
        """
        others = {name: words.cut(cut) for name, cut in self._cuts.items() if not _has_numbers(words, cut)}
        numbers = {name: cut for name, cut in self._cuts.items() if name not in others}
        if any(_has_booleans(words, cut) for cut in numbers.values()):
            return None
        try:
            flat = json_value_numbers.read(words, numbers, self._integers)
        except NotAllNumbersError:
            return None
        self._integers = frozenset(name for name, array in flat.items() if pa.types.is_integer(array.type))
        flat.update({name: _booleans(cut) for name, cut in others.items()})
        flat.update({column.name: _texts(words.rows, column) for column in self._columns if column.is_text})
        return {column.name: _nested(flat[column.name], column.lengths) for column in self._columns}


def _as_slice(numbers: npt.NDArray[np.intp]) -> npt.NDArray[np.intp] | slice:
    """Return numbers as a slice, which numpy takes without a copy, if they follow each other."""
    is_whole = len(numbers) and numbers[-1] - numbers[0] == len(numbers) - 1
    return slice(int(numbers[0]), int(numbers[-1]) + 1) if is_whole else numbers


def _has_numbers(words: ValueWords, cut: slice) -> bool:
    return words.kinds is None or bool((words.kinds[:, cut] == NUMBER).any())


def _has_booleans(words: ValueWords, cut: slice) -> bool:
    return words.kinds is not None and bool((words.kinds[:, cut] > NULL).any())


def _booleans(words: ValueWords) -> pa.Array:
    """Return booleans, [M * size], or nulls if there is nothing else."""
    if words.kinds is None or (words.kinds == NULL).all():
        return pa.nulls(words.starts.size)
    is_there = words.kinds != NULL
    bitmap = None if is_there.all() else _bits(is_there)
    return pa.Array.from_buffers(pa.bool_(), is_there.size, [bitmap, _bits(words.kinds == TRUE)])


def _bits(values: npt.NDArray[np.bool_]) -> pa.Buffer:
    return pa.py_buffer(np.packbits(values, bitorder="little"))


def _texts(rows: PatternRows, column: PatternColumn) -> pa.Array:
    """Return the texts of a column, [M * size]."""
    values = slice(column.first, column.first + column.size)
    starts, ends = rows.starts(values), rows.ends(values)
    bounds = np.stack((starts, ends), axis=-1).astype(np.int32)
    buffers = [None, pa.py_buffer(bounds), pa.py_buffer(rows.data)]
    # Every other text is what lies between two of the column; taking the others copies them.
    return pa.Array.from_buffers(pa.string(), bounds.size - 1, buffers).take(
        zero_copy.to_arrow(np.arange(0, bounds.size, 2))
    )


def _nested(array: pa.Array, lengths: tuple[int, ...]) -> pa.Array:
    """Return values as the lists in which they lie, those of numbers of fixed size, as `typed_columns.tight` does."""
    for level, length in enumerate(reversed(lengths)):
        if is_number(array.type) and not level:
            array = pa.FixedSizeListArray.from_arrays(array, length)
        else:
            bounds = np.arange(0, len(array) + 1, length, dtype=np.int32)
            array = pa.ListArray.from_arrays(zero_copy.to_arrow(bounds), array)
    return array
