"""Converts Arrow columns into numpy arrays, each of the shape that one row's value has."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from . import packed_arrays
from .arrow_types import is_list, is_number
from .typed_columns import Column, is_json, leaves, values_of, whole

_MOST_LISTS = 31
"""Lists in lists that an array has room for, as dimensions behind the one of the rows: numpy 1 has 32."""


def from_table(table: pa.Table) -> dict[str, npt.NDArray[Any]]:
    """Return the columns of a table by name.

    Numbers are `[N]`, vectors of one length `[N, 7]`, matrices `[N, 4, 4]`. A missing fraction is NaN, and so is each
    element of a missing vector or matrix of fractions. Integers and booleans have no such value: where one is missing
    they are masked arrays. All else, such as text, bytes and lists of various lengths, is an object array `[N]` with
    None for what is missing; so are columns of JSON text, with the values that it says.
    """
    return {
        field.name: _decoded(column) if is_json(field) else _array(whole(column))
        for field, column in zip(table.schema, table.columns, strict=True)
    }


def _decoded(column: pa.ChunkedArray) -> npt.NDArray[Any]:
    return _of_objects(values_of(Column(column, is_text=True)))


def doubles(array: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """Return numbers as doubles, with NaN for masked ones."""
    if not isinstance(array, np.ma.MaskedArray):
        return array.astype(np.float64)
    return np.where(np.ma.getmaskarray(array), np.nan, np.ma.getdata(array).astype(np.float64))


def _array(array: pa.Array) -> npt.NDArray[Any]:
    shape, leaf = common_shape(array)
    if shape is not None and len(shape) <= _MOST_LISTS:
        flat = _numbers(leaf)
        if flat is not None:
            return _with_gaps(flat, array, shape)
    return objects(array)


def is_large(column: pa.ChunkedArray | pa.Array) -> bool:
    """Whether the values of a column come from large arrays: lists of many numbers each."""
    elements = leaves(whole(column))
    if elements.type == column.type or not (is_number(elements.type) or pa.types.is_boolean(elements.type)):
        return False
    return len(elements) > packed_arrays.MOST_LISTED * max(len(column), 1)


def cells(column: pa.ChunkedArray | pa.Array) -> list[Any]:
    """Return the arrays of a column that `is_large`, one a row; None where there is none, lists if they are ragged."""
    array = whole(column)
    made = [_array(array.slice(at, 1)) if array[at].is_valid else None for at in range(len(array))]
    return [None if array is None else array[0] for array in made]


def objects(array: pa.Array) -> npt.NDArray[Any]:
    """Return values as Python objects, [N], with None for missing ones."""
    return _of_objects(array.to_pylist())


def _of_objects(values: list[Any]) -> npt.NDArray[Any]:
    # np.array(values, object) would make a matrix of lists that have one length.
    objects_ = np.empty(len(values), object)
    for place, value in enumerate(values):
        objects_[place] = value
    return objects_


def common_shape(array: pa.Array) -> tuple[tuple[int, ...] | None, pa.Array]:
    """Return the shape of each value and the array of all their elements; None if the shapes differ."""
    type_ = array.type
    if is_list(type_):
        lengths = pc.unique(pc.drop_null(pc.list_value_length(array))).to_pylist()
        elements = array.flatten()
        if len(lengths) != 1 or (elements.null_count and pa.types.is_nested(elements.type)):
            return None, array
        inner, leaf = common_shape(elements)
        return (None if inner is None else (int(lengths[0]), *inner)), leaf
    return (), array


def _numbers(leaf: pa.Array) -> npt.NDArray[Any] | None:
    """Return numbers or booleans as they are, missing ones as NaN or masked; None for all else."""
    type_ = leaf.type
    if pa.types.is_null(type_):
        return np.full(len(leaf), np.nan)
    # np.array copies here and below, because arrays over Arrow's memory are read-only.
    if pa.types.is_floating(type_):
        return np.array(leaf.to_numpy(zero_copy_only=False))
    if not (pa.types.is_integer(type_) or pa.types.is_boolean(type_)):
        return None
    if not leaf.null_count:
        return np.array(leaf.to_numpy(zero_copy_only=False))
    values = np.array(leaf.fill_null(_nothing(type_)).to_numpy(zero_copy_only=False))
    return np.ma.MaskedArray(values, leaf.is_null().to_numpy(zero_copy_only=False))


def _nothing(type_: pa.DataType) -> int:
    """Return the number to put under a mask: an extreme one, which is noticed if the mask is removed."""
    if pa.types.is_boolean(type_):
        return False
    limits = np.iinfo(type_.to_pandas_dtype())
    return int(limits.min if limits.min else limits.max)


def _with_gaps(flat: npt.NDArray[Any], array: pa.Array, shape: tuple[int, ...]) -> npt.NDArray[Any]:
    """Put the elements into shape; where a whole vector or matrix is missing, so is each of its elements."""
    if not shape or not array.null_count:
        return flat.reshape(len(array), *shape)
    present = array.is_valid().to_numpy(zero_copy_only=False)
    part = (int(np.count_nonzero(present)), *shape)
    if flat.dtype.kind == "f":
        fractions = np.full((len(array), *shape), np.nan, flat.dtype)
        fractions[present] = flat.reshape(part)
        return fractions
    nothing = _nothing(pa.from_numpy_dtype(flat.dtype))
    values = np.full((len(array), *shape), nothing, flat.dtype)
    mask = np.ones(values.shape, np.bool_)
    values[present] = np.ma.getdata(flat).reshape(part)
    mask[present] = np.ma.getmaskarray(flat).reshape(part)
    return np.ma.MaskedArray(values, mask)
