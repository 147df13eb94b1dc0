"""One column of rows in Arrow: in the type that holds all its values, or else as JSON text."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Sequence
from operator import or_
from typing import Any, NamedTuple

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.compute as pc

from . import array_lists, arrow_types, shape, zero_copy
from .arrow_types import is_list, is_number, type_of
from .json_text import dumps_any, exact_as_read, loads_any, restore
from .plain_row import EXACT_KEY, TIME_KEY
from .shape import ONLY_NULL, Shape, scalar
from .value_shapes import of_values

ENCODING_KEY = b"ml_dash.encoding"
"""Metadata of a column whose values are JSON text, because no one Arrow type holds them all: `json`."""

VALUE_KEY = "_value"
"""Holds a value with NaN, infinities or bytes in it in a JSON text column, beside the side key `_exact`."""

_TEXT_SHAPE = scalar(shape.OPAQUE)


class Column(NamedTuple):
    """One column of some rows."""

    array: Any
    """A pyarrow Array or ChunkedArray."""
    is_text: bool = False
    """Whether it holds JSON text instead of its values."""


def is_json(field: pa.Field) -> bool:
    """Whether a column of a table holds JSON text in place of its values, see `ENCODING_KEY`."""
    return bool((field.metadata or {}).get(ENCODING_KEY) == b"json")


def of_python(values: list[Any]) -> Column:
    """Return a column of Python objects; None is null."""
    if array_lists.has_arrays(values):
        array = array_lists.of(values)
        if array is not None:
            return Column(array)
        values = array_lists.lists(values)
    type_ = type_of(of_values(values))
    if type_ is not None and arrow_types.is_shallow(type_):
        return Column(pa.array(values, type=type_))
    return Column(_texts(values), is_text=True)


def _texts(values: list[Any]) -> pa.Array:
    return pa.array([None if value is None else to_text(value) for value in values], pa.string())


def shape_of(column: Column) -> Shape:
    """Return the shape of a column's values; of JSON text, nothing is known."""
    array = whole(column.array)
    if not column.is_text or array.null_count == len(array):
        return arrow_types.of_array(array)
    return _TEXT_SHAPE | ONLY_NULL if array.null_count else _TEXT_SHAPE


def values_of(column: Column) -> list[Any]:
    """Return a column's values as Python objects; JSON text is decoded."""
    values: list[Any] = column.array.to_pylist()
    return [None if text is None else from_text(text) for text in values] if column.is_text else values


def cast(column: Column, type_: pa.DataType | None) -> pa.Array:
    """Return a column as an array of a type that holds its values; of JSON text for None."""
    array = whole(column.array)
    if pa.types.is_null(array.type):
        return pa.nulls(len(array), pa.string() if type_ is None else type_)
    if type_ is None:
        return array if column.is_text else _texts(array.to_pylist())
    if array.type == type_:
        return array
    try:
        return array.cast(type_)
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):  # of structs and of lists inside lists, in older versions
        return pa.array(array.to_pylist(), type_)


def cast_to_file(column: Column, values: Shape) -> pa.Array:
    """Return a column in the type in which a shape that covers it is stored, see `arrow_types.stored_type`."""
    lengths = arrow_types.vector_lengths(values)
    array = whole(column.array)
    if not lengths or pa.types.is_null(array.type):
        return cast(column, None if type_of(values) is None else arrow_types.stored_type(values))
    elements = leaves(array)
    type_ = arrow_types.element_type(values)
    if elements.type != type_:
        elements = elements.cast(type_)
    size = int(np.prod(lengths))
    if not values.has_nulls:
        return pa.FixedSizeListArray.from_arrays(elements, size)
    present = array.is_valid().to_numpy(zero_copy_only=False)
    offsets = pa.array(np.concatenate(([0], np.cumsum(present * size))).astype(np.int32))
    return pa.ListArray.from_arrays(offsets, elements, mask=pa.array(~present) if array.null_count else None)


def joined(parts: Sequence[Column]) -> Column:
    """Return columns behind each other, in the type that holds the values of all, or as JSON text."""
    types = {part.array.type for part in parts if not pa.types.is_null(part.array.type)}
    are_texts = {part.is_text for part in parts if not pa.types.is_null(part.array.type)}
    if len(types) <= 1 and len(are_texts) <= 1:  # nearly always: nothing has to be measured
        is_text, type_ = True in are_texts, next(iter(types), pa.null())
        if pa.types.is_fixed_size_list(type_) and any(pa.types.is_null(part.array.type) for part in parts):
            type_ = pa.list_(type_.value_type)  # as `type_of` says of lists that are missing in some rows
    else:
        common = type_of(functools.reduce(or_, map(shape_of, parts)))
        is_text, type_ = common is None, pa.string() if common is None else common
    arrays = [array for part in parts for array in _chunks(part, type_, is_text=is_text)]
    return Column(pa.chunked_array(arrays, type=type_), is_text)


def _chunks(part: Column, type_: pa.DataType, *, is_text: bool) -> list[pa.Array]:
    if part.array.type == type_ and part.is_text == is_text:
        return list(part.array.chunks) if isinstance(part.array, pa.ChunkedArray) else [part.array]
    return [cast(part, None if is_text else type_)]


def whole(array: pa.Array | pa.ChunkedArray) -> pa.Array:
    """Return a column as one array."""
    if not isinstance(array, pa.ChunkedArray):
        return array
    if array.num_chunks == 1:
        return array.chunk(0)
    return pa.concat_arrays(array.chunks) if array.num_chunks else pa.array([], array.type)


def leaves(array: pa.Array) -> pa.Array:
    """Return the elements of lists, of the lists in them, and so on, one behind the other."""
    while is_list(array.type):
        array = array.flatten()
    return array


def tight(array: pa.Array) -> pa.Array:
    """Return the same values with a fixed size for lists of numbers that all have one length, inner lists too."""
    type_ = array.type
    if pa.types.is_struct(type_) and type_.num_fields and not array.null_count:  # null ones have no list of any size
        children = [tight(child) for child in array.flatten()]
        if [child.type for child in children] == [type_.field(at).type for at in range(type_.num_fields)]:
            return array
        names = [type_.field(at).name for at in range(type_.num_fields)]
        return pa.StructArray.from_arrays(children, names)
    if not pa.types.is_list(type_) or not len(array):
        return array
    inner, has_gaps = tight(array.flatten()), array.null_count > 0
    each = pc.fill_null(pc.list_value_length(array), 0) if has_gaps else None
    lengths = np.diff(zero_copy.to_numpy(array.offsets)) if each is None else zero_copy.to_numpy(each)
    if is_number(inner.type) and len(inner) and not has_gaps:
        size = int(lengths[0])
        if len(inner) == size * len(array) and (lengths == size).all():
            return pa.FixedSizeListArray.from_arrays(inner, size)
    if inner.type == type_.value_type:
        return array
    offsets = zero_copy.to_arrow(np.concatenate(([0], np.cumsum(lengths))).astype(np.int32))
    return pa.ListArray.from_arrays(offsets, inner, mask=pc.is_null(array) if has_gaps else None)


def to_text(value: Any) -> str:
    """Return a value as JSON; one that JSON has no words for is wrapped as `{"_value": ..., "_exact": ...}`."""
    with contextlib.suppress(TypeError):  # bytes, arrays and lone surrogates
        text = orjson.dumps(value)
        if b"null" not in text:
            return text.decode()
    row = loads_any(exact_as_read({VALUE_KEY: value}))
    row.pop(TIME_KEY, None)
    return dumps_any(row if EXACT_KEY in row else row[VALUE_KEY]).decode()


def from_text(text: str) -> Any:
    """Return the value that `to_text` wrote."""
    value = loads_any(text)
    return restore(value)[VALUE_KEY] if isinstance(value, dict) and EXACT_KEY in value else value
