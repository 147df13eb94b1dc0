"""Serialises many messages at once from columns to bytes, in plain CDR, which ROS 2 sends, or in ROS 1's format.

Where all messages have one size, they are the rows of a matrix of bytes into which whole columns are written;
otherwise each message has a place of its own in one long array. The walk over the definition is the same for both.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from .message_columns import Column, Constant, Indices, Ragged, pick, ranges, spread
from .message_types import Array, Basic, Definitions, Named, Type, numbers_in
from .wire import CDR_HEAD

Bytes = npt.NDArray[np.uint8]
Places = Any
"""Bytes from a message's start: one number for all messages, or one each, [N]."""

_U32 = np.dtype("<u4")


class Packed(NamedTuple):
    """Messages as bytes."""

    data: Bytes
    """One after the other, each with `room` before it."""
    starts: Indices
    """Where in `data` each message's room starts, [N]."""
    sizes: Indices
    """Bytes of each message, without its room, [N]."""

    def slice(self, start: int, end: int) -> Packed:
        """Return the messages from number `start` up to, but without, number `end`, without a copy."""
        first = int(self.starts[start])
        last = int(self.starts[end]) if end < len(self.starts) else len(self.data)
        return Packed(self.data[first:last], self.starts[start:end] - first, self.sizes[start:end])

    def messages(self, room: int = 0) -> list[bytes]:
        """Return each message's bytes."""
        # One copy of everything and slices of `bytes` are cheaper than one slice of an array a message.
        whole = self.data.tobytes()
        ends = (self.starts + self.sizes + room).tolist()
        return [whole[start + room : end] for start, end in zip(self.starts.tolist(), ends, strict=True)]


_LARGE_BYTES = 256
"""From so many bytes on average on, as with images, values are copied in a loop. Shorter ones are copied with an index
of every byte, which takes 8 bytes of memory for each."""


class _PackedValues(NamedTuple):
    """The bytes of one field of all messages, or of some."""

    rows: Indices | None
    """The numbers of the messages that have these bytes; None for all."""
    place: Places
    data: Any
    """The same bytes for all, or [N, size], or Ragged."""


def pack(definitions: Definitions, column: Column, count: int, *, is_ros1: bool = False, room: int = 0) -> Packed:
    """Serialise messages.

    Args:
        definitions: What the messages are made of.
        column: Their values.
        count: How many.
        is_ros1: Whether as ROS 1 does it, instead of CDR with its head.
        room: How many zero bytes to leave before each message.
    """
    packer = _Packer(definitions, count, None, room, is_ros1)
    if not is_ros1:
        packer.same(CDR_HEAD)
        packer.origin = packer.place
    packer.put(Named(definitions.root), column)
    if isinstance(packer.place, int):
        return _matrix(packer.pieces, count, packer.place, room)
    return _scattered(packer.pieces, packer.place, room)


class _Packer:
    """Goes through a type once and collects what to write where."""

    def __init__(
        self, definitions: Definitions, count: int, rows: Indices | None, place: Places, is_ros1: bool
    ) -> None:
        self.definitions = definitions
        self.count = count
        self.rows = rows
        self.place: Places = place
        self.origin = place if isinstance(place, int) else 0
        """Where alignment counts from."""
        self.is_ros1 = is_ros1
        self.pieces: list[_PackedValues] = []

    def put(self, type_: Type, column: Column) -> None:
        if isinstance(column, Constant) and isinstance(self.place, int) and self.count > 1:
            self._put_same(type_, column)
            return
        column = spread(self.definitions, type_, column, self.count)
        if isinstance(type_, Named):
            fields = self.definitions.messages[type_.name]
            for name, inner in fields.items():
                self.put(inner, column[name])
            if not fields and not self.is_ros1 and self.definitions.has_placeholders:
                self.same(b"\0")
        elif isinstance(type_, Array):
            self._array(type_, column)
        else:
            assert isinstance(type_, Basic)
            if type_.is_text:
                self._text(column)
            else:
                self._numbers(np.asarray(column).reshape(self.count, 1), type_.dtype)

    def same(self, data: bytes) -> None:
        self._add(data, len(data))

    def _put_same(self, type_: Type, column: Constant) -> None:
        """Put a value that all messages share: it is serialised for one message, and its bytes are used for all."""
        single = _Packer(self.definitions, 1, None, self.place, self.is_ros1)
        single.origin = self.origin
        single.put(type_, column)
        assert isinstance(single.place, int)
        for _, place, data in single.pieces:
            self.pieces.append(_PackedValues(self.rows, place, data if isinstance(data, bytes) else data.tobytes()))
        self.place = single.place

    def _array(self, type_: Array, column: Column) -> None:
        numbers = numbers_in(type_)
        if numbers is None:
            self._items(type_, column)
        elif type_.length is not None:
            self._numbers(column, numbers.dtype)
        elif isinstance(column, np.ndarray):
            self._length(np.full(self.count, column.shape[1]))
            self._numbers(column, numbers.dtype)
        else:
            self._sequence(column, numbers.dtype)

    def _numbers(self, values: npt.NDArray[Any], dtype: np.dtype[Any]) -> None:
        if not values.shape[1]:
            return
        self.place = self._aligned(dtype.itemsize)
        # A stride of 0 comes from `broadcast_to`: all messages share one value, so its bytes need to be made once.
        if values.strides[0] == 0 and self.count:
            self.same(np.ascontiguousarray(values[0], dtype).tobytes())
            return
        data = np.ascontiguousarray(values, dtype).view(np.uint8).reshape(self.count, -1)
        self._add(data, data.shape[1])

    def _text(self, column: Ragged) -> None:
        end = b"" if self.is_ros1 else b"\0"
        self._length(column.lengths + len(end))
        self._ragged(column)
        if end:
            self.same(end)

    def _sequence(self, column: Ragged, dtype: np.dtype[Any]) -> None:
        self._length(column.lengths)
        length = _one(column.lengths)
        if length is None:
            # CDR pads before the first item, so an empty list has no padding.
            self.place = np.where(column.lengths > 0, self._aligned(dtype.itemsize), self.place)
        elif length:
            self.place = self._aligned(dtype.itemsize)
        items = np.ascontiguousarray(column.items, dtype).view(np.uint8)
        size = dtype.itemsize
        self._ragged(Ragged(items, column.starts * size, column.lengths * size))

    def _items(self, type_: Array, column: Ragged) -> None:
        """Put items that are texts, messages or lists, the first of all messages, then the second, and so on."""
        if type_.length is None:
            self._length(column.lengths)
        for number in range(int(column.lengths.max(initial=0))):
            having = np.flatnonzero(column.lengths > number)
            item = pick(column.items, column.starts[having] + number)
            if len(having) == self.count:
                self.put(type_.of, item)
                continue
            places = np.broadcast_to(np.asarray(self.place), (self.count,)).astype(np.int64)
            rows = having if self.rows is None else self.rows[having]
            inner = _Packer(self.definitions, len(having), rows, places[having], self.is_ros1)
            inner.origin = self.origin
            inner.put(type_.of, item)
            self.pieces += inner.pieces
            places[having] = inner.place
            self.place = places

    def _length(self, lengths: Indices) -> None:
        self.place = self._aligned(4)
        length = _one(lengths)
        if length is not None:
            self.same(length.to_bytes(4, "little"))
            return
        self._add(lengths.astype(_U32).view(np.uint8).reshape(-1, 4), 4)

    def _ragged(self, column: Ragged) -> None:
        length = _one(column.lengths)
        if length is None:
            self.pieces.append(_PackedValues(self.rows, self.place, column))
            self.place = self.place + column.lengths
        elif length:
            if self.count and _one(column.starts) is not None:
                self.same(column.items[int(column.starts[0]) :][:length].tobytes())
            else:
                self._add(_block(column, length), length)

    def _add(self, data: Any, size: int) -> None:
        self.pieces.append(_PackedValues(self.rows, self.place, data))
        self.place = self.place + size

    def _aligned(self, size: int) -> Places:
        if self.is_ros1 or size == 1:
            return self.place
        # Sizes are powers of two, for which `& -size` rounds down to a multiple. It works for a number and for an
        # array.
        return ((self.place - self.origin + size - 1) & -size) + self.origin


def _one(values: Indices) -> int | None:
    """Return the value that all have, or None."""
    if not len(values):
        return 0
    first = int(values[0])
    return first if bool((values == first).all()) else None


def _block(column: Ragged, length: int) -> Bytes:
    """Return values of one length as a matrix."""
    count = len(column.starts)
    first = int(column.starts[0])
    # Values that already lie behind each other are a view of the items; only others are gathered, which copies.
    if bool((column.starts == first + np.arange(count) * length).all()):
        block: Bytes = column.items[first : first + count * length].reshape(count, length)
        return block
    gathered: Bytes = column.items[column.starts[:, None] + np.arange(length)]
    return gathered


def _matrix(pieces: list[_PackedValues], count: int, size: int, room: int) -> Packed:
    """Write messages of one size."""
    # Bytes that are the same in all messages go into one template, which numpy then repeats in a single assignment.
    template = bytearray(size)
    for _, place, data in pieces:
        if isinstance(data, bytes):
            template[place : place + len(data)] = data
    whole = np.empty((count, size), np.uint8)
    whole[:] = np.frombuffer(bytes(template), np.uint8)
    for _, place, data in pieces:
        if not isinstance(data, bytes):
            whole[:, place : place + data.shape[1]] = data
    starts = np.arange(count, dtype=np.int64) * size
    return Packed(whole.reshape(-1), starts, np.full(count, size - room, np.int64))


def _scattered(pieces: list[_PackedValues], ends: Indices, room: int) -> Packed:
    """Write messages of various sizes."""
    starts = np.cumsum(ends) - ends
    whole = np.zeros(int(ends.sum()), np.uint8)
    for rows, place, data in pieces:
        at = (starts if rows is None else starts[rows]) + place
        if isinstance(data, Ragged):
            _copy(data, whole, at)
        else:
            block = np.frombuffer(data, np.uint8)[None, :] if isinstance(data, bytes) else data
            whole[at[:, None] + np.arange(block.shape[1])] = block
    return Packed(whole, starts, ends - room)


def _copy(data: Ragged, whole: Bytes, places: Indices) -> None:
    """Write values of various lengths to their places."""
    if int(data.lengths.sum()) < _LARGE_BYTES * len(data.lengths):
        whole[ranges(places, data.lengths)] = data.items[ranges(data.starts, data.lengths)]
        return
    for at, start, length in zip(places.tolist(), data.starts.tolist(), data.lengths.tolist(), strict=True):
        whole[at : at + length] = data.items[start : start + length]
