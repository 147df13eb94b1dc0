"""The Arrow types in which pyarrow can read lines of JSON, learnt from rows that were decoded.

pyarrow finds types itself, but not reliably: a list that begins with nulls and then has numbers loses the nulls and
gets others' values, in all versions from 15 to 26, and text that looks like a time becomes one. So it is always told.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from typing import Any

import pyarrow as pa

from ..rows.table import arrow_type, is_shallow

Types = dict[str, pa.DataType | None]
"""Of keys; None for one whose values no type holds."""

_EMPTY_PLACE = pa.bool_()
"""Stands for null inside a list: lists of the type null come back with offsets that lead out of them."""


def of_rows(rows: Sequence[Mapping[str, Any]], names: Sequence[str] | None = None) -> Types:
    """Return the types of rows' keys.

    Args:
        rows: The rows.
        names: The keys that are wanted, of which those that are there come back; None for all, in the order in which
            they first appear.
    """
    there = dict.fromkeys(chain.from_iterable(rows))
    wanted = there if names is None else [name for name in names if name in there]
    types = {name: _of_values([row[name] for row in rows if name in row]) for name in wanted}
    return {name: type_ if type_ is None or _is_shallow(type_) else None for name, type_ in types.items()}


def _is_shallow(type_: pa.DataType) -> bool:
    """Whether columns have such types, those of a dict's keys."""
    if pa.types.is_struct(type_):
        return all(map(_is_shallow, _fields(type_).values()))
    return is_shallow(type_)


def _of_values(values: list[Any], *, in_list: bool = False) -> pa.DataType | None:
    kinds = set(map(type, values)) - {type(None)}
    if kinds == {dict}:
        return _of_dicts([value for value in values if value is not None], in_list=in_list)
    if kinds == {list}:
        inner = _of_values(list(chain.from_iterable(filter(None, values))), in_list=True)
        return None if inner is None else pa.list_(inner)
    return arrow_type(values)


def _of_dicts(dicts: list[dict[str, Any]], *, in_list: bool) -> pa.DataType | None:
    """Return the type of dicts; None where one is empty, or lacks a key inside a list, which would look like a None."""
    if not all(dicts) or (in_list and any(one.keys() != dicts[0].keys() for one in dicts)):
        return None
    names = dict.fromkeys(chain.from_iterable(dicts))
    types = {name: _of_values([one[name] for one in dicts if name in one], in_list=in_list) for name in names}
    return None if None in types.values() else pa.struct(list(types.items()))


def widened(known: pa.DataType | None, own: pa.DataType | None, *, in_list: bool = False) -> pa.DataType | None:
    """Return the type in which to read on, after some lines whose own type is another one than that of those before.

    Args:
        known: The type so far; None if there is none.
        own: The type of the latest lines.
        in_list: Whether these are elements of a list.
    """
    if known is None or own is None or known == own or pa.types.is_null(known):
        return own
    if pa.types.is_null(own) or {known, own} == {pa.int64(), pa.float64()}:
        return known if pa.types.is_null(own) else pa.float64()
    if pa.types.is_list(known) and pa.types.is_list(own):
        return pa.list_(widened(known.value_type, own.value_type, in_list=True))
    if pa.types.is_struct(known) and pa.types.is_struct(own):
        before, now = _fields(known), _fields(own)
        kept = {name: type_ for name, type_ in before.items() if not in_list or name in now}
        merged = [
            (name, widened(kept.get(name), now.get(name, kept.get(name)), in_list=in_list)) for name in {**kept, **now}
        ]
        return pa.struct(merged)
    return own


def readable(type_: pa.DataType, *, in_list: bool = False) -> pa.DataType:
    """Return the type to give to pyarrow: with a place for what was always None or empty in lists."""
    if pa.types.is_null(type_):
        return _EMPTY_PLACE if in_list else type_
    if pa.types.is_list(type_):
        return pa.list_(readable(type_.value_type, in_list=True))
    if pa.types.is_struct(type_):
        return pa.struct([(name, readable(inner, in_list=in_list)) for name, inner in _fields(type_).items()])
    return type_


def has(type_: pa.DataType, is_it: Callable[[pa.DataType], bool]) -> bool:
    """Whether a type, or one inside it, is such a one."""
    return bool(is_it(type_)) or any(has(type_.field(at).type, is_it) for at in range(type_.num_fields))


def has_key_with_dot(type_: pa.DataType) -> bool:
    """Whether a dict in values of a type has a key with a dot in it."""
    return has(type_, lambda inner: pa.types.is_struct(inner) and any("." in name for name in _fields(inner)))


def _fields(type_: pa.DataType) -> dict[str, pa.DataType]:
    return {type_.field(at).name: type_.field(at).type for at in range(type_.num_fields)}
