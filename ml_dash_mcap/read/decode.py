"""From a message's payload to a row."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import orjson

from ..errors import EncodingError, UndecodedWarning
from ..ros import decode as ros_decode
from ..rows import depth
from ..rows.encode import EXACT_KEY, restore
from .records import Channel, Schema

Row = dict[str, Any]
Decoder = Callable[[bytes], Row]

RAW_FIELD = "data"
"""Holds the payload of messages that nobody here decodes."""

_NO_SCHEMA = Schema(0, "", "", b"")


def decoder(channel: Channel, schema: Schema | None) -> Decoder:
    """Return the function that turns a channel's payloads into rows.

    It raises a `ValueError` for a payload that is not in the encoding that the channel announces. Rows of an encoding
    that nobody here decodes have the payload as their only field; an `UndecodedWarning` says so.

    Raises:
        EncodingError: The channel's schema is broken.
    """
    described = schema or _NO_SCHEMA
    make = DECODERS.get(channel.message_encoding)
    try:
        found = make(described) if make is not None else None
    except EncodingError as error:
        what = f"its schema {described.name!r} is no {described.encoding} that can be used"
        raise EncodingError(f"topic {channel.topic!r}: {what}: {error}") from error
    if found is not None:
        return found
    warnings.warn(
        f"topic {channel.topic!r} has messages in the encoding {channel.message_encoding!r} with a schema in"
        f" {described.encoding!r}, which is not decoded: its rows have the bytes of each as {RAW_FIELD!r}",
        UndecodedWarning,
        stacklevel=2,
    )
    return _decode_nothing


def _decode_nothing(payload: bytes) -> Row:
    return {RAW_FIELD: payload}


def _json_decoder(schema: Schema) -> Decoder:
    return decode_json


def decode_json(payload: bytes) -> Row:
    """Decode a JSON payload, with its non-finite numbers and bytes restored.

    Whatever is not an object becomes the field `value`, and an empty payload a row without fields.
    """
    if not depth.is_within(payload, depth.MOST):
        raise ValueError(f"it is nested deeper than {depth.MOST} levels")
    try:
        row = orjson.loads(payload)
    except orjson.JSONDecodeError:
        row = _decode_lenient(payload)
    if not isinstance(row, dict):
        return {"value": row}
    if EXACT_KEY in row:
        return restore(row)
    return row


def _decode_lenient(payload: bytes) -> Any:
    """Decode what other writers take for JSON: NaN and Infinity literals, or nothing at all."""
    return json.loads(payload) if payload.strip() else {}


def _protobuf_decoder(schema: Schema) -> Decoder | None:
    if schema.encoding != "protobuf":
        return None
    from . import protobuf  # which loads google.protobuf

    return protobuf.decoder(schema.name, schema.data)


def _ros1_decoder(schema: Schema) -> Decoder | None:
    return _ros_decoder(schema, is_ros1=True) if schema.encoding == "ros1msg" else None


def _cdr_decoder(schema: Schema) -> Decoder | None:
    return _ros_decoder(schema) if schema.encoding in ("ros2msg", "ros2idl", "omgidl") else None


def _ros_decoder(schema: Schema, *, is_ros1: bool = False) -> Decoder:
    text = schema.data.decode(errors="replace")  # comments may be in anything
    return ros_decode.decoder(schema.name, schema.encoding, text, is_ros1=is_ros1)


DECODERS: Mapping[str, Callable[[Schema], Decoder | None]] = {
    "json": _json_decoder,
    "protobuf": _protobuf_decoder,
    "ros1": _ros1_decoder,
    "cdr": _cdr_decoder,
}
"""Message encoding to what makes a decoder for a schema; None for a schema in a language that does not go with it."""
