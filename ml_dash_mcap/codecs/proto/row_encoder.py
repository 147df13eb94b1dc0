"""Encodes rows of any kind, value by value. `row_forms` has the fast way for rows whose like was seen before."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

from ...rows import packed_arrays
from ...rows.plain_row import TIME_KEY, encodable
from . import exact_values, wire
from .growth import member_for
from .layout import EXACT_NUMBER, TIME_NUMBER, Kind, Layout, Member, Slot
from .value_slots import Fit, fit

TIME_TAG = wire.tag(TIME_NUMBER, wire.FIXED64)

TIME_BYTES = len(TIME_TAG) + 8
"""The time stamp's field, with which each row ends."""

EXACT_TAG = wire.tag(EXACT_NUMBER, wire.DELIMITED)

MOST_SINGLE_INTEGERS = 8
"""Of a list of doubles with more integers in it, the whole list stands in the exact text."""

_LONGEST_PATH = 200
"""Longer paths of values without a field are cut: the descriptor names them."""

_TYPE_NUMBER, _DATA_NUMBER = 1, 2
"""The fields of the message of a large array."""


class RowEncoder:
    """Encodes one row under a layout."""

    def __init__(self) -> None:
        """Begin a row."""
        self.exact: dict[str, Any] = {}
        """What the fields do not express, by pointer."""
        self.opaque: list[str] = []
        """The paths (dotted, without indices) of the values that have no field at all."""

    def encode(self, layout: Layout, row: Mapping[str, Any], *, is_read: bool = False) -> bytes:
        """Encode a plain row that ends with its time stamp, in seconds.

        Args:
            layout: Of the row.
            row: See `rows.plain_row.PlainRow`.
            is_read: Whether it was read: then its texts may have lone surrogates.

        Raises:
            FieldError: A text has lone surrogates.
        """
        fields = {key: value for key, value in row.items() if key != TIME_KEY}
        content = self._dict(layout, fields, "", "")
        exact = b""
        if self.exact:
            exact = wire.delimited(EXACT_NUMBER, exact_values.encode(self.exact, is_read=is_read))
        return content + exact + TIME_TAG + wire.pack_double(row[TIME_KEY])

    def _dict(self, layout: Layout, fields: Mapping[str, Any], parent: str, path: str) -> bytes:
        return b"".join([self._value(layout, key, value, parent, path) for key, value in fields.items()])

    def _value(self, layout: Layout, key: str, value: Any, parent: str, path: str) -> bytes:
        place = exact_values.pointer(parent, key)
        fitting = fit(value)
        if fitting is None:
            return self._without_slot(layout, key, value, place, path)
        slot = fitting.slot
        member = member_for(layout, key, slot, fitting.leaves if slot.is_list else value)
        if member is None:
            return self._leave(key, value, place, path)
        if not slot.is_list:
            return self._single(member, value, place, f"{path}{key}.")
        if slot.kind is Kind.DICT:
            inner = member.inner or Layout()
            dicts = [
                self._dict(inner, dict_, exact_values.pointer(place, index), f"{path}{key}.")
                for index, dict_ in enumerate(fitting.leaves)
            ]
            return b"".join([wire.delimited(member.number, content) for content in dicts])
        if member.slot.kind is Kind.DOUBLE:
            self._note_integers(fitting, value, place)
        return encode_list(member, fitting.leaves)

    def _without_slot(self, layout: Layout, key: str, value: Any, place: str, path: str) -> bytes:
        if isinstance(value, (list, tuple)) and not value:
            packed = next((member for slot, member in layout.by_key.get(key, {}).items() if slot.is_packed), None)
            if packed is not None:  # a field without bytes, which only messages of ours have
                return packed.tag + b"\0"
        return self._leave(key, value, place, path)

    def _leave(self, key: str, value: Any, place: str, path: str) -> bytes:
        self.exact[place] = value
        self.opaque.append(encodable(f"{path}{key}"[:_LONGEST_PATH]))
        return b""

    def _single(self, member: Member, value: Any, place: str, path: str) -> bytes:
        kind = member.slot.kind
        if kind is Kind.DICT:
            return wire.delimited(member.number, self._dict(member.inner or Layout(), value, place, path))
        if kind is Kind.DOUBLE and type(value) is int:
            self.exact[place] = value
        return encode_single(member, value)

    def _note_integers(self, fitting: Fit, value: Any, place: str) -> None:
        """Note which elements of a list of doubles are integers."""
        integers = [at for at, leaf in enumerate(fitting.leaves) if type(leaf) is int]
        if not integers:
            return
        if len(integers) > MOST_SINGLE_INTEGERS:
            self.exact[place] = value
            return
        lengths = fitting.slot.lengths or ()
        for at in integers:
            self.exact[element_pointer(place, at, lengths)] = fitting.leaves[at]


def element_pointer(place: str, at: int, lengths: Sequence[int]) -> str:
    """Return the pointer of an element of a list of lists from its place among all elements."""
    indices: list[int] = []
    for length in reversed(lengths):
        at, index = divmod(at, length)
        indices.append(index)
    return "".join([place, *(f"/{index}" for index in (at, *reversed(indices)))])


def encode_single(member: Member, value: Any) -> bytes:
    """Encode a field of one value, which is no dict."""
    kind = member.slot.kind
    code = kind.struct_code
    if code is not None:
        return member.tag + struct.pack(f"<{code}", value)
    if kind is Kind.ARRAY:
        return wire.delimited(member.number, encode_array(value))
    return wire.delimited(member.number, value.encode() if kind is Kind.TEXT else value)


def encode_list(member: Member, leaves: Sequence[Any]) -> bytes:
    """Encode a field of a list, whose elements are no dicts."""
    code = member.slot.kind.struct_code
    if code is not None:
        return wire.delimited(member.number, struct.pack(f"<{len(leaves)}{code}", *leaves))
    element = Member(member.number, member.key, Slot(member.slot.kind))
    return b"".join([encode_single(element, leaf) for leaf in leaves])


def encode_array(array: Any) -> bytes:
    """Encode the message of a large array: its type and shape as text, and its bytes."""
    spelled = wire.delimited(_TYPE_NUMBER, packed_arrays.spelling(array).encode())
    return spelled + wire.delimited(_DATA_NUMBER, bytes(packed_arrays.content(array)))


def decode_array(data: bytes, at: int, end: int) -> Any:
    """Decode the message of a large array.

    Raises:
        ValueError: It is none.
    """
    spelled, content = "", b""
    for field in wire.fields(data, at, end):
        if field.number == _TYPE_NUMBER:
            spelled = data[field.value_start : field.end].decode()
        elif field.number == _DATA_NUMBER:
            content = data[field.value_start : field.end]
    array = packed_arrays.of_content(bytearray(content), spelled)
    if array is None:
        raise ValueError(f"it has {len(content)} bytes that are no array {spelled!r}")
    return array
