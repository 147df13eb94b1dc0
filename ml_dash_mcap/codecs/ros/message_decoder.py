"""Turns the bytes of ROS messages into rows: messages in ROS 1's format and in each CDR that a payload announces."""

from __future__ import annotations

import functools
import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from ...errors import EncodingError
from . import definitions, idl
from .definition_sources import Finder, Supply, is_idl, settled
from .message_reader import Read, reader
from .message_types import APPENDABLE, Definitions, canonical
from .wire import BY_HEAD, CDR, CDR_HEAD_BYTES, CDR_PADDING, DELIMITED, PARAMETER_LISTS, ROS1, Wire

Row = dict[str, Any]
Misfit = Callable[[bytes, ValueError], Any]
"""Handles a payload that does not match its definition: takes the payload and the error, and returns the row for it."""

_TEXT_CHARACTERS = 4 * 1024 * 1024
"""The longest definition that is parsed, with the definitions that it needs. Schemas of foreign files can be
hostile."""

_MD5_OF_NOTHING = "d41d8cd98f00b204e9800998ecf8427e"
"""The MD5 sum that ROS 1 gives a message without fields: the sum of an empty text."""

_NOTHING = Supply()


def decoder(
    name: str,
    schema_encoding: str,
    text: str,
    *,
    is_ros1: bool = False,
    supply: Supply = _NOTHING,
    replaced: Callable[[], object] = lambda: None,
    misfit: Misfit | None = None,
) -> MessageDecoder:
    """Return a function that turns a message's bytes into a row: nested messages are dicts, `uint8[]` is bytes.

    The function raises a `ValueError` for bytes that do not match the definition. Bytes of a text that are not UTF-8
    become U+FFFD.

    Args:
        name: What the message is called, such as `sensor_msgs/msg/JointState`.
        schema_encoding: What `text` is in: "ros1msg", "ros2msg", "ros2idl" or "omgidl".
        text: Its definition and those that it needs; empty if it has no fields, or if only the supply knows it.
        is_ros1: Whether the bytes are in ROS 1's serialization format, or else in CDR.
        supply: Where definitions come from that the text lacks.
        replaced: Called for each message with a text that is no UTF-8.
        misfit: What to do with bytes that are no such message, instead of raising an error.

    Raises:
        EncodingError: The definition is broken, or has what cannot be decoded.
    """
    make = Ros1Decoder if is_ros1 else CdrDecoder
    return make(definition(name, schema_encoding, text, supply), replaced, misfit or _refuse)


class MessageDecoder(ABC):
    """Turns messages of one definition into rows."""

    is_ros1: bool

    def __init__(self, definitions: Definitions, replaced: Callable[[], object], misfit: Misfit) -> None:
        self.definitions = definitions
        self._replaced = replaced
        self._misfit = misfit

    @abstractmethod
    def __call__(self, payload: bytes) -> Any:
        """Return a message's row."""

    def _read_again(self, wire: Wire, payload: bytes, at: int, default: str = "final") -> tuple[Any, int]:
        """Read a message with a text that is no UTF-8; returns its row and the place behind it."""
        row_and_end = _reader(self.definitions, wire, default, True)(payload, at)
        self._replaced()
        return row_and_end


class Ros1Decoder(MessageDecoder):
    """Reads ROS 1's format."""

    is_ros1 = True

    def __init__(self, definitions: Definitions, replaced: Callable[[], object], misfit: Misfit) -> None:
        super().__init__(definitions, replaced, misfit)
        self._read = _reader(definitions, ROS1)

    def __call__(self, payload: bytes) -> Any:
        """Return a message's row."""
        try:
            try:
                row, end = self._read(payload, 0)
            except UnicodeDecodeError:
                row, end = self._read_again(ROS1, payload, 0)
            if end == len(payload):
                return row
            why = _wrong_length(payload, end)
        except (ValueError, struct.error) as error:
            why = _as_value_error(payload, error)
        return self._misfit(payload, why)


class CdrDecoder(MessageDecoder):
    """Reads CDR, in the form that each message announces."""

    is_ros1 = False

    def __init__(self, definitions: Definitions, replaced: Callable[[], object], misfit: Misfit) -> None:
        super().__init__(definitions, replaced, misfit)
        self._is_empty = not definitions.messages[definitions.root]
        self._read_little = None if definitions.has_optional() else _reader(definitions, CDR)

    def __call__(self, payload: bytes) -> Any:
        """Return a message's row."""
        try:
            # Nearly every message starts so: ROS 2 sends little-endian CDR. All other forms take the slower way.
            if payload[:2] != b"\0\1" or self._read_little is None:
                return self._read_other(payload)
            try:
                row, end = self._read_little(payload, CDR_HEAD_BYTES)
            except UnicodeDecodeError:
                row, end = self._read_again(CDR, payload, CDR_HEAD_BYTES)
            if end <= len(payload) <= end + CDR_PADDING:
                return row
            why = _wrong_length(payload, end)
        except (ValueError, struct.error) as error:
            why = _as_value_error(payload, error)
        if self._is_empty and 0 <= len(payload) - CDR_HEAD_BYTES <= 1 + CDR_PADDING:  # with or without ROS's byte
            return {}
        return self._misfit(payload, why)

    def _read_other(self, payload: bytes) -> Row:
        """Read CDR that is not what ROS 2 sends; where the definition leaves two ways to read it, only one may fit."""
        head = payload[:2]
        wire = BY_HEAD.get(head)
        if wire is None:
            kind = "a list of parameters" if head in PARAMETER_LISTS else "nothing that is known"
            raise ValueError(f"it starts with {payload[:CDR_HEAD_BYTES]!r}, which announces {kind}, no plain CDR")
        rows: list[Row] = []
        why: Exception | None = None
        for default in _defaults(self.definitions, head, wire):
            try:
                row = self._read_as(wire, default, payload)
                # Texts are compared because a NaN in the rows would not equal itself.
                if not rows or repr(rows[0]) != repr(row):
                    rows.append(row)
            except (ValueError, struct.error) as error:
                why = _as_value_error(payload, error)
        if len(rows) > 1:
            raise ValueError("it can be read in two ways, and its definition does not say which structs are appendable")
        if why is not None and not rows:
            raise why
        return rows[0]

    def _read_as(self, wire: Wire, default: str, payload: bytes) -> Any:
        """Read a message whose structs are of one extensibility, where the definition does not say of which."""
        try:
            row, end = _reader(self.definitions, wire, default)(payload, CDR_HEAD_BYTES)
        except UnicodeDecodeError:
            row, end = self._read_again(wire, payload, CDR_HEAD_BYTES, default)
        if not end <= len(payload) <= end + CDR_PADDING:
            raise _wrong_length(payload, end)
        return row


# Each file of a recording repeats its schemas, and a definition takes about 1 ms to prepare (docs/decisions, 0013).
@functools.lru_cache(maxsize=256)
def definition(name: str, schema_encoding: str, text: str, supply: Supply = _NOTHING) -> Definitions:
    """Return the parsed definition of a message that can be read.

    The arguments are those of `decoder`.

    Raises:
        EncodingError: The definition is broken, or has what cannot be decoded.
    """
    if len(text) > _TEXT_CHARACTERS:
        raise EncodingError(f"it is {len(text)} characters long, of {_TEXT_CHARACTERS} at most")
    find = Finder(supply, name)
    given = supply.text(name)
    text_of_recording = given is None
    if given is not None:
        text, schema_encoding = given, _language(supply, "ros2idl" if is_idl(given) else "")
    elif not text.strip(" \t\r\n\0\ufeff"):
        text, schema_encoding = _looked_up(find, name, schema_encoding), _language(supply, "")
        text_of_recording = False
    try:
        if schema_encoding.endswith("idl") or is_idl(text):
            described = idl.parse(name, text, is_ros=schema_encoding != "omgidl", find=find)
        else:
            described = definitions.parse(name, text, is_ros1=schema_encoding == "ros1msg", find=find)
            # The hash covers the messages in the message too, so it tells which distribution they must be taken from.
            if find.borrowed and text_of_recording and supply.digest:
                return definition(name, schema_encoding, text, settled(name, text, supply))
        described = replace(described, guesses=tuple(find.guesses))
        wire = ROS1 if supply.is_ros1 or schema_encoding == "ros1msg" else CDR
        # Compiled here so that a definition that cannot be read fails now and not at its first message. Only XCDR2
        # has optional members.
        _reader(described, replace(wire, is_version_2=True) if described.has_optional() else wire)
    except RecursionError as error:
        raise EncodingError(f"{name} is made of more messages in messages than can be followed") from error
    return described


def _language(supply: Supply, otherwise: str) -> str:
    return otherwise or ("ros1msg" if supply.is_ros1 else "ros2msg")


def _looked_up(find: Finder, name: str, schema_encoding: str) -> str:
    """Return the definition of a message of which a recording has none, or an empty one.

    Raises:
        EncodingError: Nobody knows it, and it is not known to be empty.
    """
    looked_up = find(canonical(name))
    if looked_up is not None:
        return looked_up.text
    if find.digest not in ("", _MD5_OF_NOTHING) or not schema_encoding:
        raise EncodingError(find.why)
    return ""


def _refuse(payload: bytes, why: ValueError) -> Row:
    raise why


def _defaults(definitions: Definitions, head: bytes, wire: Wire) -> Sequence[str]:
    """Return the extensibilities to try for structs whose definition states none.

    Raises:
        ValueError: The payload announces another extensibility than the definition states.
    """
    if not wire.is_version_2:
        return ("final",)
    root = APPENDABLE if head in DELIMITED else "final"
    stated = definitions.extensibility.get(definitions.root)
    if stated is None:
        return (root,)
    if stated != root:
        raise ValueError(f"it starts with {head!r}, which announces a message that is {root}, and it is {stated}")
    return (root,) if definitions.extensibility.keys() >= definitions.messages.keys() else ("final", APPENDABLE)


def _reader(definitions: Definitions, wire: Wire, default: str = "final", replaces: bool = False) -> Read:
    """Return the reader of a message, which is compiled once."""
    key = (wire, default, replaces)
    read = definitions.readers.get(key)
    if read is None:
        read = definitions.readers[key] = reader(definitions, wire, default=default, replaces=replaces)
    return read


def _as_value_error(payload: bytes, error: Exception) -> ValueError:
    if isinstance(error, ValueError):
        return error
    return ValueError(f"it ends, after {len(payload)} bytes, before its definition does")


def _wrong_length(payload: bytes, end: int) -> ValueError:
    return ValueError(f"it is {len(payload)} bytes long and its definition ends after {end}")
