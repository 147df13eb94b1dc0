"""Writes an MCAP file: header, schemas, channels, chunks, attachments, metadata, and the summary at its end."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

from ..version import LIBRARY
from . import records
from .chunk_writer import PackedChunk
from .file_output import Output
from .message import Connection
from .records import AttachmentEntry, Channel, Chunk, MetadataEntry, Opcode, Schema

MOST_CHANNELS = 2**16 - 1
"""MCAP numbers channels with 16 bits, and 0 is kept free."""


@dataclass(slots=True)
class WrittenContents:
    """The contents of a file so far, from which its summary is made."""

    schemas: dict[int, bytes] = field(default_factory=dict)
    """Schema records by id, as they stand in the data section."""
    channels: dict[int, bytes] = field(default_factory=dict)
    """Channel records by id."""
    chunks: list[Chunk] = field(default_factory=list)
    metadata: list[MetadataEntry] = field(default_factory=list)
    attachments: list[AttachmentEntry] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    """Messages by channel id."""

    def add_chunk(self, chunk: PackedChunk, at: int) -> int:
        """Take in a chunk that starts at a place in the file; returns where its message indexes end."""
        entry = chunk.placed(at)
        self.chunks.append(entry)
        self.count(chunk.counts)
        return entry.indexes_end

    def count(self, counts: Mapping[int, int]) -> None:
        """Take in how many messages more there are of each channel."""
        for channel_id, count in counts.items():
            self.counts[channel_id] = self.counts.get(channel_id, 0) + count

    def summary(self, start: int) -> bytes:
        """Return everything from the summary section to the last byte of the file.

        Args:
            start: Where in the file the summary section begins.
        """
        groups: list[tuple[int, bytes]] = [
            (Opcode.SCHEMA, b"".join(self.schemas.values())),
            (Opcode.CHANNEL, b"".join(self.channels.values())),
            (Opcode.STATISTICS, records.STATISTICS.pack(self._statistics())),
            (Opcode.CHUNK_INDEX, b"".join(map(records.CHUNK_INDEX.pack, self.chunks))),
            (Opcode.ATTACHMENT_INDEX, b"".join(map(records.ATTACHMENT_INDEX.pack, self.attachments))),
            (Opcode.METADATA_INDEX, b"".join(map(records.METADATA_INDEX.pack, self.metadata))),
        ]
        summary, offsets = b"", b""
        for opcode, group in groups:
            if group:
                offsets += records.SUMMARY_OFFSET.pack(records.SummaryOffset(opcode, start + len(summary), len(group)))
                summary += group
        footer = records.Footer(start, start + len(summary), 0)
        # The checksum covers the footer, too, up to the checksum itself.
        crc = zlib.crc32(summary + offsets + records.FOOTER.pack(footer)[:-4])
        return summary + offsets + records.FOOTER.pack(replace(footer, summary_crc=crc)) + records.MAGIC

    def _statistics(self) -> records.Statistics:
        return records.Statistics(
            message_count=sum(self.counts.values()),
            schema_count=len(self.schemas),
            channel_count=len(self.channels),
            chunk_count=len(self.chunks),
            attachment_count=len(self.attachments),
            metadata_count=len(self.metadata),
            start_ns=min((chunk.start_ns for chunk in self.chunks), default=0),
            end_ns=max((chunk.end_ns for chunk in self.chunks), default=0),
            channel_message_counts={channel_id: count for channel_id, count in self.counts.items() if count},
        )


Place = TypeVar("Place", bound=Output)


class FileWriter(Generic[Place]):
    """A file that takes records until it is finished. One thread at a time uses it.

    Attributes:
        output: Where its bytes go.
        contents: The contents so far.
    """

    def __init__(self, output: Place, contents: WrittenContents | None = None) -> None:
        """Go on with a file.

        Args:
            output: Where its bytes go, behind the bytes that are there.
            contents: The contents that are there already; None for an empty file.
        """
        self.output = output
        self.contents = WrittenContents() if contents is None else contents
        self._schema_ids: dict[tuple[str, str, bytes], int] = {}

    def begin(self, library: str = LIBRARY, profile: str = "") -> None:
        """Write the start of the file.

        Args:
            library: The writer's name in the header.
            profile: The profile of the messages in the header: "ros1", "ros2" or nothing.
        """
        self.output.write(records.file_start(library, profile))

    @property
    def size(self) -> int:
        """Bytes so far."""
        return self.output.size

    def add_schema(self, schema: Schema) -> None:
        """Write a schema."""
        record = records.SCHEMA.pack(schema)
        self.output.write(record)
        self.contents.schemas[schema.id] = record
        self._schema_ids.setdefault((schema.name, schema.encoding, schema.data), schema.id)

    def add_channel(self, channel: Channel) -> None:
        """Write a channel."""
        record = records.CHANNEL.pack(channel)
        self.output.write(record)
        self.contents.channels[channel.id] = record
        self.contents.counts.setdefault(channel.id, 0)

    def add_connection(self, number: int, connection: Connection, schema_id: int | None = None) -> None:
        """Write a channel, and its schema if none before it is the same.

        Args:
            number: The channel's id.
            connection: The channel. Without a type it has no schema.
            schema_id: Of its schema, if that was added under an id of its own; None to look for it.
        """
        key = (connection.type, connection.schema_encoding, connection.definition)
        if schema_id is None and any(key) and key not in self._schema_ids:
            self.add_schema(Schema(max(self.contents.schemas, default=0) + 1, *key))
        if schema_id is None:
            schema_id = self._schema_ids.get(key, 0)
        metadata = dict(connection.metadata)
        self.add_channel(Channel(number, schema_id, connection.topic, connection.message_encoding, metadata))

    def add_chunk(self, chunk: PackedChunk) -> None:
        """Write a chunk with its message indexes."""
        at = self.size
        self.output.write(chunk.head, chunk.data, *chunk.indexes.values())
        self.contents.add_chunk(chunk, at)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a Metadata record."""
        at, record = self.size, records.METADATA.pack(records.Metadata(name, values))
        self.output.write(record)
        self.contents.metadata.append(MetadataEntry(name, at, len(record)))

    def add_attachment(self, record: Iterable[bytes], entry: AttachmentEntry) -> None:
        """Copy an Attachment record.

        Args:
            record: Its bytes, some at a time.
            entry: Its entry in the summary of its file.
        """
        at = self.size
        for part in record:
            self.output.write(part)
        self.contents.attachments.append(replace(entry, offset=at, length=self.size - at))

    def write_end(self) -> None:
        """Write the end of the data section and the summary, at once."""
        data_end = records.DATA_END.pack(records.DataEnd(0))
        self.output.write(data_end, self.contents.summary(self.size + len(data_end)))
