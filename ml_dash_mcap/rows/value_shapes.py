"""Finds the shapes of Python values and of numpy arrays, many at once."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from itertools import chain
from operator import or_
from typing import Any

from . import packed_arrays
from .plain_row import has_lone_surrogates
from .shape import (
    ANY_INTEGER,
    ANY_TEXT,
    ARRAY,
    BOOLEAN,
    BYTES,
    DICT,
    EMPTY_DICT,
    FLOAT64,
    NOTHING,
    ONLY_NULL,
    OPAQUE,
    ArrayType,
    Shape,
    join,
    of_dicts,
    of_integers,
    of_lists,
    of_texts,
    scalar,
)


class Opaque:
    """Stands for a value of which nothing is known."""


def of_values(values: Sequence[Any], *, is_coarse: bool = False) -> Shape:
    """Return the shape of values.

    Values of one type are looked at together, by functions that are written in C: that is several times as fast as
    joining the shapes of each, which gives the same.

    Args:
        values: As they are read: None, booleans, numbers, texts, bytes, lists, dicts, arrays of numpy.
        is_coarse: Whether to leave out all that no JSON Schema tells: elements of lists of lists, sizes of integers,
            special letters in texts. A camera's picture as nested lists would take 50 ms otherwise.
    """
    return _of_values(values, is_coarse, is_in_list=False)


def of_value(value: Any, *, is_coarse: bool = False) -> Shape:
    """Return the shape of one value, see `of_values`."""
    return _of_values((value,), is_coarse, is_in_list=False)


def _of_values(values: Sequence[Any], is_coarse: bool, *, is_in_list: bool) -> Shape:
    types = set(map(type, values))
    shape = NOTHING
    for type_ in types:
        part = _SIMPLE.get(type_)
        if part is None:
            same = values if len(types) == 1 else [value for value in values if type(value) is type_]
            part = _of_one_type(type_, same, is_coarse, is_in_list=is_in_list)
        shape = part if shape is NOTHING else join(shape, part)
    return shape


def _of_one_type(type_: type, values: Sequence[Any], is_coarse: bool, *, is_in_list: bool) -> Shape:
    if type_ is int:
        return _COARSE_INTEGERS if is_coarse else of_integers(min(values), max(values))
    if type_ is str:
        return _COARSE_TEXTS if is_coarse else _of_text_values(values)
    if type_ is list:
        if is_coarse and is_in_list:
            return scalar(OPAQUE)
        lengths = list(map(len, values))
        elements = values[0] if len(values) == 1 else list(chain.from_iterable(values))
        # Called here and not in a function of its own: a call more a level, and deep lists would not fit on the stack.
        items = _of_values(elements, is_coarse, is_in_list=True)
        return of_lists(items, min(lengths), max(lengths))
    if type_ is dict:
        return _of_dict_values(values, is_coarse)
    if type_ is packed_arrays.Spelling:
        return _of_arrays(map(_spelled_type, values))
    return _of_foreign(values)


def _of_text_values(texts: Sequence[str]) -> Shape:
    text = "".join(texts)
    return of_texts(texts[0], has_nul="\0" in text, has_surrogate=has_lone_surrogates(text))


def _of_dict_values(dicts: Sequence[dict[str, Any]], is_coarse: bool) -> Shape:
    if len(dicts) == 1:  # the writer looks at rows one by one
        fields = {}
        for key, value in dicts[0].items():
            fields[key] = _SIMPLE.get(type(value)) or _of_one_type(type(value), (value,), is_coarse, is_in_list=False)
        return of_dicts(fields)
    keys, optional = dicts[0].keys(), frozenset[str]()
    columns: dict[str, Sequence[Any]]
    if all(row.keys() == keys for row in dicts):
        columns = {key: [row[key] for row in dicts] for key in keys}
    else:
        lists: dict[str, list[Any]] = {}
        for row in dicts:
            for key, value in row.items():
                lists.setdefault(key, []).append(value)
        columns = dict(lists)
        optional = frozenset(key for key, values in columns.items() if len(values) < len(dicts))
    fields = {key: _of_values(values, is_coarse, is_in_list=False) for key, values in columns.items()}
    return Shape(DICT if all(dicts) else DICT | EMPTY_DICT, fields=fields, optional=optional)


def _of_foreign(values: Sequence[Any]) -> Shape:
    """Return the shape of arrays of numpy; of all else, nothing is known."""
    import numpy as np

    if isinstance(values[0], np.ndarray):
        return _of_arrays(
            ArrayType(array.dtype.name, array.shape, packed_arrays.is_plain(packed_arrays.spelling(array)))
            for array in values
        )
    return scalar(OPAQUE)


def _of_arrays(types: Iterable[ArrayType]) -> Shape:
    return Shape(ARRAY, array=functools.reduce(or_, types))


def _spelled_type(spelling: str) -> ArrayType:
    dtype, lengths = packed_arrays.parse(packed_arrays.described(spelling)) or (None, None)
    return ArrayType(dtype, lengths, packed_arrays.is_plain(spelling))


_SIMPLE = {
    type(None): ONLY_NULL,
    bool: scalar(BOOLEAN),
    float: scalar(FLOAT64),
    bytes: scalar(BYTES),
    Opaque: scalar(OPAQUE),
}
"""Types of which one shape tells all."""

_COARSE_INTEGERS, _COARSE_TEXTS = scalar(ANY_INTEGER), scalar(ANY_TEXT)
