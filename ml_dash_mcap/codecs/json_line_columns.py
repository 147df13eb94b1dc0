"""Makes the columns that `rows.table` would make of rows from what pyarrow reads out of lines of JSON."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from ..rows import zero_copy
from ..rows.shape import EXACT_INTEGER
from ..rows.typed_columns import tight


def flatten(table: pa.Table, *, are_own: bool) -> dict[str, pa.Array] | None:
    """Return the columns of a table by dotted name, the keys of dicts as columns of their own; None if that loses one.

    Args:
        table: A table that was read in given types.
        are_own: Whether the types are those that `line_types` has learnt from the same lines: then no dict in a list
            lacks a key, and no integer among doubles is one that a double rounds.
    """
    flat: dict[str, pa.Array] = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        array = column.combine_chunks()
        if isinstance(array, pa.ChunkedArray):  # pyarrow before 15, for one chunk
            array = array.chunk(0)
        if not _put(flat, name, array, are_own):
            return None
    return flat


def _put(flat: dict[str, pa.Array], name: str, array: pa.Array, are_own: bool) -> bool:
    """Add a column, or a column for each key of a dict; returns whether nothing was lost."""
    if pa.types.is_struct(array.type) and array.null_count < len(array):
        inner = zip([array.type.field(at).name for at in range(array.type.num_fields)], array.flatten(), strict=True)
        return all(_put(flat, f"{name}.{key}", child, are_own) for key, child in inner)
    if name in flat or not _is_exact(array, are_own):
        return False
    flat[name] = tight(_settled(array))
    return True


def _is_exact(array: pa.Array, are_own: bool) -> bool:
    """Whether an array holds the values exactly in which `rows.table` would put them."""
    type_ = array.type
    if pa.types.is_floating(type_):
        return are_own or _is_safe(array)
    if pa.types.is_list(type_):
        return _is_exact(array.flatten(), are_own)
    if pa.types.is_struct(type_):  # a dict in a list
        return all((are_own or not child.null_count) and _is_exact(child, are_own) for child in array.flatten())
    return True


def _is_safe(array: pa.Array) -> bool:
    """Whether no value can have been an integer that a double rounds."""
    values = zero_copy.to_numpy(array.drop_null() if array.null_count else array)
    return not len(values) or bool(values.min() > -EXACT_INTEGER and values.max() < EXACT_INTEGER)


def _settled(array: pa.Array) -> pa.Array:
    """Return an array with the type null where it, or a list in it, has no values, whatever type that was read in."""
    type_ = array.type
    if array.null_count == len(array):
        return pa.nulls(len(array))
    if pa.types.is_struct(type_):
        children = [_settled(child) for child in array.flatten()]
        if [child.type for child in children] == [type_.field(at).type for at in range(type_.num_fields)]:
            return array
        names = [type_.field(at).name for at in range(type_.num_fields)]
        mask = pc.is_null(array) if array.null_count else None
        return pa.StructArray.from_arrays(children, names, mask=mask)
    if not pa.types.is_list(type_):
        return array
    inner = _settled(array.flatten())
    if inner.type == type_.value_type:
        return array
    lengths = zero_copy.to_numpy(pc.fill_null(pc.list_value_length(array), 0))
    offsets = zero_copy.to_arrow(np.concatenate(([0], np.cumsum(lengths))).astype(np.int32))
    return pa.ListArray.from_arrays(offsets, inner, mask=pc.is_null(array) if array.null_count else None)
