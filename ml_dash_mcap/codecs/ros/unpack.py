"""Reads many messages at once from bytes to columns, in ROS 1's format and in plain CDR.

The walk goes through a definition once and takes each field of all messages with a few calls of numpy. A row at a time
is the work of `message_reader`, which is faster for few messages and reads what is refused here.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from .message_columns import Column, Indices, Ragged, count, pick
from .message_types import PLACEHOLDER, Array, Basic, Definitions, Named, Type, numbers_in
from .value_sizes import ValueSizes
from .wire import BY_HEAD, CDR_HEAD_BYTES, CDR_PADDING, ROS1, Wire

_STEPS, _BYTES_A_STEP = 2000, 100
"""A step reads one value of all messages that still have an item, with a few calls of numpy. So many steps are allowed,
and another for every `_BYTES_A_STEP` bytes. Beyond that, as for a long list in few messages, rows are read faster one
by one."""


def unpack(definitions: Definitions, messages: list[bytes], *, is_ros1: bool = False) -> dict[str, Column]:
    """Return the values of messages, as columns by field.

    Args:
        definitions: What the messages are made of.
        messages: One or more.
        is_ros1: Whether they are in ROS 1's format, instead of CDR with its head.

    Raises:
        ValueError: The bytes are not messages of this definition; or they are in another CDR than plain CDR of one byte
            order, or have types that are not read by columns.
    """
    sizes = np.fromiter(map(len, messages), np.int64, len(messages))
    data = np.frombuffer(b"".join(messages), np.uint8)
    wire = ROS1 if is_ros1 else _wire_of(messages)
    start = 0 if is_ros1 else CDR_HEAD_BYTES
    steps = _STEPS + len(data) // _BYTES_A_STEP
    unpacker = _Unpacker(ValueSizes(definitions, wire), data, np.cumsum(sizes) - sizes, sizes, steps)
    unpacker.place = unpacker.origin = start
    if bool((sizes == sizes[0]).all()):
        unpacker.matrix = data.reshape(len(sizes), int(sizes[0]))
    columns = unpacker.read(Named(definitions.root))
    left = sizes - unpacker.place
    if bool((left > (0 if is_ros1 else CDR_PADDING)).any()) or bool((left < 0).any()):
        raise ValueError(f"a message has {int(left.max())} bytes more than its type")
    assert isinstance(columns, dict)
    return columns


def _wire_of(messages: list[bytes]) -> Wire:
    """Return the format that all messages announce.

    Raises:
        ValueError: They do not announce one and the same plain CDR.
    """
    heads = {message[:2] for message in messages}
    wire = BY_HEAD.get(heads.pop()) if len(heads) == 1 else None
    if wire is None or wire.is_version_2:
        raise ValueError("the messages are not all in plain CDR of one byte order")
    return wire


class _Unpacker:
    """Goes through a definition once and takes each field of all messages."""

    def __init__(
        self, value_sizes: ValueSizes, data: npt.NDArray[np.uint8], starts: Indices, sizes: Indices, steps_left: int
    ) -> None:
        self.data = data
        self.starts = starts
        self.sizes = sizes
        self.place: Any = 0
        """Bytes from a message's start: one number for all messages, or one each, [N]."""
        self.origin: Any = 0
        """Where alignment counts from."""
        self.steps_left = steps_left
        self.matrix: npt.NDArray[np.uint8] | None = None
        """The messages, [N, size], if all have one size."""
        self._value_sizes = value_sizes
        self._definitions, self._wire = value_sizes.definitions, value_sizes.wire

    def read(self, type_: Type) -> Column:
        """Take the next value of each message."""
        self.steps_left -= 1
        if self.steps_left < 0:
            raise ValueError("the messages have lists in lists that are long")
        if isinstance(type_, Named):
            return self._message(type_.name)
        if isinstance(type_, Array):
            return self._array(type_)
        if not isinstance(type_, Basic):
            raise ValueError(f"values that are {type(type_).__name__} are not read by columns")
        return self._text() if type_.is_text else self._numbers(type_.dtype, 1).reshape(-1)

    def _message(self, name: str) -> dict[str, Column]:
        fields = self._definitions.messages[name]
        columns = {key: self.read(inner) for key, inner in fields.items()}
        if not fields and self._wire.is_cdr and self._definitions.has_placeholders:
            self._take(1)
        columns.pop(PLACEHOLDER, None)
        return columns

    def _array(self, type_: Array) -> Column:
        numbers = numbers_in(type_)
        # Checked before anything is allocated: a definition from outside may claim an array of billions of items.
        if (type_.length or 0) > len(self.data):
            raise ValueError("a message ends before its array")
        if type_.length is None:
            lengths = self._lengths()
            return self._items(type_.of, lengths) if numbers is None else self._sequence(numbers.dtype, lengths)
        if numbers is not None:
            return self._numbers(numbers.dtype, type_.length)
        return self._items(type_.of, np.full(len(self.starts), type_.length, np.int64))

    # -- numbers and texts ---------------------------------------------------------------------------------------------

    def _take(self, size: int) -> npt.NDArray[np.uint8]:
        """Return the next bytes of each message, [N, size]."""
        self._check(size)
        place = self.place
        self.place = place + size
        if self.matrix is not None and isinstance(place, int):
            return self.matrix[:, place : place + size]
        return _gathered(self.data, self.starts + place, size)

    def _numbers(self, dtype: np.dtype[Any], length: int) -> npt.NDArray[Any]:
        if not length:
            return np.zeros((len(self.starts), 0), dtype)
        self._align(dtype.itemsize)
        taken = np.ascontiguousarray(self._take(dtype.itemsize * length))
        return _native(taken.view(dtype.newbyteorder(self._wire.order)), dtype)

    def _lengths(self) -> Indices:
        return self._numbers(_U32, 1).reshape(-1).astype(np.int64)

    def _text(self) -> Ragged:
        sizes = self._lengths()
        starts = self.starts + self.place
        self._skip(sizes)
        if not self._wire.is_cdr:
            return Ragged(self.data, starts, sizes)
        ends = (starts + sizes)[sizes > 0]  # some send an empty text as no bytes
        if bool(self.data[ends - 1].any()):
            raise ValueError("a text does not end with a zero")
        return Ragged(self.data, starts, np.maximum(sizes - 1, 0))

    def _sequence(self, dtype: np.dtype[Any], lengths: Indices) -> Ragged:
        size = dtype.itemsize
        before = self.place
        self._align(size)
        if not lengths.all() and self._wire.is_cdr:  # an empty list has no padding
            self.place = np.where(lengths > 0, self.place, before)
        starts = self.starts + self.place
        self._check(lengths * size)
        # Bytes stay where they are in the messages: images and point clouds are not copied here.
        if size == 1:
            self._skip(lengths)
            return Ragged(self.data, starts, lengths)
        total = int(lengths.sum())
        firsts = np.cumsum(lengths) - lengths
        if total and bool((lengths == lengths[0]).all()):
            return Ragged(self._numbers(dtype, int(lengths[0])).reshape(-1), firsts, lengths)
        self._skip(lengths * size)
        positions = np.repeat(starts - firsts * size, lengths) + np.arange(total) * size
        items = _gathered(self.data, positions, size).view(dtype.newbyteorder(self._wire.order)).reshape(-1)
        return Ragged(_native(items, dtype), firsts, lengths)

    # -- texts, messages and lists in lists ----------------------------------------------------------------------------

    def _items(self, type_: Type, lengths: Indices) -> Ragged:
        # Lengths are held against the bytes that are there before memory is asked for; with items of no bytes that
        # cannot be done.
        least = self._value_sizes.least(type_)
        if not least:
            raise ValueError("lists of values that take no bytes are not read by columns")
        self._check(lengths * least)
        if not lengths.any():
            return Ragged.behind_each_other(self._nothing(type_), lengths)
        return (
            self._items_at_once(type_, lengths)
            if self._value_sizes.is_fixed(type_)
            else self._items_in_turn(type_, lengths)
        )

    def _items_at_once(self, type_: Type, lengths: Indices) -> Ragged:
        """Read items whose places follow from the place of the first: those of all messages at once."""
        firsts = np.cumsum(lengths) - lengths
        places = np.broadcast_to(np.asarray(self.place), lengths.shape)
        number = np.arange(int(lengths.sum())) - np.repeat(firsts, lengths)
        # Padding depends only on the place modulo the widest alignment, so at most 8 tables of offsets serve all
        # messages.
        residues = (places - self.origin) % self._wire.alignment
        offsets = np.empty(len(number), np.int64)
        ends = np.empty(len(lengths), np.int64)
        for residue in np.unique(residues).tolist():
            mine = residues == residue
            steps = self._value_sizes.offsets(type_, residue, int(lengths[mine].max()))
            ends[mine] = steps[lengths[mine]]
            chosen = np.repeat(mine, lengths)
            offsets[chosen] = steps[number[chosen]]
        item_places = np.repeat(places, lengths) + offsets
        self._skip(ends)
        inner = self._inner(np.repeat(self.starts, lengths), np.repeat(self.sizes, lengths), item_places)
        items = inner.read(type_)
        self.steps_left = inner.steps_left
        return Ragged(items, firsts, lengths)

    def _items_in_turn(self, type_: Type, lengths: Indices) -> Ragged:
        """Read items of various sizes: the first of all messages, then the second, and so on."""
        firsts = np.cumsum(lengths) - lengths
        parts: list[Column] = []
        numbers: list[Indices] = []
        for number in range(int(lengths.max())):
            having = np.flatnonzero(lengths > number)
            numbers.append(firsts[having] + number)
            if len(having) == len(lengths):
                parts.append(self.read(type_))
                continue
            places = np.broadcast_to(np.asarray(self.place), lengths.shape).astype(np.int64)
            inner = self._inner(self.starts[having], self.sizes[having], places[having])
            parts.append(inner.read(type_))
            self.steps_left = inner.steps_left
            places[having] = inner.place
            self.place = places
        order = np.empty(int(lengths.sum()), np.int64)
        order[np.concatenate(numbers)] = np.arange(len(order))
        return Ragged.behind_each_other(pick(_join(parts), order), lengths)

    def _inner(self, starts: Indices, sizes: Indices, places: Indices) -> _Unpacker:
        """Return what reads on at places in some of the messages."""
        inner = _Unpacker(self._value_sizes, self.data, starts, sizes, self.steps_left)
        inner.place, inner.origin = places, self.origin
        return inner

    def _nothing(self, type_: Type) -> Column:
        """Return a column of no values."""
        self.steps_left -= 1
        if self.steps_left < 0:
            raise ValueError("it is made of too many messages in lists")
        if isinstance(type_, Named):
            fields = self._definitions.messages[type_.name]
            return {name: self._nothing(inner) for name, inner in fields.items() if name != PLACEHOLDER}
        empty = np.empty(0, np.int64)
        if isinstance(type_, Array):
            numbers = numbers_in(type_)
            if numbers is not None and type_.length is not None:
                return np.empty((0, type_.length), numbers.dtype)
            return Ragged(self._nothing(type_.of), empty, empty)
        if not isinstance(type_, Basic):
            raise ValueError(f"values that are {type(type_).__name__} are not read by columns")
        return Ragged(np.empty(0, np.uint8), empty, empty) if type_.is_text else np.empty(0, type_.dtype)

    # -- places --------------------------------------------------------------------------------------------------------

    def _align(self, size: int) -> None:
        size = min(size, self._wire.alignment)
        if size > 1:
            self.place = ((self.place - self.origin + size - 1) & -size) + self.origin

    def _skip(self, sizes: Indices) -> None:
        self._check(sizes)
        first = int(sizes[0])
        self.place = self.place + (first if bool((sizes == first).all()) else sizes)

    def _check(self, size: Any) -> None:
        if bool(np.any(self.place + size > self.sizes)):
            raise ValueError("a message ends before its last field")


_U32 = np.dtype("<u4")


def _gathered(data: npt.NDArray[np.uint8], positions: Indices, size: int) -> npt.NDArray[np.uint8]:
    """Return `size` bytes at each position, [N, size]."""
    if not len(positions):
        return np.empty((0, size), np.uint8)
    # Windows that overlap: one index a value, which is several times faster than one a byte.
    windows: npt.NDArray[Any] = np.ndarray((len(data) - size + 1,), np.dtype((np.void, size)), data, 0, (1,))
    values: npt.NDArray[np.uint8] = windows[positions].view(np.uint8).reshape(len(positions), size)
    return values


def _native(values: npt.NDArray[Any], dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    return values if values.dtype == dtype else values.astype(dtype)


def _join(parts: list[Column]) -> Column:
    """Put columns of one type behind each other."""
    first = parts[0]
    if isinstance(first, dict):
        return {name: _join([part[name] for part in parts]) for name in first}
    if not isinstance(first, Ragged):
        return np.concatenate(parts)
    lengths = np.concatenate([part.lengths for part in parts])
    # Texts and bytes of all parts refer to the same messages; joining their starts is enough.
    if all(part.items is first.items for part in parts):
        return Ragged(first.items, np.concatenate([part.starts for part in parts]), lengths)
    offsets = np.cumsum([0, *(count(part.items) for part in parts)])
    starts = np.concatenate([part.starts + offset for part, offset in zip(parts, offsets[:-1], strict=True)])
    return Ragged(_join([part.items for part in parts]), starts, lengths)
