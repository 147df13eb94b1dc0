"""Tells which channels hold rows, which may be encoded anew, and which hold messages that stay as they are."""

from __future__ import annotations

from ...codecs.codec import Codec
from ...codecs.decode import codec_of
from ...file_names import KIND_KEY, MESSAGE, OWN_TOPICS, TRACK
from ...mcap.records import Channel, Schema

_OF_VIEWERS = "foxglove."
"""How the names of the types begin that viewers draw, in whichever encoding."""


def has_rows(channel: Channel, schema: Schema | None) -> bool:
    """Whether a channel's messages are rows in an encoding of ours."""
    codec = codec_of(channel)
    if not isinstance(codec, Codec) or channel.topic.startswith(OWN_TOPICS):
        return False
    if channel.metadata.get(KIND_KEY, MESSAGE) not in (TRACK, MESSAGE):
        return False
    if schema is None:
        return codec.schema_encoding != "protobuf"  # whose bytes nobody reads without a schema
    if schema.encoding == "protobuf":
        from ...codecs.proto import descriptor  # brings protobuf

        return descriptor.decode(schema.data, schema.name) is not None
    return not schema.name.startswith(_OF_VIEWERS)
