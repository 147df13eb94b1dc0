"""From a message's payload to a row."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import orjson

from ..errors import EncodingError
from ..rows.encode import EXACT_KEY, restore
from .records import Channel, Schema

Row = dict[str, Any]
Decoder = Callable[[bytes], Row]


def decoder(channel: Channel, schema: Schema | None) -> Decoder:
    """Return the function that turns a channel's payloads into rows.

    It raises a `ValueError` for a payload that is not in the encoding that the channel announces.

    Raises:
        EncodingError: Nothing here decodes this channel's message encoding.
    """
    make = DECODERS.get(channel.message_encoding)
    if make is None:
        raise EncodingError(
            f"topic {channel.topic!r} has messages in the encoding {channel.message_encoding!r};"
            f" this library decodes {', '.join(sorted(DECODERS))}"
        )
    return make(channel, schema)


def _json_decoder(channel: Channel, schema: Schema | None) -> Decoder:
    return decode_json


def decode_json(payload: bytes) -> Row:
    """Decode a JSON payload, with its non-finite numbers and bytes restored.

    Whatever is not an object becomes the field `value`, and an empty payload a row without fields.
    """
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


DECODERS: dict[str, Callable[[Channel, Schema | None], Decoder]] = {"json": _json_decoder}
"""Message encoding to what makes a decoder for one channel."""
