"""Turns the columns of a message that our export made back into the rows that they came from."""

from __future__ import annotations

from typing import Any

import numpy as np

from ....codecs.ros.message_columns import Column, Ragged, count
from ....rows import packed_arrays
from ....rows.json_text import loads_any, restore
from ....rows.plain_row import TIME_KEY
from .fill import VALUE_KEY
from .lossless import INTEGER, NONE, PRESENT, ROW_KEY, STATE, Message, MessageField

Row = dict[str, Any]


def rows(message: Message, column: dict[str, Column]) -> list[Row]:
    """Return the rows of messages, `_ts` last.

    Raises:
        ValueError: They hold values that their definition does not allow.
    """
    times = column["ts"].tolist()
    restored = _dicts(message, column, len(times))
    for row, time in zip(restored, times, strict=True):
        row[TIME_KEY] = time
    return restored


def plain(message: Message, column: dict[str, Column]) -> dict[str, Any] | None:
    """Return the fields as arrays [N, ...] by key, or None if they are not all numbers that every row has."""
    arrays: dict[str, Any] = {}
    for number, field in enumerate(message.fields):
        is_whole = field.shape is not None and field.message is None and field.integers is None
        if not is_whole or (not field.is_array and field.kind not in ("bool", "int64", "uint64", "float64")):
            return None
        if message.is_stated and not (column[STATE][:, number] == PRESENT).all():
            return None
        array = column[field.name].reshape(-1, *field.shape)  # type: ignore[misc]  # it has one
        if field.shape and packed_arrays.is_large(array[:1].reshape(field.shape)) != field.is_array:
            return None  # large columns become arrays, and these are lists
        arrays[field.key] = array.astype(np.bool_) if field.kind == "bool" else array
    return arrays


def _dicts(message: Message, column: dict[str, Column], number_of_rows: int) -> list[Row]:
    if len(message.fields) == 1 and message.fields[0].key == ROW_KEY:
        return [_row(value) for value in _values(message.fields[0], column)]
    dicts: list[Row] = [{} for _ in range(number_of_rows)]
    for number, field in enumerate(message.fields):
        values = _values(field, column)
        if not message.is_stated:
            for row, value in zip(dicts, values, strict=True):
                row[field.key] = value
            continue
        for row, value, state in zip(dicts, values, column[STATE][:, number].tolist(), strict=True):
            if state == PRESENT:
                row[field.key] = value
            elif state == NONE:
                row[field.key] = None
            elif state == INTEGER:
                row[field.key] = int(value)
    return dicts


def _row(value: Any) -> Row:
    if not isinstance(value, dict):
        raise ValueError(f"a row is an object, not {value!r}")
    return value


def _values(field: MessageField, column: dict[str, Column]) -> list[Any]:
    """Return a field's values as Python has them."""
    values = column[field.name]
    if field.kind == "bytes" or (field.kind in ("string", "json") and field.shape == ()):
        return _blobs(field.kind, values)
    if field.shape is None:
        return _lists(field, values, column)
    if field.message is not None:
        return _dicts(field.message, values, count(values))
    array = values.astype(np.bool_) if field.kind == "bool" else values
    if field.is_array:
        # Copies, because a view would keep the bytes of a whole block of messages in memory.
        return [each.copy() for each in array.reshape(-1, *(field.shape or ()))]
    listed = array.reshape(-1, *field.shape).tolist() if field.shape else array.tolist()
    if field.integers is None:
        return list(listed)
    marks = column[field.integers].reshape(-1, *field.shape).tolist()
    return [_marked(value, mark) for value, mark in zip(listed, marks, strict=True)]


def _lists(field: MessageField, values: Ragged, column: dict[str, Column]) -> list[Any]:
    if field.message is not None:
        flat: list[Any] = _dicts(field.message, values.items, count(values.items))
    elif field.kind == "string":
        flat = _blobs(field.kind, values.items)
    else:
        items = values.items.astype(np.bool_) if field.kind == "bool" else values.items
        flat = items.tolist()
    ends = (values.starts + values.lengths).tolist()
    listed = [flat[start:end] for start, end in zip(values.starts.tolist(), ends, strict=True)]
    if field.integers is None:
        return listed
    marks = column[field.integers]
    spans = zip(marks.starts.tolist(), (marks.starts + marks.lengths).tolist(), strict=True)
    all_marks = marks.items.tolist()
    return [_marked(value, all_marks[start:end]) for value, (start, end) in zip(listed, spans, strict=True)]


def _marked(value: Any, mark: Any) -> Any:
    """Return a list of doubles with integers where the marks say so."""
    if isinstance(value, list):
        return [_marked(inner, mark_) for inner, mark_ in zip(value, mark, strict=True)]
    return int(value) if mark else value


def _blobs(kind: str, values: Ragged) -> list[Any]:
    data = values.items.tobytes()
    ends = (values.starts + values.lengths).tolist()
    cut = [data[start:end] for start, end in zip(values.starts.tolist(), ends, strict=True)]
    if kind == "bytes":
        return cut
    return [text.decode() for text in cut] if kind == "string" else [_from_json(text) for text in cut]


def _from_json(text: bytes) -> Any:
    value = loads_any(text)
    return restore(value)[VALUE_KEY] if isinstance(value, dict) and VALUE_KEY in value else value
