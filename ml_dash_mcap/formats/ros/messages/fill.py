"""Turns rows into the columns of the message that holds everything that they hold."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np
import numpy.typing as npt

from ....codecs.ros.message_columns import Column, Ragged, texts
from ....rows import packed_arrays
from ....rows.json_text import dumps_any, exact_as_read, loads_any
from ....rows.plain_row import EXACT_KEY, TIME_KEY, has_lone_surrogates
from ....rows.shape import EXACT_INTEGER
from .lossless import INTEGER, MISSING, NONE, PRESENT, ROW_KEY, STATE, Message, MessageField

Row = Mapping[str, Any]

_NOT_THERE: Any = object()
_KINDS = {"bool": bool, "int64": int, "uint64": int, "float64": float}
_DTYPES = {"bool": np.uint8, "int64": np.int64, "uint64": np.uint64, "float64": np.float64}
_RANGES = {"int64": (-(2**63), 2**63 - 1), "uint64": (0, 2**64 - 1)}
_NOTHING = {"bool": False, "int64": 0, "uint64": 0, "float64": 0.0, "string": "", "bytes": b"", "json": ""}

VALUE_KEY = "_value"
"""Holds a value with NaN, infinities or bytes in it in a JSON field, beside the side key `_exact`."""


class MisfitError(Exception):
    """Rows have something that the message has no place for. A message designed from all rows has a place."""


def fill(message: Message, rows: Sequence[Row]) -> dict[str, Column]:
    """Return the fields of messages for rows, but for their header and time stamp.

    Raises:
        MisfitError: A row has something that the message cannot say.
    """
    if len(message.fields) == 1 and message.fields[0].key == ROW_KEY and message.fields[0].kind == "json":
        return {message.fields[0].name: texts([_row_text(row) for row in rows])}
    keys = {field.key for field in message.fields}
    for row in rows:
        if not row.keys() - {TIME_KEY} <= keys:
            raise MisfitError
    states = np.full((len(rows), len(message.fields)), PRESENT, np.uint8)
    columns: dict[str, Column] = {}
    for number, field in enumerate(message.fields):
        values = [row.get(field.key, _NOT_THERE) for row in rows]
        states[:, number] = _states(values)
        columns.update(column(field, values, states[:, number]))
    if message.is_stated:
        return {STATE: states, **columns}
    if (states != PRESENT).any():
        raise MisfitError
    return columns


def _row_text(row: Row) -> str:
    return _json({key: value for key, value in row.items() if key != TIME_KEY})


def _states(values: list[Any]) -> npt.NDArray[np.uint8]:
    return np.fromiter(
        (MISSING if value is _NOT_THERE else NONE if value is None else PRESENT for value in values),
        np.uint8,
        len(values),
    )


def column(field: MessageField, values: list[Any], states: npt.NDArray[np.uint8]) -> dict[str, Column]:
    """Return a field's column and the column that marks its integer elements.

    Args:
        field: The field.
        values: Of each message; anything where `states` does not say PRESENT.
        states: The states of the field, [N]; set to INTEGER for integers among doubles.
    """
    if not (states == PRESENT).all():
        nothing = default(field)
        values = [nothing if state != PRESENT else value for value, state in zip(values, states.tolist(), strict=True)]
    if field.kind == "json":
        return {field.name: texts([_json(value) for value in values])}
    if field.is_array:
        return {field.name: _arrays(field, values)}
    if field.shape == ():
        # `type` instead of `isinstance`: a bool is an int for Python and must not become a number here.
        if field.kind == "float64" and int in set(map(type, values)):
            are_integers = np.fromiter((type(value) is int for value in values), np.bool_, len(values))
            states[are_integers & (states == PRESENT)] = INTEGER
            return {field.name: _numbers(field.kind, values, allows_integers=True)}
        return {field.name: _flat(field, values)}
    if field.shape is not None:
        flat, size = _flatten(values, field.shape), math.prod(field.shape)
        return _with_integers(field, flat, lambda column: column.reshape(len(values), size))
    _check(values, list)
    lengths = np.fromiter(map(len, values), np.int64, len(values))
    return _with_integers(field, list(chain.from_iterable(values)), lambda col: Ragged.behind_each_other(col, lengths))


def _arrays(field: MessageField, values: list[Any]) -> Column:
    """Return arrays of one type and shape as a column, [N, k]."""
    wanted = f"{field.kind}[{','.join(map(str, field.shape or ()))}]"
    if any(not isinstance(value, np.ndarray) or packed_arrays.spelling(value) != wanted for value in values):
        raise MisfitError
    stacked = np.stack(values).reshape(len(values), -1)
    return stacked.view(np.uint8) if field.kind == "bool" else stacked


def _with_integers(field: MessageField, flat: list[Any], shape: Callable[[Column], Column]) -> dict[str, Column]:
    if field.integers is None:
        return {field.name: shape(_flat(field, flat))}
    marks = np.fromiter((type(value) is int for value in flat), np.uint8, len(flat))
    return {field.name: shape(_numbers(field.kind, flat, allows_integers=True)), field.integers: shape(marks)}


def _flat(field: MessageField, values: list[Any]) -> Column:
    """Return values of a field, or elements of its lists, as a column."""
    if field.message is not None:
        _check(values, dict)
        return fill(field.message, values)
    if field.kind == "string":
        _check(values, str)
        if any("\0" in value or has_lone_surrogates(value) for value in values):
            raise MisfitError
        return texts(values)
    if field.kind == "bytes":
        _check(values, bytes)
        lengths = np.fromiter(map(len, values), np.int64, len(values))
        return Ragged.behind_each_other(np.frombuffer(b"".join(values), np.uint8), lengths)
    return _numbers(field.kind, values, allows_integers=False)


def _numbers(kind: str, values: list[Any], *, allows_integers: bool) -> npt.NDArray[Any]:
    types = set(map(type, values))
    if not types <= ({float, int} if allows_integers else {_KINDS[kind]}):
        raise MisfitError
    if kind in _RANGES and values and not _RANGES[kind][0] <= min(values) <= max(values) <= _RANGES[kind][1]:
        raise MisfitError
    if allows_integers:
        for value in values:
            # A double holds integers up to 2**53 exactly; larger ones would change.
            if type(value) is int and not -EXACT_INTEGER <= value <= EXACT_INTEGER:
                raise MisfitError
    return np.array(values, _DTYPES[kind])


def _flatten(values: list[Any], shape: tuple[int, ...]) -> list[Any]:
    for length in shape:
        _check(values, list)
        if set(map(len, values)) - {length}:
            raise MisfitError
        values = list(chain.from_iterable(values))
    return values


def _check(values: list[Any], kind: type) -> None:
    if set(map(type, values)) - {kind}:
        raise MisfitError


def default(field: MessageField) -> Any:
    """Return what stands for a value that is not there."""
    if field.shape is None:
        return []
    if field.is_array:
        return np.zeros(field.shape or (), field.kind)
    if field.message is not None:
        return {inner.key: default(inner) for inner in field.message.fields}
    value = _NOTHING[field.kind]
    for length in reversed(field.shape):
        value = [value] * length
    return value


def _json(value: Any) -> str:
    """Say a value as JSON; one that JSON cannot say is wrapped as `{"_value": ..., "_exact": ...}`."""
    row = loads_any(exact_as_read({VALUE_KEY: value}))
    row.pop(TIME_KEY, None)
    is_wrapped = EXACT_KEY in row or (isinstance(value, dict) and (VALUE_KEY in value or EXACT_KEY in value))
    return dumps_any(row if is_wrapped else row[VALUE_KEY]).decode()
