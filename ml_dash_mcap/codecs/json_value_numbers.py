"""Parses the numbers of many JSON rows at once, as integers where all numbers of a column are, otherwise as doubles.

Arrow parses texts that lie behind each other. Between two numbers lies the text of the pattern; it is given to Arrow as
a null, so that no byte of the rows is copied.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ..rows.shape import EXACT_INTEGER
from . import json_value_words
from .byte_search import Marks
from .json_value_words import NUMBER, ValueWords

Cuts = Mapping[str, slice]
"""The values of some columns: where among those of a row they are, by the column's name."""

Array = npt.NDArray[Any]

_EVERY_OTHER = np.uint8(0b01010101)
"""Eight bits of a bitmap that says that every other value is there, beginning with the first."""

_MINUS_ZERO = np.iinfo(np.int64).min
"""The integer that has the same bits as the double -0.0."""

_FEW = 16


class NotAllNumbersError(Exception):
    """A column has something else than numbers, or numbers that no type holds exactly."""


def read(words: ValueWords, cuts: Cuts, integers: frozenset[str]) -> dict[str, pa.Array]:
    """Return the numbers of some columns, [M * size] each, as int64 or double; nulls are null.

    Args:
        words: Values of rows, [M, V].
        cuts: The columns, which hold numbers and nulls.
        integers: The columns that may have nothing but integers. Of the others it is found out.

    Raises:
        NotAllNumbersError: A word is no number after all, or no type holds the numbers of a column exactly.
    """
    arrays = _integers(words, {name: cut for name, cut in cuts.items() if name in integers}) or {}
    arrays.update(_doubles(words, {name: cut for name, cut in cuts.items() if name not in arrays}))
    more = _integers(words, {name: cut for name, cut in cuts.items() if name not in arrays})
    if more is None:  # of more than 64 bits
        raise NotAllNumbersError
    return {**arrays, **more}


def _integers(words: ValueWords, cuts: Cuts) -> dict[str, pa.Array] | None:
    """Return columns of integers; None if any number is not one, or not one of 64 bits."""
    words, cuts = _only(words, cuts)
    try:
        numbers = _parsed(words, np.int64)
    except NotAllNumbersError:
        return None
    return {name: _array(words, numbers, cut) for name, cut in cuts.items()}


def _doubles(words: ValueWords, cuts: Cuts) -> dict[str, pa.Array]:
    """Return columns as doubles, but for those that have nothing but integers."""
    words, cuts = _only(words, cuts)
    numbers = _parsed(words, np.float64)
    numbers = np.ascontiguousarray(numbers) if words.kinds is None else np.where(words.kinds == NUMBER, numbers, 1)
    odd = _may_differ(numbers)
    arrays: dict[str, pa.Array] = {}
    for name, cut in cuts.items():
        if not _has_fraction(numbers[:, cut]) and _are_integers(words.cut(cut)):
            continue
        if odd is not None:
            _check_doubles(words.cut(cut), numbers[:, cut], odd[:, cut])
        arrays[name] = _array(words, numbers, cut)
    return arrays


def _only(words: ValueWords, cuts: Cuts) -> tuple[ValueWords, Cuts]:
    """Return the values of some columns alone, and where among them these are."""
    which = np.concatenate([np.empty(0, np.intp), *(np.arange(cut.start, cut.stop) for cut in cuts.values())])
    moved: dict[str, slice] = {}
    end = 0
    for name, cut in cuts.items():
        moved[name] = slice(end, end := end + cut.stop - cut.start)
    return (words if len(which) == words.starts.shape[1] else words.cut(which)), moved


def _parsed(words: ValueWords, dtype: Any) -> Array:
    """Parse numbers; returns [M, V], with anything in the places of nulls.

    Raises:
        NotAllNumbersError: Something else is among them.
    """
    shape = words.starts.shape
    if not shape[1]:
        return np.empty(shape, dtype)
    bounds = np.empty((*shape, 2), np.int32)
    bounds[:, :, 0], bounds[:, :, 1] = words.starts, words.ends
    count = bounds.size - 1
    bitmap = np.full(count // 8 + 1, _EVERY_OTHER) if words.kinds is None else _bitmap(words.kinds)
    buffers = [pa.py_buffer(bitmap), pa.py_buffer(bounds), pa.py_buffer(words.rows.data)]
    try:
        numbers = pa.Array.from_buffers(pa.string(), count, buffers).cast(pa.from_numpy_dtype(dtype))
    except pa.ArrowInvalid as error:
        raise NotAllNumbersError from error
    width = np.dtype(dtype).itemsize
    parsed: Array = np.ndarray(shape, dtype, numbers.buffers()[1], strides=(2 * width * shape[1], 2 * width))
    return parsed


def _bitmap(kinds: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Return a bitmap that says which of values and the texts between them are numbers."""
    is_there = np.zeros((*kinds.shape, 2), np.bool_)
    is_there[:, :, 0] = kinds == NUMBER
    return np.packbits(is_there, bitorder="little")


def _array(words: ValueWords, numbers: Array, cut: slice) -> pa.Array:
    """Return the numbers of a column as an array, [M * size]."""
    flat = np.ascontiguousarray(numbers[:, cut])
    bitmap = None
    if words.kinds is not None:
        is_there = words.kinds[:, cut] == NUMBER
        bitmap = None if is_there.all() else pa.py_buffer(np.packbits(is_there, bitorder="little"))
    return pa.Array.from_buffers(pa.from_numpy_dtype(flat.dtype), flat.size, [bitmap, pa.py_buffer(flat)])


def _has_fraction(numbers: Array) -> bool:
    few = numbers[:_FEW]
    return bool((few != np.rint(few)).any()) or bool((numbers != np.rint(numbers)).any())


def _are_integers(words: ValueWords) -> bool:
    """Whether all numbers of a column are written as integers."""
    every = np.ones(words.starts.shape, np.bool_) if words.kinds is None else words.kinds == NUMBER
    return not json_value_words.have_marks(words, every).any()


def _may_differ(numbers: Array) -> Marks | None:
    """Tell which doubles are not the number that was written if it was an integer, [M, V]; None if none is.

    A large one may be rounded, and the integer -0 has no sign. Infinite ones are among the large ones.
    """
    odd: Marks = numbers.view(np.int64) == _MINUS_ZERO
    if not numbers.size or -EXACT_INTEGER < numbers.min() <= numbers.max() < EXACT_INTEGER:
        return odd if odd.any() else None
    odd |= np.abs(numbers) >= EXACT_INTEGER
    return odd


def _check_doubles(words: ValueWords, numbers: Array, odd: Marks) -> None:
    """Look at how doubles are written that may differ from the number that was written.

    Raises:
        NotAllNumbersError: One differs, or is infinite.
    """
    if not (np.isfinite(numbers[odd]) & json_value_words.have_marks(words, odd)).all():
        raise NotAllNumbersError
