"""Turns columns of messages into Arrow arrays, in the types that `rows.table` gives the rows of these messages."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ...rows import zero_copy
from ...rows.arrow_types import is_shallow
from .message_columns import Column, Indices, Ragged, count, pick, ranges
from .message_types import Array, Basic, Definitions, Named, Type, numbers_in
from .unpack import unpack

_LARGE_BYTES = 256
"""From so many bytes on average on, as with images, values are copied in a loop. Shorter ones are copied with an index
of every byte, which takes 8 bytes of memory for each."""

_MOST_BYTES = 2**31 - 1
"""The most bytes that all texts of a column may have together, because Arrow counts their places in signed 32 bits."""

_MOST_INTEGER = 2**63 - 1


def read(definitions: Definitions, messages: list[bytes], *, is_ros1: bool = False) -> dict[str, Any]:
    """Return the values of messages as Arrow columns by field, those of messages in messages as dicts of columns.

    The arguments are those of `unpack`.

    Raises:
        ValueError: As `unpack` does, or there are values that have no type of Arrow.
    """
    columns = unpack(definitions, messages, is_ros1=is_ros1)
    return _dicts(definitions, definitions.root, columns)


def _dicts(definitions: Definitions, name: str, columns: dict[str, Column]) -> dict[str, Any]:
    fields = definitions.messages[name]
    if not columns:
        raise ValueError("a message without fields is no column")
    arrays: dict[str, Any] = {}
    for key, column in columns.items():
        type_ = fields[key]
        if isinstance(type_, Named):
            arrays[key] = _dicts(definitions, type_.name, column)
            continue
        array = _array(definitions, type_, column)
        if not is_shallow(array.type):
            raise ValueError(f"the field {key!r} is nested too deeply for Arrow")
        arrays[key] = array
    return arrays


def _array(definitions: Definitions, type_: Type, column: Column) -> pa.Array:
    if isinstance(type_, Named):
        fields = definitions.messages[type_.name]
        arrays = [_array(definitions, fields[key], inner) for key, inner in column.items()]
        return pa.StructArray.from_arrays(arrays, [*column])
    if isinstance(type_, Array):
        return _list(definitions, type_, column)
    assert isinstance(type_, Basic)
    return _texts(column) if type_.is_text else _numbers(type_, column)


def _numbers(type_: Basic, values: npt.NDArray[Any]) -> pa.Array:
    """Return numbers in the types that Python's have: whole ones in 64 bits, fractions as doubles."""
    if type_.name == "bool":
        # Some senders write other bytes than 1 for true; `struct`, which reads the rows, takes every byte but 0 for
        # true.
        return pa.array(values != 0)
    if type_.name == "int8":
        # Lists of one-byte items arrive as plain bytes, without their sign.
        values = values.view(np.int8)
    if values.dtype.kind == "f":
        return zero_copy.to_arrow(np.ascontiguousarray(values, np.float64))
    is_larger = values.dtype == np.uint64 and bool((values > _MOST_INTEGER).any())
    return zero_copy.to_arrow(np.ascontiguousarray(values, np.uint64 if is_larger else np.int64))


def _texts(column: Ragged) -> pa.Array:
    array = _bytes(pa.string(), column)
    array.validate(full=True)  # raises a ValueError for what is no UTF-8
    return array


def _list(definitions: Definitions, type_: Array, column: Column) -> pa.Array:
    numbers = numbers_in(type_)
    if isinstance(column, np.ndarray):  # numbers in an array of one length, [N, length]
        column = Ragged.behind_each_other(column.reshape(-1), np.full(len(column), column.shape[1], np.int64))
    if numbers is not None and numbers.name == "uint8":
        return _bytes(pa.binary(), column)
    starts, lengths = column.starts, column.lengths
    total = int(lengths.sum())
    if not total:
        return _lists(pa.nulls(0), lengths)
    # Items that lie behind each other are used as they are; only others are gathered, which copies.
    is_whole = int(starts[0]) == 0 and bool((starts[1:] == (starts + lengths)[:-1]).all())
    is_whole = is_whole and count(column.items) == total
    items = column.items if is_whole else pick(column.items, ranges(starts, lengths))
    return _lists(_array(definitions, type_.of, items), lengths)


def _lists(items: pa.Array, lengths: Indices) -> pa.Array:
    """Return lists; those of numbers that all have one length are of fixed size."""
    is_vector = pa.types.is_integer(items.type) or pa.types.is_floating(items.type)
    if is_vector and bool((lengths == lengths[0]).all()):
        return pa.FixedSizeListArray.from_arrays(items, int(lengths[0]))
    return pa.ListArray.from_arrays(zero_copy.to_arrow(_offsets(lengths)), items)


def _offsets(lengths: Indices) -> npt.NDArray[np.int32]:
    offsets = np.concatenate(([0], np.cumsum(lengths)))
    if offsets[-1] > _MOST_BYTES:
        raise ValueError("a column is longer than Arrow counts")
    return offsets.astype(np.int32)


def _bytes(type_: pa.DataType, column: Ragged) -> pa.Array:
    """Return values that are bytes, or texts in UTF-8."""
    offsets = _offsets(column.lengths)
    buffers = [None, pa.py_buffer(offsets), pa.py_buffer(_behind_each_other(column))]
    return pa.Array.from_buffers(type_, len(column.lengths), buffers)


def _behind_each_other(column: Ragged) -> Any:
    """Return the bytes of all values in one piece."""
    data, starts, lengths = column.items, column.starts, column.lengths
    if int(lengths.sum()) < _LARGE_BYTES * len(lengths):
        return data[ranges(starts, lengths)]
    ends = (starts + lengths).tolist()
    whole = np.ascontiguousarray(data).data
    return b"".join([whole[start:end] for start, end in zip(starts.tolist(), ends, strict=True)])
