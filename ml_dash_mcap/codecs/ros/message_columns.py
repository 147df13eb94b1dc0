"""What a message is made of, and how many messages lie in memory: as columns.

The value of a type for N messages is

    Number, Array of Number      an array, [N] or [N, count]
    Text, Sequence               Ragged; a Sequence of Number of one length also an array, [N, length]
    Struct                       a dict of fields, each such a value
    any of them                  Constant, where all messages have the same
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Indices = npt.NDArray[np.int64]

_NUMBERS = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64")
_DTYPES: Mapping[str, np.dtype[Any]] = {
    **{name: np.dtype(name).newbyteorder("<") for name in _NUMBERS},
    **{name: np.dtype("uint8") for name in ("bool", "byte", "char", "octet")},
}


@dataclass(frozen=True, slots=True)
class Number:
    """A number, or a bool in one byte."""

    name: str
    """As ROS calls it, such as "float64"."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """Its bytes, little-endian."""
        return _DTYPES[self.name]


@dataclass(frozen=True, slots=True)
class Text:
    """A string in UTF-8."""


@dataclass(frozen=True, slots=True)
class Array:
    """So many items, always."""

    item: Type
    count: int


@dataclass(frozen=True, slots=True)
class Sequence:
    """Any number of items."""

    item: Type


@dataclass(frozen=True, slots=True)
class Struct:
    """A message, or one inside another."""

    name: str
    """Such as "std_msgs/msg/Header"."""
    fields: tuple[tuple[str, Type], ...]


Type = Number | Text | Array | Sequence | Struct


class Ragged(NamedTuple):
    """Values of various lengths."""

    items: Any
    """All their items, as a column; of texts, their bytes, uint8."""
    starts: Indices
    """Where in `items` each value's begin, [N]."""
    lengths: Indices
    """How many items each value has, [N]."""

    @staticmethod
    def behind_each_other(items: Any, lengths: Indices) -> Ragged:
        """Return values whose items lie one behind the other."""
        return Ragged(items, np.cumsum(lengths) - lengths, lengths)


class Constant(NamedTuple):
    """What all messages have."""

    value: Any
    """A number, a text, a list of items, or a dict of fields."""


Column = Any
"""An array, Ragged, a dict of columns, or Constant."""


def pick(column: Column, which: Indices) -> Column:
    """Return the values of some messages, in the order given."""
    if isinstance(column, dict):
        return {name: pick(inner, which) for name, inner in column.items()}
    if isinstance(column, Ragged):
        return Ragged(column.items, column.starts[which], column.lengths[which])
    return column if isinstance(column, Constant) else column[which]


def texts(values: list[str]) -> Ragged:
    """Return texts as a column."""
    encoded = [value.encode() for value in values]
    lengths = np.fromiter(map(len, encoded), np.int64, len(encoded))
    return Ragged.behind_each_other(np.frombuffer(b"".join(encoded), np.uint8), lengths)


def spread(column: Column, type_: Type, count: int) -> Column:
    """Return a column without Constant on its top."""
    if not isinstance(column, Constant):
        return column
    value = column.value
    if isinstance(type_, Struct):
        return {name: Constant(value[name]) for name, _ in type_.fields}
    if isinstance(type_, Text):
        return _repeat(np.frombuffer(value.encode(), np.uint8), count)
    if isinstance(type_, Sequence) or (isinstance(type_, Array) and not isinstance(type_.item, Number)):
        return _repeat(_items(value, type_.item), count, len(value))
    shape = (count, type_.count) if isinstance(type_, Array) else (count,)
    item = type_.item if isinstance(type_, Array) else type_
    assert isinstance(item, Number)
    return np.broadcast_to(np.asarray(value, item.dtype), shape)


def _repeat(items: Column, count: int, length: int | None = None) -> Ragged:
    size = len(items) if length is None else length
    return Ragged(items, np.zeros(count, np.int64), np.full(count, size, np.int64))


def _items(values: Any, type_: Type) -> Column:
    """Return a list of items as a column."""
    if isinstance(type_, Number):
        return np.asarray(values, type_.dtype)
    if isinstance(type_, Text):
        return texts(list(values))
    if isinstance(type_, Struct):
        return {name: _items([value[name] for value in values], inner) for name, inner in type_.fields}
    if isinstance(type_, Array) and isinstance(type_.item, Number):
        return np.asarray(values, type_.item.dtype).reshape(len(values), type_.count)
    lengths = np.fromiter(map(len, values), np.int64, len(values))
    return Ragged.behind_each_other(_items([one for value in values for one in value], type_.item), lengths)


def from_definitions(find: Callable[[str], Iterator[tuple[str, Any]]], name: str) -> Struct:
    """Return a message's type.

    Args:
        find: Returns the fields of a message, each with its description as rosbags has it: (kind, what), in which the
            kinds are 1 a primitive, 2 a message, 3 an array, 4 a sequence.
        name: Of the message, such as "sensor_msgs/msg/Imu".
    """
    return Struct(name, tuple((field, _described(find, what)) for field, what in find(name)))


def _described(find: Callable[[str], Iterator[tuple[str, Any]]], description: Any) -> Type:
    kind, what = int(description[0]), description[1]
    if kind == 1:
        return Text() if what[0] in ("string", "wstring") else Number(what[0])
    if kind == 2:
        return from_definitions(find, what)
    inner = _described(find, what[0])
    return Array(inner, what[1]) if kind == 3 else Sequence(inner)
