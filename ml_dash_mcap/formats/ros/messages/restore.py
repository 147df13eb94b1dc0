"""The columns of a message of ours back to the rows that they came from."""

from __future__ import annotations

from typing import Any

import numpy as np

from ....codecs.ros.message_columns import Column, Ragged, count
from ....rows import packed_arrays
from ....rows.encode import TIME_KEY
from ....rows.json_text import loads_any, restore
from .fill import VALUE_KEY
from .lossless import INTEGER, NONE, PRESENT, ROW_KEY, STATE, Message, MessageField

Row = dict[str, Any]


def rows(message: Message, column: dict[str, Column]) -> list[Row]:
    """Return the rows of messages, `_ts` last.

    Raises:
        ValueError: They hold what their definition does not say.
    """
    times = column["ts"].tolist()
    found = _dicts(message, column, len(times))
    for row, time in zip(found, times, strict=True):
        row[TIME_KEY] = time
    return found


def plain(message: Message, column: dict[str, Column]) -> dict[str, Any] | None:
    """Return the fields as arrays [N, ...] by key, or None if they are not all numbers that every row has."""
    arrays: dict[str, Any] = {}
    for number, one in enumerate(message.fields):
        is_whole = one.shape is not None and one.message is None and one.integers is None
        if not is_whole or (not one.is_array and one.kind not in ("bool", "int64", "uint64", "float64")):
            return None
        if message.is_stated and not (column[STATE][:, number] == PRESENT).all():
            return None
        array = column[one.name].reshape(-1, *one.shape)  # type: ignore[misc]  # it has one
        if one.shape and packed_arrays.is_large(array[:1].reshape(one.shape)) != one.is_array:
            return None  # large columns become arrays, and these are lists
        arrays[one.key] = array.astype(np.bool_) if one.kind == "bool" else array
    return arrays


def _dicts(message: Message, column: dict[str, Column], number_of_rows: int) -> list[Row]:
    if len(message.fields) == 1 and message.fields[0].key == ROW_KEY:
        return [_row(value) for value in _values(message.fields[0], column)]
    found: list[Row] = [{} for _ in range(number_of_rows)]
    for number, one in enumerate(message.fields):
        values = _values(one, column)
        if not message.is_stated:
            for row, value in zip(found, values, strict=True):
                row[one.key] = value
            continue
        for row, value, state in zip(found, values, column[STATE][:, number].tolist(), strict=True):
            if state == PRESENT:
                row[one.key] = value
            elif state == NONE:
                row[one.key] = None
            elif state == INTEGER:
                row[one.key] = int(value)
    return found


def _row(value: Any) -> Row:
    if not isinstance(value, dict):
        raise ValueError(f"a row is an object, not {value!r}")
    return value


def _values(one: MessageField, column: dict[str, Column]) -> list[Any]:
    """Return a field's values as Python has them."""
    values = column[one.name]
    if one.kind == "bytes" or (one.kind in ("string", "json") and one.shape == ()):
        return _blobs(one.kind, values)
    if one.shape is None:
        return _lists(one, values, column)
    if one.message is not None:
        return _dicts(one.message, values, count(values))
    array = values.astype(np.bool_) if one.kind == "bool" else values
    if one.is_array:
        return [each.copy() for each in array.reshape(-1, *(one.shape or ()))]
    listed = array.reshape(-1, *one.shape).tolist() if one.shape else array.tolist()
    if one.integers is None:
        return list(listed)
    marks = column[one.integers].reshape(-1, *one.shape).tolist()
    return [_marked(value, mark) for value, mark in zip(listed, marks, strict=True)]


def _lists(one: MessageField, values: Ragged, column: dict[str, Column]) -> list[Any]:
    if one.message is not None:
        flat: list[Any] = _dicts(one.message, values.items, count(values.items))
    elif one.kind == "string":
        flat = _blobs(one.kind, values.items)
    else:
        items = values.items.astype(np.bool_) if one.kind == "bool" else values.items
        flat = items.tolist()
    ends = (values.starts + values.lengths).tolist()
    listed = [flat[start:end] for start, end in zip(values.starts.tolist(), ends, strict=True)]
    if one.integers is None:
        return listed
    marks = column[one.integers]
    spans = zip(marks.starts.tolist(), (marks.starts + marks.lengths).tolist(), strict=True)
    said = marks.items.tolist()
    return [_marked(value, said[start:end]) for value, (start, end) in zip(listed, spans, strict=True)]


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
