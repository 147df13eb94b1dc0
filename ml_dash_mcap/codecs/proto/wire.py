"""The bytes of protobuf messages: tags, varints, and the fields of a message, without knowing its type.

Source: https://protobuf.dev/programming-guides/encoding/
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple

VARINT, FIXED64, DELIMITED, FIXED32 = 0, 1, 2, 5
"""Wire types."""

MOST_FIELD_NUMBER = 2**29 - 1

_FIXED_BYTES = {FIXED64: 8, FIXED32: 4}

pack_double = struct.Struct("<d").pack


class WireField(NamedTuple):
    """One field of a message as it lies in the bytes."""

    number: int
    wire_type: int
    start: int
    """Where the field begins, with its tag."""
    value_start: int
    """Where the value begins, behind the length of a delimited field."""
    end: int


def varint(value: int) -> bytes:
    """Encode an unsigned integer."""
    if value < 0x80:
        return _ONE_BYTE[value]
    encoded = bytearray()
    while value >= 0x80:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    encoded.append(value)
    return bytes(encoded)


_ONE_BYTE = [bytes((value,)) for value in range(0x80)]


def tag(number: int, wire_type: int) -> bytes:
    """Encode the tag of a field."""
    return varint(number << 3 | wire_type)


def delimited(number: int, content: bytes) -> bytes:
    """Encode a field of bytes, text, packed numbers, or a message."""
    return tag(number, DELIMITED) + varint(len(content)) + content


def read_varint(data: bytes, at: int, end: int) -> tuple[int, int]:
    """Read an unsigned integer of at most 64 bits.

    Returns:
        The integer, and where the next byte is.

    Raises:
        ValueError: It is cut off, or too long.
    """
    value = shift = 0
    while at < end:
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            if value >> 64:
                break
            return value, at
        shift += 7
        if shift > 63:
            break
    raise ValueError("an integer in it is cut off or too long")


def fields(data: bytes, at: int = 0, end: int | None = None) -> Iterator[WireField]:
    """Yield the fields of a message, in the order in which they lie.

    Args:
        data: Holds the message.
        at: Where the message begins.
        end: Where it ends; None for the end of the data.

    Raises:
        ValueError: The bytes are no message.
    """
    end = len(data) if end is None else end
    while at < end:
        start = at
        head, at = read_varint(data, at, end)
        number, wire_type = head >> 3, head & 7
        if not 0 < number <= MOST_FIELD_NUMBER:
            raise ValueError(f"it has a field of the number {number}")
        value_start = at
        if wire_type == DELIMITED:
            length, value_start = read_varint(data, at, end)
            at = value_start + length
        elif wire_type == VARINT:
            _, at = read_varint(data, at, end)
        elif wire_type in _FIXED_BYTES:
            at += _FIXED_BYTES[wire_type]
        else:
            raise ValueError(f"it has a field of the wire type {wire_type}")
        if at > end:
            raise ValueError("it is cut off")
        yield WireField(number, wire_type, start, value_start, at)
