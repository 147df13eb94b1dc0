"""Arrow columns as numpy arrays, each of the shape that one row's value has."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

_EXACT_INTEGERS = 2**53


def from_table(table: pa.Table) -> dict[str, npt.NDArray[Any]]:
    """Return the columns of a table by name.

    Numbers are `[N]`, vectors of one length `[N, 7]`, matrices `[N, 4, 4]`. A missing number is NaN, and so is each
    element of a missing vector or matrix; integers become doubles then, or objects if a double would round one. All
    else, such as text, bytes and lists of various lengths, is an object array `[N]` with None for what is missing.
    """
    return {name: _array(whole(column)) for name, column in zip(table.column_names, table.columns, strict=True)}


def whole(column: pa.ChunkedArray) -> pa.Array:
    """Return a column as one array."""
    if column.num_chunks == 1:
        return column.chunk(0)
    return pa.concat_arrays(column.chunks) if column.num_chunks else pa.array([], column.type)


def _array(array: pa.Array) -> npt.NDArray[Any]:
    shape, leaf = shape_of(array)
    if shape is not None:
        flat = _numbers(leaf)
        if flat is not None:
            return _with_gaps(flat, array, shape)
    found = np.empty(len(array), object)
    for place, value in enumerate(array.to_pylist()):
        found[place] = value
    return found


def shape_of(array: pa.Array) -> tuple[tuple[int, ...] | None, pa.Array]:
    """Return the shape of each value and the array of all their elements; None if the shapes differ."""
    type_ = array.type
    if pa.types.is_list(type_) or pa.types.is_fixed_size_list(type_):
        lengths = pc.unique(pc.drop_null(pc.list_value_length(array))).to_pylist()
        elements = array.flatten()
        if len(lengths) != 1 or (elements.null_count and pa.types.is_nested(elements.type)):
            return None, array
        inner, leaf = shape_of(elements)
        return (None if inner is None else (int(lengths[0]), *inner)), leaf
    return (), array


def _numbers(leaf: pa.Array) -> npt.NDArray[Any] | None:
    """Return numbers or booleans as they are, missing ones as NaN; None for all else."""
    type_ = leaf.type
    if pa.types.is_boolean(type_):
        return None if leaf.null_count else np.asarray(leaf.to_numpy(zero_copy_only=False))
    if pa.types.is_null(type_):
        return np.full(len(leaf), np.nan)
    if not (pa.types.is_integer(type_) or pa.types.is_floating(type_)):
        return None
    if pa.types.is_integer(type_) and leaf.null_count and not _fits_doubles(leaf):
        return None
    return np.array(leaf.to_numpy(zero_copy_only=False))


def _fits_doubles(leaf: pa.Array) -> bool:
    range_ = pc.min_max(leaf).as_py()
    return range_["min"] is None or -_EXACT_INTEGERS <= range_["min"] <= range_["max"] <= _EXACT_INTEGERS


def _with_gaps(flat: npt.NDArray[Any], array: pa.Array, shape: tuple[int, ...]) -> npt.NDArray[Any]:
    """Put the elements into shape, NaN where a whole vector or matrix is missing."""
    if not shape or not array.null_count:
        return flat.reshape(len(array), *shape)
    present = array.is_valid().to_numpy(zero_copy_only=False)
    found = np.full((len(array), *shape), np.nan)
    found[present] = flat.reshape(-1, *shape)
    return found
