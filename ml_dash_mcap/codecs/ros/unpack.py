"""Many messages at once from bytes to columns: what `pack` writes, and whatever else is little-endian CDR or ROS 1."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from .message_columns import Array, Column, Indices, Number, Ragged, Struct, Text, Type, pick
from .pack import CDR_HEAD

_U32 = np.dtype("<u4")
_MOST_ITEMS = 1_000_000
"""Of texts or messages in a list."""


def unpack(type_: Struct, messages: list[bytes], *, is_ros1: bool = False) -> Column:
    """Return the values of messages, as columns.

    Args:
        type_: Of the messages.
        messages: One or more.
        is_ros1: Whether they are as ROS 1 has them, instead of CDR with its head.

    Raises:
        ValueError: The bytes are not messages of this type; or CDR of another kind than little-endian.
    """
    sizes = np.fromiter(map(len, messages), np.int64, len(messages))
    data = np.frombuffer(b"".join(messages), np.uint8)
    starts = np.cumsum(sizes) - sizes
    walk = _Walk(data, starts, sizes, is_ros1)
    if not is_ros1:
        head = walk.take(len(CDR_HEAD))
        if not bool((head[:, :2] == np.frombuffer(CDR_HEAD[:2], np.uint8)).all()):
            raise ValueError("a message is not in little-endian CDR")
        walk.origin = walk.place
    column = walk.read(type_)
    left = sizes - walk.place
    if bool((left > (0 if is_ros1 else 3)).any()):  # CDR may be padded to a multiple of 4
        raise ValueError(f"a message has {int(left.max())} bytes more than its type")
    return column


class _Walk:
    """Goes through a type once and takes each field of all messages."""

    def __init__(self, data: npt.NDArray[np.uint8], starts: Indices, sizes: Indices, is_ros1: bool) -> None:
        self.data = data
        self.starts = starts
        self.sizes = sizes
        self.is_ros1 = is_ros1
        self.place: Any = 0
        """Bytes from a message's start: one number for all messages, or one each, [N]."""
        self.origin: Any = 0
        size = int(sizes[0])
        is_uniform = len(data) == size * len(sizes) and bool((sizes == size).all())
        self._matrix = data.reshape(len(sizes), size) if is_uniform else None

    def read(self, type_: Type) -> Column:
        if isinstance(type_, Struct):
            return {name: self.read(inner) for name, inner in type_.fields}
        if isinstance(type_, Number):
            return self._numbers(type_.dtype, 1).reshape(-1)
        if isinstance(type_, Text):
            return self._text()
        if isinstance(type_, Array):
            if isinstance(type_.item, Number):
                return self._numbers(type_.item.dtype, type_.count)
            return self._items(type_.item, np.full(len(self.starts), type_.count, np.int64))
        lengths = self._lengths()
        if isinstance(type_.item, Number):
            return self._sequence(type_.item.dtype, lengths)
        return self._items(type_.item, lengths)

    def take(self, size: int) -> npt.NDArray[np.uint8]:
        """Return the next bytes of each message, [N, size]."""
        self._check(size)
        place = self.place
        self.place = place + size
        if self._matrix is not None and isinstance(place, int):
            return self._matrix[:, place : place + size]
        found: npt.NDArray[np.uint8] = self.data[(self.starts + place)[:, None] + np.arange(size)]
        return found

    def _numbers(self, dtype: np.dtype[Any], count: int) -> npt.NDArray[Any]:
        if not count:
            return np.zeros((len(self.starts), 0), dtype)
        self._align(dtype.itemsize)
        return np.ascontiguousarray(self.take(dtype.itemsize * count)).view(dtype)

    def _lengths(self) -> Indices:
        return self._numbers(_U32, 1).reshape(-1).astype(np.int64)

    def _text(self) -> Ragged:
        said = self._lengths()
        lengths = said if self.is_ros1 else np.maximum(said - 1, 0)
        found = Ragged(self.data, self.starts + self.place, lengths)
        self._skip(said)
        return found

    def _sequence(self, dtype: np.dtype[Any], lengths: Indices) -> Ragged:
        size = dtype.itemsize
        before = self.place
        self._align(size)
        if not lengths.all():
            self.place = np.where(lengths > 0, self.place, before)
        self._check(lengths * size)
        at = self.starts + self.place
        self._skip(lengths * size)
        if size == 1:
            return Ragged(self.data, at, lengths)
        which = np.repeat(at - (np.cumsum(lengths) - lengths) * size, lengths) + np.arange(int(lengths.sum())) * size
        items = np.ascontiguousarray(self.data[which[:, None] + np.arange(size)]).view(dtype).reshape(-1)
        return Ragged.behind_each_other(items, lengths)

    def _items(self, type_: Type, lengths: Indices) -> Ragged:
        """Read items that are texts, messages or lists, the first of all messages, then the second, and so on."""
        total = int(lengths.sum())
        if int(lengths.max(initial=0)) > _MOST_ITEMS or bool((lengths > self.sizes).any()):
            raise ValueError(f"a message says that it has a list of {int(lengths.max())} items")
        firsts = np.cumsum(lengths) - lengths
        parts: list[Column] = []
        numbers: list[Indices] = []
        for number in range(int(lengths.max(initial=0))):
            having = np.flatnonzero(lengths > number)
            numbers.append(firsts[having] + number)
            if len(having) == len(lengths):
                parts.append(self.read(type_))
                continue
            places = np.broadcast_to(np.asarray(self.place), (len(lengths),)).astype(np.int64)
            inner = _Walk(self.data, self.starts[having], self.sizes[having], self.is_ros1)
            inner.place, inner.origin = places[having], self.origin
            parts.append(inner.read(type_))
            places[having] = inner.place
            self.place = places
        if not parts:
            return Ragged.behind_each_other(_nothing(type_), lengths)
        order = np.empty(total, np.int64)
        order[np.concatenate(numbers)] = np.arange(total)
        return Ragged.behind_each_other(pick(_join(parts), order), lengths)

    def _align(self, size: int) -> None:
        if not self.is_ros1 and size > 1:
            self.place = ((self.place - self.origin + size - 1) & -size) + self.origin

    def _skip(self, sizes: Indices) -> None:
        self._check(sizes)
        first = int(sizes[0])
        self.place = self.place + (first if bool((sizes == first).all()) else sizes)

    def _check(self, size: Any) -> None:
        if bool(np.any(self.place + size > self.sizes)):
            raise ValueError("a message ends before its last field")


def _join(parts: list[Column]) -> Column:
    """Put columns of one type behind each other."""
    first = parts[0]
    if isinstance(first, dict):
        return {name: _join([part[name] for part in parts]) for name in first}
    if not isinstance(first, Ragged):
        return np.concatenate(parts)
    lengths = np.concatenate([part.lengths for part in parts])
    if all(part.items is first.items for part in parts):
        return Ragged(first.items, np.concatenate([part.starts for part in parts]), lengths)
    offsets = np.cumsum([0, *(_count(part.items) for part in parts)])
    starts = np.concatenate([part.starts + offset for part, offset in zip(parts, offsets[:-1], strict=True)])
    return Ragged(_join([part.items for part in parts]), starts, lengths)


def _count(column: Column) -> int:
    if isinstance(column, dict):
        return _count(next(iter(column.values())))
    return len(column.lengths) if isinstance(column, Ragged) else len(column)


def _nothing(type_: Type) -> Column:
    """Return a column of no values."""
    if isinstance(type_, Struct):
        return {name: _nothing(inner) for name, inner in type_.fields}
    if isinstance(type_, Number):
        return np.empty(0, type_.dtype)
    if isinstance(type_, Array) and isinstance(type_.item, Number):
        return np.empty((0, type_.count), type_.item.dtype)
    empty = np.empty(0, np.int64)
    inner = np.empty(0, np.uint8) if isinstance(type_, Text) else _nothing(type_.item)
    return Ragged(inner, empty, empty)
