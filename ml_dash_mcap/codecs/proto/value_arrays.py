"""Makes Arrow arrays of the bytes of many values, in the types that `rows.table` gives the same values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ...rows import typed_columns, zero_copy
from .layout import Kind, Member
from .row_encoder import decode_array
from .row_match import Bytes, Numbers, Values

_MOST_BYTES = 2**31 - 1
"""Arrow counts the bytes of texts, and the elements of lists, with 31 bits."""


class InexpressibleError(ValueError):
    """No column holds some values, or they are not what their type says."""


def of_values(member: Member, values: Sequence[Values]) -> pa.Array:
    """Return an array of the values of a field, those of a row one behind the other.

    Args:
        member: The field.
        values: One for each occurrence of the field in a row.

    Raises:
        InexpressibleError: There is no such array.
    """
    joined = values[0] if len(values) == 1 else interleaved(values)
    kind = member.slot.kind
    if kind is Kind.ARRAY:
        return _arrays(joined)
    content = joined.joined()
    if len(content) > _MOST_BYTES:
        raise InexpressibleError
    if member.slot.is_packed:
        counts = joined.lengths // kind.packed_bytes
        return _lists(numbers(kind, content), member.slot.lengths or (), counts, len(joined.starts))
    if kind in (Kind.TEXT, Kind.BYTES):
        return _texts(kind, content, joined)
    return numbers(kind, content)


def interleaved(values: Sequence[Values]) -> Values:
    """Return the values of several places of each row, those of a row one behind the other."""
    starts = np.stack([each.starts for each in values], axis=1).ravel()
    distinct = {each.lengths for each in values if isinstance(each.lengths, int)}
    if len(distinct) == 1 and all(isinstance(each.lengths, int) for each in values):
        return Values(values[0].data, starts, distinct.pop())
    return Values(values[0].data, starts, np.stack([each.each_length() for each in values], axis=1).ravel())


def numbers(kind: Kind, content: Bytes) -> pa.Array:
    """Return an array of packed numbers or booleans."""
    if kind is Kind.BOOL:
        return pa.array(content != 0)
    dtype = {Kind.DOUBLE: np.float64, Kind.INT: np.int64, Kind.UINT: np.uint64}[kind]
    values: npt.NDArray[Any] = content.view(np.dtype(dtype).newbyteorder("<")).astype(dtype, copy=False)
    if kind is Kind.UINT and not (len(values) and int(values.max()) >= 2**63):
        values = values.astype(np.int64)
    return zero_copy.to_arrow(values)


def listed(array: pa.Array, counts: Numbers | int, rows: int) -> pa.Array:
    """Cut an array into lists; they are of fixed size if they are of numbers, and all of one length.

    Args:
        array: The elements.
        counts: How many each list has, [N], or all.
        rows: How many lists.
    """
    if not len(array):
        return pa.ListArray.from_arrays(pa.array(np.zeros(rows + 1, np.int32)), pa.nulls(0))
    if not isinstance(counts, int) and bool((counts == counts[0]).all()):
        counts = int(counts[0])
    if isinstance(counts, int):
        if pa.types.is_integer(array.type) or pa.types.is_floating(array.type):
            return pa.FixedSizeListArray.from_arrays(array, counts)
        offsets = np.arange(rows + 1, dtype=np.int32) * np.int32(counts)
    else:
        offsets = _offsets(counts)
    return pa.ListArray.from_arrays(zero_copy.to_arrow(offsets), array)


def _lists(array: pa.Array, lengths: tuple[int, ...], counts: Numbers | int, rows: int) -> pa.Array:
    """Cut the elements of lists of lists into these."""
    if len(array):
        for length in reversed(lengths):
            array = listed(array, length, len(array) // length)
            counts = counts // length
    return listed(array, counts, rows)


def _offsets(counts: Numbers) -> npt.NDArray[np.int32]:
    return np.concatenate(([0], np.cumsum(counts))).astype(np.int32)


def _texts(kind: Kind, content: Bytes, values: Values) -> pa.Array:
    offsets = zero_copy.to_arrow(_offsets(values.each_length())).buffers()[1]
    type_ = pa.string() if kind is Kind.TEXT else pa.binary()
    array = pa.Array.from_buffers(type_, len(values.starts), [None, offsets, pa.py_buffer(content)])
    if kind is Kind.TEXT and bool((content >= 0x80).any()):
        try:
            array.validate(full=True)
        except pa.ArrowInvalid as error:
            raise InexpressibleError from error
    return array


def _arrays(values: Values) -> pa.Array:
    """Return the lists of large arrays, which are few: each has thousands of elements."""
    data, starts = values.data.tobytes(), values.starts.tolist()
    try:
        arrays = [
            decode_array(data, start, start + length)
            for start, length in zip(starts, values.each_length().tolist(), strict=True)
        ]
    except ValueError as error:
        raise InexpressibleError from error
    column = typed_columns.of_python(arrays)
    if column.is_text:
        raise InexpressibleError
    return column.array
