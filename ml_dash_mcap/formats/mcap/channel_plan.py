"""Plans the channels of an MCAP file that is made of the channels of others."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from ...codecs import codec_table
from ...codecs.codec import Codec
from ...errors import EncodingError
from ...mcap.file_writer import MOST_CHANNELS
from ...mcap.records import Channel, Schema
from ...query.file import File
from .row_channels import has_rows


@dataclass(frozen=True, slots=True)
class NewChannel:
    """A channel of the new file."""

    number: int
    """Its id, and that of its schema, from 1."""
    source: Channel
    schema: Schema | None
    """Of the source."""
    has_rows: bool
    """Whether its messages are rows in an encoding of ours."""
    codec: Codec | None
    """Encodes its rows; None for messages that stay as they are."""

    @property
    def is_learned(self) -> bool:
        """Whether the schema follows from the rows, which have to be looked at."""
        return self.codec is not None and self.codec.follows_shapes

    def channel(self) -> Channel:
        """Return the channel as it is in the new file."""
        encoding = self.source.message_encoding if self.codec is None else self.codec.message_encoding
        schema_id = self.number if self.codec is not None or self.schema is not None else 0
        return Channel(self.number, schema_id, self.source.topic, encoding, self.source.metadata)


class Codecs:
    """The codecs of the topics whose rows are encoded anew, one for each topic in all files."""

    def __init__(self, files: Sequence[File], encoding: str | None) -> None:
        """Begin without any.

        Args:
            files: Of the recording.
            encoding: That of the rows; None if all messages stay as they are.
        """
        self._files = files
        self._codec = None if encoding is None else codec_table.to_record(encoding)
        self._by_topic: dict[str, Codec] = {}

    def codec_for(self, channel: Channel, schema: Schema | None) -> Codec | None:
        """Return the codec for a channel's rows; None for messages that stay as they are."""
        codec = self._codec
        if codec is None or codec.message_encoding == channel.message_encoding or not has_rows(channel, schema):
            return None
        topic = channel.topic
        if topic not in self._by_topic:
            self._by_topic[topic] = codec.for_channel(topic, self._known_schema(codec, topic))
        return self._by_topic[topic]

    def _known_schema(self, codec: Codec, topic: str) -> bytes:
        """Return the schema of rows of the topic that have the encoding already, so that both have the same fields."""
        for file in reversed(self._files):
            for channel in file.index.channels_of(topic).values():
                schema = file.index.schema_of(channel)
                if channel.message_encoding == codec.message_encoding and has_rows(channel, schema):
                    return schema.data if schema is not None else b""
        return b""


def plan(file: File, topics: Collection[str], codecs: Codecs) -> Mapping[int, NewChannel]:
    """Return the channels that a new file has for those of a file, by the ids there.

    Args:
        file: The source.
        topics: Names of the topics that are wanted.
        codecs: Those of the new files.

    Raises:
        EncodingError: There are more than a file can have.
    """
    wanted = {number: channel for number, channel in sorted(file.index.channels.items()) if channel.topic in topics}
    if len(wanted) > MOST_CHANNELS:
        raise EncodingError(f"{file.path}: it has {len(wanted)} channels; MCAP has {MOST_CHANNELS}")
    planned = {}
    for at, (number, channel) in enumerate(wanted.items(), start=1):
        schema = file.index.schema_of(channel)
        planned[number] = NewChannel(at, channel, schema, has_rows(channel, schema), codecs.codec_for(channel, schema))
    return planned
