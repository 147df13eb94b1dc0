"""Tells which type of field holds a plain value."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ...rows.plain_row import has_lone_surrogates
from ...rows.shape import EXACT_INTEGER
from .layout import Kind, Slot

_LARGEST_SIGNED = 2**63 - 1

_KINDS: dict[type, Kind] = {
    float: Kind.DOUBLE,
    int: Kind.INT,
    bool: Kind.BOOL,
    str: Kind.TEXT,
    bytes: Kind.BYTES,
    dict: Kind.DICT,
}
_NUMBERS = {int, float}


class Fit(NamedTuple):
    """How a value fits into a field."""

    slot: Slot
    leaves: Sequence[Any] = ()
    """Of lists: the elements, those of inner lists one after the other."""
    integers: bool = False
    """Whether some of the numbers are integers though the slot is one of doubles."""


def fit(value: Any) -> Fit | None:
    """Return the field type for a plain value (see `rows.plain_row.PlainRow`); None where no field expresses it.

    That is so for None, empty lists, lists whose elements differ in more than integers against doubles, text that is
    no Unicode, and lists of bytes: Foxglove and Lichtblick refuse a whole topic for one field of these ("Repeated bytes
    are not supported").
    """
    kind = _KINDS.get(type(value))
    if kind is Kind.TEXT and has_lone_surrogates(value):
        return None
    if kind is not None:
        return Fit(Slot(_int_kind(value) if kind is Kind.INT else kind))
    if isinstance(value, np.ndarray):
        return Fit(Slot(Kind.ARRAY))
    return _fit_list(value) if isinstance(value, (list, tuple)) else None


def as_doubles(values: Sequence[Any]) -> bool:
    """Whether a double holds each of some numbers exactly."""
    return all(type(value) is float or -EXACT_INTEGER <= value <= EXACT_INTEGER for value in values)


def _int_kind(value: int) -> Kind:
    return Kind.UINT if value > _LARGEST_SIGNED else Kind.INT


def _fit_list(values: Sequence[Any]) -> Fit | None:
    lengths: list[int] = []
    leaves = values
    while leaves and all(issubclass(type_, (list, tuple)) for type_ in set(map(type, leaves))):
        length = len(leaves[0])
        if not length or any(len(inner) != length for inner in leaves):
            return None
        lengths.append(length)
        leaves = [leaf for inner in leaves for leaf in inner]
    types = set(map(type, leaves))
    if types == _NUMBERS:
        return Fit(Slot(Kind.DOUBLE, tuple(lengths)), leaves, True) if as_doubles(leaves) else None
    kind = _KINDS.get(types.pop()) if len(types) == 1 else None
    if kind is Kind.INT:
        kind = _list_kind(leaves)
    if kind is None or kind is Kind.BYTES or (lengths and not kind.is_packed):
        return None
    if kind is Kind.TEXT and any(map(has_lone_surrogates, leaves)):
        return None
    return Fit(Slot(kind, tuple(lengths)), leaves)


def _list_kind(integers: Sequence[int]) -> Kind | None:
    if max(integers) <= _LARGEST_SIGNED:
        return Kind.INT
    return Kind.UINT if min(integers) >= 0 else None
