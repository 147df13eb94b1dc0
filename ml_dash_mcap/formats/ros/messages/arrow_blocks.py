"""Turns blocks of Arrow columns, which hold exactly the values of rows, into the columns of their message."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from ....codecs.ros.message_columns import Column, Ragged
from ....rows.arrow_types import is_list, of_array
from ....rows.plain_row import TIME_KEY
from ....rows.shape import EXACT_INTEGER, Shape, of_dicts
from ....rows.table import Block
from . import fill
from .fill import MisfitError
from .lossless import INTEGER, MISSING, PRESENT, STATE, Message, MessageField

_NUMBERS = {"bool": pa.bool_(), "int64": pa.int64(), "uint64": pa.uint64(), "float64": pa.float64()}


def shape_of(block: Block) -> Shape:
    """Return the shape of a block's rows."""
    return _shape({name: column.array for name, column in block.columns.items()})


def _shape(columns: Mapping[str, Any]) -> Shape:
    """Return the shape of dicts whose fields lie in columns with dotted names."""
    fields: dict[str, Any] = {}
    for name, array in columns.items():
        key, dot, rest = name.partition(".")
        if dot:
            fields.setdefault(key, {})[rest] = array
        else:
            fields[key] = array
    return of_dicts({key: _shape(some) if isinstance(some, dict) else of_array(some) for key, some in fields.items()})


def fill_block(message: Message, block: Block) -> dict[str, Column]:
    """Return the fields of messages for a block's rows, but for their header and time stamp.

    Raises:
        MisfitError: A row has something that the message cannot say.
    """
    left = {name for name in block.columns if name != TIME_KEY}
    columns = _fill(message, block, "", left)
    if left:
        raise MisfitError
    return columns


def _fill(message: Message, block: Block, prefix: str, left: set[str]) -> dict[str, Column]:
    states = np.full((block.count, len(message.fields)), PRESENT, np.uint8)
    columns: dict[str, Column] = {}
    for number, field in enumerate(message.fields):
        name = prefix + field.key
        column = block.columns.get(name)
        if field.message is not None and field.shape == () and any(other.startswith(name + ".") for other in left):
            columns[field.name] = _fill(field.message, block, name + ".", left)
        elif column is None or name not in left:
            states[:, number] = MISSING
            columns.update(fill.column(field, [fill.default(field)] * block.count, np.zeros(block.count, np.uint8)))
        else:
            left.discard(name)
            columns.update(_column(field, column.array, states[:, number]))
    if message.is_stated:
        return {STATE: states, **columns}
    if (states != PRESENT).any():
        raise MisfitError
    return columns


def _column(field: MessageField, array: Any, states: npt.NDArray[np.uint8]) -> dict[str, Column]:
    """Return a field's column and the column that marks its integer elements; marks integers in `states`."""
    if field.kind == "string" and field.shape == () and pa.types.is_string(array.type):
        return {field.name: _texts(array)}
    if field.kind in _NUMBERS:
        columns = _ragged(field, array) if field.shape is None else _fixed(field, array)
        if columns is not None:
            if field.shape == () and field.kind == "float64" and pa.types.is_integer(array.type):
                states[:] = INTEGER
            return columns
    return fill.column(field, array.to_pylist(), states)


def _fixed(field: MessageField, array: Any) -> dict[str, Column] | None:
    shape: list[int] = []
    while pa.types.is_fixed_size_list(array.type):
        shape.append(array.type.list_size)
        array = array.flatten()
    if tuple(shape) != field.shape:
        return None
    return _numbers(field, array, lambda flat: flat.reshape(-1, int(np.prod(shape))) if shape else flat)


def _ragged(field: MessageField, array: Any) -> dict[str, Column] | None:
    if not is_list(array.type):
        return None
    lengths = pc.list_value_length(array).to_numpy(zero_copy_only=False).astype(np.int64)
    inner = array.flatten()
    return _numbers(field, inner, lambda flat: Ragged.behind_each_other(flat, lengths)) if len(inner) else None


def _numbers(field: MessageField, array: Any, shape: Any) -> dict[str, Column] | None:
    is_other = field.kind == "float64" and pa.types.is_integer(array.type)
    if array.type != _NUMBERS[field.kind] and not is_other:
        return None
    flat = array.to_numpy(zero_copy_only=False)
    if is_other and (field.shape != () and field.integers is None):
        return None
    # A double holds integers up to 2**53 exactly; larger ones would change.
    if is_other and len(flat) and not -EXACT_INTEGER <= int(flat.min()) <= int(flat.max()) <= EXACT_INTEGER:
        return None
    numbers = {field.name: shape(flat.astype(np.float64) if is_other else flat)}
    if field.integers is not None:
        numbers[field.integers] = shape(np.full(len(flat), is_other, np.uint8))
    return numbers


def _texts(array: Any) -> Ragged:
    _, places, data = array.buffers()
    # The buffers are read directly: `to_pylist` would make a Python text of each value and encode it again.
    offsets = np.frombuffer(places, np.int32)[array.offset : array.offset + len(array) + 1].astype(np.int64)
    items = np.frombuffer(data, np.uint8) if data is not None else np.empty(0, np.uint8)
    if not items[offsets[0] : offsets[-1]].all():
        # ROS's texts end at a NUL, so a text with one in it needs another place.
        raise MisfitError  # a NUL
    return Ragged(items, offsets[:-1], np.diff(offsets))


def to_rows(block: Block) -> list[dict[str, Any]]:
    """Return a block's rows, nested, `_ts` last."""
    names = [name for name in block.columns if name != TIME_KEY]
    rows: list[dict[str, Any]] = []
    columns = [block.columns[name].array.to_pylist() for name in (*names, TIME_KEY)]
    paths = [name.split(".") for name in names]
    for *values, time in zip(*columns, strict=True):
        row: dict[str, Any] = {}
        for path, value in zip(paths, values, strict=True):
            inner = row
            for key in path[:-1]:
                inner = inner.setdefault(key, {})
            inner[path[-1]] = value
        row[TIME_KEY] = time
        rows.append(row)
    return rows
