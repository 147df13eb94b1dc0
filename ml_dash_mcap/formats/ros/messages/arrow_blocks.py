"""Blocks of Arrow columns that say exactly what rows say, to the columns of their message."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from ....codecs.ros.message_columns import Column, Ragged
from ....rows.encode import TIME_KEY
from ....rows.table import Block
from . import fill
from .fill import MisfitError
from .forms import SAFE_INTEGER, Form
from .lossless import INTEGER, MISSING, PRESENT, STATE, Field, Message

_NUMBERS = {"bool": pa.bool_(), "int64": pa.int64(), "uint64": pa.uint64(), "float64": pa.float64()}


def take_in(form: Form, block: Block) -> None:
    """Add a block's rows to the form of their topic."""
    form.kinds.add(dict)
    form.count += block.count
    form.dicts += block.count
    parents: set[str] = set()
    for name, column in block.columns.items():
        if name == TIME_KEY:
            continue
        *path, last = name.split(".")
        inner, at = form, ""
        for key in path:
            inner, at = inner.field(key), f"{at}.{key}"
            if at not in parents:
                parents.add(at)
                inner.kinds.add(dict)
                inner.count += block.count
                inner.dicts += block.count
        _take_in(inner.field(last), column.array)


def _take_in(form: Form, array: Any) -> None:
    type_ = array.type
    if pa.types.is_floating(type_):
        form.kinds.add(float)
    elif pa.types.is_integer(type_):
        form.kinds.add(int)
        if len(array):
            bounds = pc.min_max(array)
            form.bound(bounds["min"].as_py(), bounds["max"].as_py())
    elif pa.types.is_boolean(type_):
        form.kinds.add(bool)
    elif pa.types.is_list(type_) or pa.types.is_fixed_size_list(type_):
        form.kinds.add(list)
        if len(array):
            lengths = pc.min_max(pc.list_value_length(array))
            form.lengths(lengths["min"].as_py(), lengths["max"].as_py())
            inner = array.flatten()
            if len(inner):
                _take_in(form.elements(), inner)
    else:
        for value in array.to_pylist():
            form.add(value)
        return
    form.count += len(array)


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
    for number, one in enumerate(message.fields):
        name = prefix + one.key
        column = block.columns.get(name)
        if one.message is not None and one.shape == () and any(other.startswith(name + ".") for other in left):
            columns[one.name] = _fill(one.message, block, name + ".", left)
        elif column is None or name not in left:
            states[:, number] = MISSING
            columns.update(fill.column(one, [fill.default(one)] * block.count, np.zeros(block.count, np.uint8)))
        else:
            left.discard(name)
            columns.update(_column(one, column.array, states[:, number]))
    if message.is_stated:
        return {STATE: states, **columns}
    if (states != PRESENT).any():
        raise MisfitError
    return columns


def _column(one: Field, array: Any, states: npt.NDArray[np.uint8]) -> dict[str, Column]:
    """Return a field's column, and the one that says which elements are integers; marks integers in `states`."""
    if one.kind == "string" and one.shape == () and pa.types.is_string(array.type):
        return {one.name: _texts(array)}
    if one.kind in _NUMBERS:
        found = _ragged(one, array) if one.shape is None else _fixed(one, array)
        if found is not None:
            if one.shape == () and one.kind == "float64" and pa.types.is_integer(array.type):
                states[:] = INTEGER
            return found
    return fill.column(one, array.to_pylist(), states)


def _fixed(one: Field, array: Any) -> dict[str, Column] | None:
    shape: list[int] = []
    while pa.types.is_fixed_size_list(array.type):
        shape.append(array.type.list_size)
        array = array.flatten()
    if tuple(shape) != one.shape:
        return None
    return _numbers(one, array, lambda flat: flat.reshape(-1, int(np.prod(shape))) if shape else flat)


def _ragged(one: Field, array: Any) -> dict[str, Column] | None:
    if not (pa.types.is_list(array.type) or pa.types.is_fixed_size_list(array.type)):
        return None
    lengths = pc.list_value_length(array).to_numpy(zero_copy_only=False).astype(np.int64)
    inner = array.flatten()
    return _numbers(one, inner, lambda flat: Ragged.behind_each_other(flat, lengths)) if len(inner) else None


def _numbers(one: Field, array: Any, shape: Any) -> dict[str, Column] | None:
    is_other = one.kind == "float64" and pa.types.is_integer(array.type)
    if array.type != _NUMBERS[one.kind] and not is_other:
        return None
    flat = array.to_numpy(zero_copy_only=False)
    if is_other and (one.shape != () and one.integers is None):
        return None
    if is_other and len(flat) and not -SAFE_INTEGER <= int(flat.min()) <= int(flat.max()) <= SAFE_INTEGER:
        return None
    numbers = {one.name: shape(flat.astype(np.float64) if is_other else flat)}
    if one.integers is not None:
        numbers[one.integers] = shape(np.full(len(flat), is_other, np.uint8))
    return numbers


def _texts(array: Any) -> Ragged:
    _, places, data = array.buffers()
    offsets = np.frombuffer(places, np.int32)[array.offset : array.offset + len(array) + 1].astype(np.int64)
    items = np.frombuffer(data, np.uint8) if data is not None else np.empty(0, np.uint8)
    if not items[offsets[0] : offsets[-1]].all():
        raise MisfitError  # a NUL
    return Ragged(items, offsets[:-1], np.diff(offsets))


def to_rows(block: Block) -> list[dict[str, Any]]:
    """Return a block's rows, nested, `_ts` last."""
    names = [name for name in block.columns if name != TIME_KEY]
    found: list[dict[str, Any]] = []
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
        found.append(row)
    return found
