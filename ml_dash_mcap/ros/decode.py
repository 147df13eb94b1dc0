"""From a ROS message's bytes to a row."""

from __future__ import annotations

import functools
import struct
from collections.abc import Callable
from typing import Any

from ..errors import EncodingError
from . import definitions, idl
from .message_types import Definitions
from .reader import Read, reader

Row = dict[str, Any]
Decoder = Callable[[bytes], Row]

_CDR_HEAD = 4
_PADDING = 3
"""Bytes that may follow a CDR message, so that its length is a multiple of 4."""

_TEXT_CHARACTERS = 4 * 1024 * 1024
"""How long a definition may be, with all that it needs."""


@functools.lru_cache(maxsize=256)
def decoder(name: str, schema_encoding: str, text: str, *, is_ros1: bool = False) -> Decoder:
    """Return the function that turns a message's bytes into a row: nested messages are dicts, `uint8[]` is bytes.

    It raises a `ValueError` for bytes that are no such message.

    Args:
        name: What the message is called, such as `sensor_msgs/msg/JointState`.
        schema_encoding: What `text` is in: "ros1msg", "ros2msg" or "ros2idl".
        text: Its definition and those that it needs.
        is_ros1: Whether the bytes are in ROS 1's serialization format, or else in CDR.

    Raises:
        EncodingError: The definition is broken, or has what cannot be decoded.
    """
    if len(text) > _TEXT_CHARACTERS:
        raise EncodingError(f"it is {len(text)} characters long, of {_TEXT_CHARACTERS} at most")
    try:
        found = idl.parse(name, text) if schema_encoding.endswith("idl") else _parse(name, text, schema_encoding)
        return _ros1(found) if is_ros1 else _cdr(found)
    except RecursionError as error:
        raise EncodingError(f"{name} is made of more messages in messages than can be followed") from error


def _parse(name: str, text: str, schema_encoding: str) -> Definitions:
    return definitions.parse(name, text, is_ros1=schema_encoding == "ros1msg")


def _ros1(found: Definitions) -> Decoder:
    """Decode ROS 1's format: little-endian, packed (http://wiki.ros.org/ROS/Technical%20Overview)."""
    read = reader(found, "<", aligned=False)

    def decode(payload: bytes) -> Row:
        row, end = _read(read, payload, 0)
        if end != len(payload):
            raise ValueError(f"it is {len(payload)} bytes long and its definition ends after {end}")
        return row

    return decode


def _cdr(found: Definitions) -> Decoder:
    """Decode CDR (https://www.omg.org/spec/DDSI-RTPS/2.5, section 10.2), in the byte order that the message says."""
    little = reader(found, "<", aligned=True)
    big = functools.cache(lambda: reader(found, ">", aligned=True))

    def decode(payload: bytes) -> Row:
        head = payload[:2]
        if head == b"\0\1":
            row, end = _read(little, payload, _CDR_HEAD)
        elif head == b"\0\0":
            row, end = _read(big(), payload, _CDR_HEAD)
        else:
            raise ValueError(f"it starts with {payload[:_CDR_HEAD]!r}, which announces no plain CDR")
        if not end <= len(payload) <= end + _PADDING:
            raise ValueError(f"it is {len(payload)} bytes long and its definition ends after {end}")
        return row

    return decode


def _read(read: Read, payload: bytes, at: int) -> tuple[Row, int]:
    try:
        return read(payload, at)
    except struct.error as error:
        raise ValueError(f"it ends, after {len(payload)} bytes, before its definition does") from error
