"""Makes the function that decodes a channel's payloads into rows."""

from __future__ import annotations

from collections.abc import Callable

from ..errors import EncodingError
from ..mcap.records import Channel, Schema
from . import codec_table
from .codec import MessageCodec
from .decoding import DEFAULT, Decoding
from .encoded_channel import Decoder, EncodedChannel
from .ros import distros
from .ros.distros import Likely

_NO_SCHEMA = Schema(0, "", "", b"")


def decoder(
    channel: Channel,
    schema: Schema | None,
    decoding: Decoding = DEFAULT,
    likely: Callable[[], Likely] = distros.likely,
) -> Decoder:
    """Return the function that turns a channel's payloads into rows.

    It raises a `ValueError` for a payload that is not in the encoding that the channel announces. Rows of an encoding
    that nobody here decodes, or whose schema cannot be used, have the payload as their only field; an
    `UndecodedWarning` says so. So has, as `_data`, a ROS or protobuf message that is not what its definition says.

    Args:
        channel: The channel.
        schema: Its schema.
        decoding: How to decode messages for which channel and schema lack definitions.
        likely: Returns the distributions of ROS 2 that they may come from; called where a definition is missing.

    Raises:
        EncodingError: The messages cannot be decoded, and that is to be an error.
    """
    encoded = EncodedChannel(channel, schema or _NO_SCHEMA, decoding, likely)
    schema = encoded.schema
    described = f" has messages in the encoding {channel.message_encoding!r} with a schema in {schema.encoding!r}"
    try:
        codec = codec_table.find(channel.message_encoding)
    except EncodingError as error:
        return encoded.give_up(f"{described}: {error}")
    try:
        decode = codec.decoder(encoded) if codec is not None else None
    except EncodingError as error:
        what = f": its schema {schema.name!r} is no {schema.encoding} that can be used"
        return encoded.give_up(
            f"{what if schema.encoding else f'{described}, of the type {schema.name!r}'}: {error}", encoded.hint
        )
    return decode or encoded.give_up(f"{described}, which is not decoded")


def codec_of(channel: Channel) -> MessageCodec | None:
    """Return the codec of a channel's messages; None if there is none, or its package is not installed."""
    try:
        return codec_table.find(channel.message_encoding)
    except EncodingError:
        return None
