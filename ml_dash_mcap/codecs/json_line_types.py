"""The Arrow types in which pyarrow can read lines of JSON, learnt from rows that were decoded.

pyarrow finds types itself, but not reliably: a list that begins with nulls and then has numbers loses the nulls and
gets others' values, in all versions from 15 to 26, and text that looks like a time becomes one. So it is always told.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from typing import Any

import pyarrow as pa

from ..rows.arrow_types import is_shallow, type_of
from ..rows.shape import DICT, EMPTY_DICT, LIST, Shape
from ..rows.value_shapes import of_values

Types = dict[str, pa.DataType | None]
"""Types by key; None for a key whose values no type holds."""

_EMPTY_PLACE = pa.bool_()
"""Stands for null inside a list: lists of the type null come back with offsets that lead out of them."""


def shapes_of(rows: Sequence[Mapping[str, Any]], names: Sequence[str] | None = None) -> dict[str, Shape]:
    """Return the shapes of the values of rows' keys.

    Args:
        rows: The rows.
        names: The keys that are wanted, of which those that are there come back; None for all, in the order in which
            they first appear.
    """
    there = dict.fromkeys(chain.from_iterable(rows))
    wanted = there if names is None else [name for name in names if name in there]
    return {name: of_values([row[name] for row in rows if name in row]) for name in wanted}


def types_of(shapes: Mapping[str, Shape]) -> Types:
    """Return the types that hold values of some shapes."""
    types = {name: _type_of(values) for name, values in shapes.items()}
    return {name: type_ if type_ is None or _is_shallow(type_) else None for name, type_ in types.items()}


def _is_shallow(type_: pa.DataType) -> bool:
    """Whether columns have such types, those of a dict's keys."""
    if pa.types.is_struct(type_):
        return all(map(_is_shallow, _fields(type_).values()))
    return is_shallow(type_)


def _type_of(values: Shape, *, is_in_list: bool = False) -> pa.DataType | None:
    """Return the type in which pyarrow reads values; outside of lists, dicts may lack keys."""
    kinds = values.value_kinds
    if kinds == DICT:
        return None if values.kinds & EMPTY_DICT else _type_of_dicts(values, is_in_list=is_in_list)
    if kinds == LIST and values.items is not None:
        inner = _type_of(values.items, is_in_list=True)
        return None if inner is None else pa.list_(inner)
    return type_of(values)


def _type_of_dicts(dicts: Shape, *, is_in_list: bool) -> pa.DataType | None:
    """Return the type of dicts; None where one lacks a key inside a list, which would look like a None."""
    if is_in_list and dicts.optional:
        return None
    types = {name: _type_of(values, is_in_list=is_in_list) for name, values in dicts.fields.items()}
    return None if None in types.values() else pa.struct(list(types.items()))


def widened(before: Shape | None, latest: Shape) -> Shape:
    """Return the shape for reading on, after lines that did not fit the types of the lines before.

    Args:
        before: The shape of the lines before; None if there are none.
        latest: Of the latest lines, which alone count where no type holds the values of both.
    """
    if before is None:
        return latest
    both = before | latest
    return latest if None in types_of({"": both}).values() else both


def readable(type_: pa.DataType, *, in_list: bool = False) -> pa.DataType:
    """Return the type to give to pyarrow. Elements of lists that were always None or empty get a type, too."""
    if pa.types.is_null(type_):
        return _EMPTY_PLACE if in_list else type_
    if pa.types.is_list(type_):
        return pa.list_(readable(type_.value_type, in_list=True))
    if pa.types.is_struct(type_):
        return pa.struct([(name, readable(inner, in_list=in_list)) for name, inner in _fields(type_).items()])
    return type_


def has(type_: pa.DataType, is_it: Callable[[pa.DataType], bool]) -> bool:
    """Whether a type, or one inside it, is of some kind."""
    return bool(is_it(type_)) or any(has(type_.field(at).type, is_it) for at in range(type_.num_fields))


def has_key_with_dot(type_: pa.DataType) -> bool:
    """Whether a dict in values of a type has a key with a dot in it."""
    return has(type_, lambda inner: pa.types.is_struct(inner) and any("." in name for name in _fields(inner)))


def _fields(type_: pa.DataType) -> dict[str, pa.DataType]:
    return {type_.field(at).name: type_.field(at).type for at in range(type_.num_fields)}
