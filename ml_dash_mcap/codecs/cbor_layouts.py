"""The layouts of rows of CBOR, and the forms that the writer tells by them.

Rows of one topic mostly differ in their numbers and texts only. The other bytes and where they stand are the layout of
a row. Rows of one layout have one form, and can be read as the rows of one matrix of bytes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..mcap.message_records import MESSAGE_HEAD_BYTES
from ..mcap.row_arrays import Rows, by_channel
from ..rows.schema import TopicShape
from ..rows.shape import Shape
from ..rows.value_shapes import of_value
from .codec import UNKNOWN_FORM
from .encoded_channel import Row

Bytes = npt.NDArray[np.uint8]
Places = npt.NDArray[np.intp]

_MOST_DEPTH = 254

_MOST_LAYOUTS = 64
"""Layouts that are remembered of one topic; texts of ever other lengths make new ones."""


class Leaf(NamedTuple):
    """A number, a truth value, a text or bytes: what differs between rows of one layout."""

    kind: str
    at: int
    """Where its head stands."""
    start: int
    size: int
    """Where what follows the head starts, and how many bytes it has; 0 where the head says all."""


OTHER: Any = object()
"""Stands for what is no leaf, list or dict, and the same in all rows of a layout."""
NULL: Any = object()


class Layout:
    """Where in an encoded row its leaves stand, and the other bytes, which all rows of the layout share."""

    def __init__(self, payload: bytes) -> None:
        """Walk through a row.

        Raises:
            ValueError: It has something that no row of ours has.
        """
        self._payload = payload
        self._loose = np.zeros(len(payload), np.uint8)
        """The bits of each byte that may differ."""
        self._small: list[int] = []
        """Where integers stand that lie in their heads: from 24 on, a head's number means something else."""
        self.root, end = self._item(0, 0)
        if end != len(payload) or not isinstance(self.root, dict):
            raise ValueError("this is no row")
        self._fixed = np.flatnonzero(self._loose != 0xFF)
        self._mask = ~self._loose[self._fixed]
        self._bytes = np.frombuffer(payload, np.uint8)[self._fixed] & self._mask

    def fits(self, data: Bytes, starts: Places) -> npt.NDArray[np.bool_]:
        """Tell which rows of the layout's size, starting at places of a block, are of it, [N]."""
        fits = ((data[starts[:, None] + self._fixed] & self._mask) == self._bytes).all(axis=1)
        if self._small:
            fits &= ((data[starts[:, None] + np.array(self._small)] & 0x1F) < 24).all(axis=1)
        return np.asarray(fits)

    def _item(self, at: int, depth: int, *, is_fixed: bool = False) -> tuple[Any, int]:
        """Return what stands at a place, and its end: a leaf, a list, a dict, `NULL` or `OTHER`.

        Args:
            at: The place.
            depth: In how many others it lies.
            is_fixed: Whether only bytes may differ: in a tag, where numbers are the lengths of an array.
        """
        major, number, start = head(self._payload, at)
        if depth > _MOST_DEPTH:
            raise ValueError("it is nested too deep")
        if major == 4:
            items: list[Any] = []
            for _ in range(number):
                item, start = self._item(start, depth + 1, is_fixed=is_fixed)
                items.append(item)
            return items, start
        if major == 5:
            return self._map(start, number, depth, is_fixed)
        if major == 6:
            return OTHER, self._item(start, depth + 1, is_fixed=True)[1]
        if major in (2, 3):
            end = start + number
            if end > len(self._payload):
                raise ValueError("it is cut off")
            if major == 2 or not is_fixed:
                self._loose[start:end] = 0xFF
            return Leaf("text" if major == 3 else "bytes", at, start, number), end
        return (OTHER if is_fixed else self._number(major, at, start)), start

    def _number(self, major: int, at: int, end: int) -> Any:
        first = self._payload[at]
        if major == 7 and first in (0xF4, 0xF5):
            self._loose[at] = 0x01
            return Leaf("bool", at, end, 0)
        if major == 7 and first != 0xFB:
            return NULL if first == 0xF6 else OTHER
        self._loose[at + 1 : end] = 0xFF
        if major == 7:
            return Leaf("float", at, at + 1, 8)
        self._loose[at] = 0x20  # the sign
        if end == at + 1:
            self._loose[at] = 0x3F
            self._small.append(at)
        return Leaf("int", at, at + 1, end - at - 1)

    def _map(self, at: int, count: int, depth: int, is_fixed: bool) -> tuple[dict[str, Any], int]:
        items: dict[str, Any] = {}
        for _ in range(count):
            major, size, start = head(self._payload, at)
            if major != 3:
                raise ValueError("a key is no text")
            name = self._payload[start : start + size].decode()
            items[name], at = self._item(start + size, depth + 1, is_fixed=is_fixed)
        if len(items) < count:
            raise ValueError("a key stands there twice")
        return items, at


def head(payload: bytes, at: int) -> tuple[int, int, int]:
    """Return an item's major type, its number, and where its head ends."""
    if at >= len(payload):
        raise ValueError("it is cut off")
    major, number = payload[at] >> 5, payload[at] & 0x1F
    if number < 24:
        return major, number, at + 1
    if number > 27:
        raise ValueError("its length is not definite")
    end = at + 1 + (1 << (number - 24))
    return major, int.from_bytes(payload[at + 1 : end], "big"), end


def head_bytes(major: int, number: int) -> bytes:
    """Return the shortest head; `major` is shifted into its place."""
    if number < 24:
        return bytes((major | number,))
    width = 1 if number < 1 << 8 else 2 if number < 1 << 16 else 4
    return bytes((major | (23 + width.bit_length()),)) + number.to_bytes(width, "big")


class _TopicForms:
    """The forms and layouts of one topic."""

    def __init__(self, decode: Callable[[bytes], Row]) -> None:
        self._decode = decode
        self.rows = TopicShape()
        self.keys: list[frozenset[str]] = []
        self.layouts: dict[int, list[tuple[Layout, int]]] = {}
        """By the size of the rows, with the form of each."""
        self.size = 0

    def learn(self, payload: bytes) -> int:
        """Widen the shape by one row; returns the row's form."""
        row = self._decode(payload)
        self.rows.add(of_value(row, is_coarse=True))
        keys = frozenset(row)
        if keys not in self.keys:
            self.keys.append(keys)
        return self.keys.index(keys)

    def remember(self, payload: bytes, form: int) -> Layout | None:
        """Remember the layout of a row, if there are not too many of them."""
        if sum(map(len, self.layouts.values())) >= _MOST_LAYOUTS:
            return None
        try:
            layout = Layout(payload)
        except ValueError:
            return None
        self.layouts.setdefault(len(payload), []).append((layout, form))
        self.size += 16 * len(payload)
        return layout

    def forget(self) -> None:
        """Forget all but the shape."""
        self.keys, self.layouts, self.size = [], {}, 0


class CborForms:
    """The forms of the rows of all topics that are recorded in CBOR."""

    def __init__(self, decode: Callable[[bytes], Row]) -> None:
        """Begin without rows.

        Args:
            decode: Makes a row of a payload.
        """
        self._decode = decode
        self._topics: dict[int, _TopicForms] = {}

    @property
    def size(self) -> int:
        """How much is remembered, in bytes, about."""
        return sum([topic.size for topic in self._topics.values()])

    def begin_block(self) -> None:
        """Begin a block."""
        for topic in self._topics.values():
            if len(topic.keys) > _MOST_LAYOUTS or sum(map(len, topic.layouts.values())) >= _MOST_LAYOUTS:
                topic.forget()

    def forget(self) -> None:
        """Forget all but the shapes."""
        for topic in self._topics.values():
            topic.forget()

    def learn(self, channel: int, payload: bytes) -> int:
        """Widen a topic's shape by one row; returns the row's form."""
        return self._of(channel).learn(payload)

    def of_rows(self, rows: Rows) -> npt.NDArray[np.int32]:
        """Return the forms of rows: by their layouts, and of those with a new layout by decoding them."""
        forms = np.full(len(rows), UNKNOWN_FORM, np.int32)
        starts = rows.starts + MESSAGE_HEAD_BYTES
        sizes = rows.ends - starts
        for channel, which in by_channel(rows):
            topic = self._of(channel)
            for size in np.unique(sizes[which]).tolist():
                pending = which[sizes[which] == size]
                for layout, form in topic.layouts.get(size, []):
                    fits = layout.fits(rows.data, starts[pending])
                    forms[pending[fits]] = form
                    pending = pending[~fits]
                while len(pending):
                    payload = rows.payload(int(pending[0]))
                    new = topic.remember(payload, form := topic.learn(payload))
                    fits = np.arange(len(pending)) == 0
                    if new is not None:
                        fits |= new.fits(rows.data, starts[pending])
                    forms[pending[fits]] = form
                    pending = pending[~fits]
        return forms

    def shape_of(self, channel: int) -> Shape | None:
        """Return the shape of a topic's rows so far."""
        topic = self._topics.get(channel)
        return None if topic is None else topic.rows.shape

    def keys_of(self, channel: int, form: int) -> frozenset[str]:
        """Return the top-level keys of a topic's form."""
        return self._topics[channel].keys[form]

    def _of(self, channel: int) -> _TopicForms:
        topic = self._topics.get(channel)
        if topic is None:
            topic = self._topics[channel] = _TopicForms(self._decode)
        return topic
