"""Columns of many messages: the values that each field has in all of them.

The column of a type for N messages is

    a number, an array of numbers     an array, [N] or [N, length]
    a text, a list of any length      Ragged; a list of numbers of one length may also be an array, [N, length];
                                      the items of one byte, such as int8, may be the bytes, uint8
    a message                         a dict of fields, each such a column
    any of them                       Constant, where all messages have the same value
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from .message_types import Array, Basic, Definitions, Named, Type, numbers_in

Indices = npt.NDArray[np.int64]


class Ragged(NamedTuple):
    """Values of various lengths."""

    items: Any
    """All their items, as a column; of texts, their bytes, uint8."""
    starts: Indices
    """Where in `items` the items of each value begin, [N]."""
    lengths: Indices
    """How many items each value has, [N]."""

    @staticmethod
    def behind_each_other(items: Any, lengths: Indices) -> Ragged:
        """Return values whose items lie one behind the other."""
        return Ragged(items, np.cumsum(lengths) - lengths, lengths)


class Constant(NamedTuple):
    """A value that all messages share."""

    value: Any
    """A number, a text, a list of items, or a dict of fields."""


Column = Any
"""An array, Ragged, a dict of columns, or Constant."""


def pick(column: Column, numbers: Indices) -> Column:
    """Return the values of some messages, in the order given."""
    if isinstance(column, dict):
        return {name: pick(inner, numbers) for name, inner in column.items()}
    if isinstance(column, Ragged):
        return Ragged(column.items, column.starts[numbers], column.lengths[numbers])
    return column if isinstance(column, Constant) else column[numbers]


def count(column: Column) -> int:
    """Return how many values there are.

    Raises:
        ValueError: They are messages without fields.
    """
    if isinstance(column, dict):
        if not column:
            raise ValueError("messages without fields are no column")
        return count(next(iter(column.values())))
    return len(column.lengths) if isinstance(column, Ragged) else len(column)


def texts(values: list[str]) -> Ragged:
    """Return texts as a column."""
    encoded = [value.encode() for value in values]
    lengths = np.fromiter(map(len, encoded), np.int64, len(encoded))
    return Ragged.behind_each_other(np.frombuffer(b"".join(encoded), np.uint8), lengths)


def ranges(starts: Indices, lengths: Indices) -> Indices:
    """Return the positions of all items of ragged values, those of one value behind those of the other."""
    ends = np.cumsum(lengths)
    total = int(ends[-1]) if len(ends) else 0
    # `ends - lengths` is where a value begins in the result, so the repeated difference moves a running number to its
    # source.
    positions: Indices = np.repeat(starts - ends + lengths, lengths) + np.arange(total)
    return positions


def spread(definitions: Definitions, type_: Type, column: Column, count: int) -> Column:
    """Return a column that is no `Constant`: its value is repeated for `count` messages, without copies."""
    if not isinstance(column, Constant):
        return column
    value = column.value
    if isinstance(type_, Named):
        return {name: Constant(value[name]) for name in definitions.messages[type_.name]}
    if isinstance(type_, Array):
        numbers = numbers_in(type_)
        if numbers is None or type_.length is None:
            return _repeat(_items(definitions, type_.of, value), len(value), count)
        return np.broadcast_to(np.asarray(value, numbers.dtype), (count, type_.length))
    assert isinstance(type_, Basic)
    if type_.is_text:
        encoded = value.encode()
        return _repeat(np.frombuffer(encoded, np.uint8), len(encoded), count)
    return np.broadcast_to(np.asarray(value, type_.dtype), (count,))


def _repeat(items: Column, length: int, count: int) -> Ragged:
    return Ragged(items, np.zeros(count, np.int64), np.full(count, length, np.int64))


def _items(definitions: Definitions, type_: Type, values: Any) -> Column:
    """Return a list of items as a column."""
    if isinstance(type_, Named):
        fields = definitions.messages[type_.name]
        return {name: _items(definitions, inner, [value[name] for value in values]) for name, inner in fields.items()}
    if isinstance(type_, Array):
        numbers = numbers_in(type_)
        if numbers is not None and type_.length is not None:
            return np.asarray(values, numbers.dtype).reshape(len(values), type_.length)
        lengths = np.fromiter(map(len, values), np.int64, len(values))
        items = _items(definitions, type_.of, [item for value in values for item in value])
        return Ragged.behind_each_other(items, lengths)
    assert isinstance(type_, Basic)
    return texts(list(values)) if type_.is_text else np.asarray(values, type_.dtype)
