"""The type that holds all values of a column, learnt block by block."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from . import array_lists
from .table import Column, to_text, values_of

_EXACT_INTEGERS = 2**53


@dataclass(frozen=True, slots=True)
class Kind:
    """What the values of a column have been so far."""

    type: pa.DataType
    """Lists that all had one length are of fixed size here, whether or not rows were without one; null if there were no
    values."""
    has_nulls: bool = False
    """Whether rows were without a value."""
    is_text: bool = False
    """Whether only JSON text holds them all."""
    fits_doubles: bool = True
    """Whether a double holds every integer among them exactly."""
    is_natural: bool = True
    """Whether no integer among them was negative."""

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape that every value has: () for single values and for lists of various lengths, (7,), (4, 4)."""
        lengths: list[int] = []
        type_ = self.type
        while pa.types.is_fixed_size_list(type_):
            lengths.append(type_.list_size)
            type_ = type_.value_type
        return () if _is_any_list(type_) else tuple(lengths)

    @property
    def element(self) -> pa.DataType:
        """The type of a single value, or of one number of a vector or matrix."""
        type_ = self.type
        while self.shape and pa.types.is_fixed_size_list(type_):
            type_ = type_.value_type
        return type_

    @property
    def stored(self) -> pa.DataType:
        """The type that holds them in a file: vectors and matrices as flat lists of fixed size.

        A fixed size is given up where rows are without a value: pyarrow before 26 cannot read nulls back among lists
        of fixed size.
        """
        if self.is_text:
            return pa.string()
        if self.shape and not self.has_nulls:
            return pa.list_(self.element, int(np.prod(self.shape)))
        return pa.list_(self.element) if self.shape else _loose(self.type)

    def __add__(self, other: Kind) -> Kind:
        """Return what holds the values of both; the first one itself, if that does."""
        fits, natural = self.fits_doubles and other.fits_doubles, self.is_natural and other.is_natural
        texts = {one.is_text for one in (self, other) if not pa.types.is_null(one.type)}
        type_ = None if len(texts) > 1 else _common(self.type, other.type, fits, natural)
        has_nulls = self.has_nulls or other.has_nulls
        both = Kind(pa.string() if type_ is None else type_, has_nulls, type_ is None or True in texts, fits, natural)
        return self if both == self else both


NOTHING = Kind(pa.null())
"""A column without rows so far."""

ABSENT = Kind(pa.null(), has_nulls=True)
"""A column whose rows were all without a value."""


def of(column: Column) -> Kind:
    """Return the kind of some values."""
    array = whole(column.array)
    present = array.drop_null() if array.null_count else array
    if not len(present):
        return ABSENT if len(array) else NOTHING
    kind = Kind(_tightest(present), has_nulls=array.null_count > 0, is_text=column.is_text)
    ranges = [_range(leaf) for leaf in _integers(present)]
    if not ranges:
        return kind
    low, high = min(low for low, _ in ranges), max(high for _, high in ranges)
    return replace(kind, fits_doubles=-_EXACT_INTEGERS <= low <= high <= _EXACT_INTEGERS, is_natural=low >= 0)


def cast(column: Column, kind: Kind) -> pa.Array:
    """Return values in the type in which a kind that covers them is stored."""
    array, type_ = whole(column.array), kind.stored
    if pa.types.is_null(array.type):
        return pa.nulls(len(array), type_)
    if kind.is_text and not column.is_text:
        return pa.array([None if value is None else to_text(value) for value in values_of(column)], type_)
    if kind.shape:
        return _vectors(array, kind)
    if array.type == type_:
        return array
    try:
        return array.cast(type_)
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):  # of structs and of lists inside lists, in older versions
        return pa.array(array.to_pylist(), type_)


def whole(array: Any) -> pa.Array:
    """Return a ChunkedArray, or an Array, as an Array."""
    if not isinstance(array, pa.ChunkedArray):
        return array
    if array.num_chunks == 1:
        return array.chunk(0)
    return pa.concat_arrays(array.chunks) if array.num_chunks else pa.array([], array.type)


def leaves(array: pa.Array) -> pa.Array:
    """Return the elements of lists, of the lists in them, and so on, one behind the other."""
    while _is_any_list(array.type):
        array = array.flatten()
    return array


def _tightest(array: pa.Array) -> pa.DataType:
    """Return the type of values with a fixed size for each level of their lists, if they are arrays of one shape."""
    whole_type, type_ = array.type, leaves(array).type
    if not (pa.types.is_integer(type_) or pa.types.is_floating(type_)):
        return whole_type
    shape: list[int] = []
    while _is_any_list(array.type):
        lengths = pc.unique(pc.list_value_length(array))
        if array.null_count or len(lengths) != 1 or not lengths[0].as_py():
            return whole_type
        shape.append(lengths[0].as_py())
        array = array.flatten()
    for length in reversed(shape):
        type_ = pa.list_(type_, length)
    return type_


def _vectors(array: pa.Array, kind: Kind) -> pa.Array:
    elements = leaves(array)
    if elements.type != kind.element:
        elements = elements.cast(kind.element)
    size = int(np.prod(kind.shape))
    if not kind.has_nulls:
        return pa.FixedSizeListArray.from_arrays(elements, size)
    present = array.is_valid().to_numpy(zero_copy_only=False)
    offsets = pa.array(np.concatenate(([0], np.cumsum(present * size))).astype(np.int32))
    return pa.ListArray.from_arrays(offsets, elements, mask=pa.array(~present) if array.null_count else None)


def _common(first: pa.DataType, second: pa.DataType, fits: bool, natural: bool) -> pa.DataType | None:
    """Return the type that holds the values of two, or None."""
    if first == second or pa.types.is_null(second):
        return first
    if pa.types.is_null(first):
        return second
    if _is_any_list(first) and _is_any_list(second):
        inner = _common(first.value_type, second.value_type, fits, natural)
        if inner is None:
            return None
        sizes = {one.list_size if pa.types.is_fixed_size_list(one) else -1 for one in (first, second)}
        return pa.list_(inner, sizes.pop()) if len(sizes) == 1 else pa.list_(inner)
    if pa.types.is_struct(first) and pa.types.is_struct(second):
        return _common_struct(_fields(first), _fields(second), fits, natural)
    types = {first, second}
    if types == {pa.int64(), pa.float64()}:
        return pa.float64() if fits else None
    if types == {pa.int64(), pa.uint64()}:
        return pa.uint64() if natural else None
    return array_lists.wider(first, second)


def _common_struct(first: list[pa.Field], second: list[pa.Field], fits: bool, natural: bool) -> pa.DataType | None:
    theirs = {field.name: field.type for field in second}
    if len(first) != len(second) or {field.name for field in first} != set(theirs):
        return None
    types = [_common(field.type, theirs[field.name], fits, natural) for field in first]
    if any(type_ is None for type_ in types):
        return None
    return pa.struct([pa.field(field.name, type_) for field, type_ in zip(first, types, strict=True)])


def _loose(type_: pa.DataType) -> pa.DataType:
    """Return a type whose lists are all of variable size, as every reader reads them back from inside others."""
    if _is_any_list(type_):
        return pa.list_(_loose(type_.value_type))
    if pa.types.is_struct(type_):
        return pa.struct([pa.field(field.name, _loose(field.type)) for field in _fields(type_)])
    return type_


def _integers(array: pa.Array) -> Iterable[pa.Array]:
    """Yield the integers in an array, in its lists and its structs."""
    array = leaves(array)
    if pa.types.is_struct(array.type):
        for child in array.flatten():
            yield from _integers(child)
    elif pa.types.is_integer(array.type) and len(array) > array.null_count:
        yield array


def _range(integers: pa.Array) -> tuple[int, int]:
    found = pc.min_max(integers)
    return found["min"].as_py(), found["max"].as_py()


def _fields(type_: pa.DataType) -> list[pa.Field]:
    return [type_.field(at) for at in range(type_.num_fields)]


def _is_any_list(type_: pa.DataType) -> bool:
    return bool(pa.types.is_list(type_) or pa.types.is_fixed_size_list(type_))
