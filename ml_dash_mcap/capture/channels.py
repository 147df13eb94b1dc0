"""The fixed properties of a topic: its number, kind, metadata, encoding, and perhaps its schema."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ..codecs import decode, json
from ..codecs.codec import Codec
from ..codecs.encoded_channel import Decoder
from ..file_names import KIND_KEY, MESSAGE, TRACK
from ..mcap.records import CHANNEL, SCHEMA, Channel, Schema
from ..rows.shape import Shape


@dataclass(frozen=True, slots=True)
class ChannelInfo:
    """A topic of a recorder. Its channel and its schema have the same number in every segment."""

    number: int
    """Channel id and schema id, from 1."""
    topic: str
    kind: str
    """track, message, log, metric, file or episode; only the rows of tracks merge."""
    metadata: Mapping[str, str] = field(default_factory=dict)
    """The channel's metadata besides its kind."""
    schema: bytes | None = None
    """None: inferred from the rows."""
    schema_name: str | None = None
    """None: the topic's name."""
    codec: Codec | None = json.CODEC
    """None in a recovery that does not know the encoding, or lacks its package: rows then stay as they are."""
    message_encoding: str = ""
    schema_encoding: str = ""
    """The encodings of the codec, if there is a codec."""

    def __post_init__(self) -> None:
        if self.codec is not None:
            object.__setattr__(self, "message_encoding", self.codec.message_encoding)
            object.__setattr__(self, "schema_encoding", self.codec.schema_encoding)
            if self.schema_name is None:
                object.__setattr__(self, "schema_name", self.codec.schema_name(self.topic))

    @property
    def has_times_of_tracks(self) -> bool:
        """Whether its times are on the clock of the tracks, because a control loop gives them."""
        return self.kind == TRACK or (self.kind == MESSAGE and not self.is_inferred)

    @property
    def is_inferred(self) -> bool:
        """Whether the schema is inferred from the rows."""
        return self.schema is None and self.codec is not None

    def first_schema(self) -> bytes:
        """Return the schema before the first row. A recovery tells by it that the schema is to be inferred."""
        if self.schema is not None or self.codec is None:
            return self.schema or b""
        return self.codec.schema(None, self.topic)

    def channel(self) -> Channel:
        """Return the channel as it is in a file."""
        metadata = {KIND_KEY: self.kind, **self.metadata}
        return Channel(self.number, self.number, self.topic, self.message_encoding, metadata)

    def channel_record(self) -> bytes:
        """Return the Channel record."""
        return CHANNEL.pack(self.channel())

    def schema_record(self, schema: bytes) -> bytes:
        """Return the Schema record of a schema in the channel's schema encoding."""
        return SCHEMA.pack(Schema(self.number, self.schema_name or self.topic, self.schema_encoding, schema))

    def padded_schema_record(self, schema: bytes, space: int, spare_bytes: int) -> bytes:
        """Return the Schema record of a schema in the codec's encoding, with room to grow in place.

        Args:
            schema: The schema.
            space: How long the whole record is to be; it is longer if the schema does not fit. 0 for a first record.
            spare_bytes: The least room of a first record, which has at least as much as the schema is long.
        """
        record = self.schema_record(schema)
        # `space` is that of the whole record, of which only the schema's text is padded.
        length = space - (len(record) - len(schema)) if space else 2 * len(schema) + spare_bytes
        return (
            record
            if self.codec is None or length < len(schema)
            else self.schema_record(self.codec.padded(schema, length))
        )

    def decoder(self, shape: Shape | None) -> Decoder:
        """Return the decoder of the channel's payloads.

        Args:
            shape: The shape of its rows, where the schema is inferred from them.
        """
        schema = self.codec.schema(shape, self.topic) if self.is_inferred and self.codec else self.schema or b""
        name = self.schema_name or self.topic
        return decode.decoder(self.channel(), Schema(self.number, name, self.schema_encoding, schema))
