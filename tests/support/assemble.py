"""MCAP files put together record by record from the plain `mcap` package's parts, right or deliberately wrong."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

MAGIC = b"\x89MCAP0\r\n"


@dataclass
class Bundle(Chunk):
    """A chunk that remembers the records in it."""

    inside: Sequence[McapRecord] = ()


@dataclass
class Draft:
    """A file in the making; each step fills in what is right, and a test may change it before the next."""

    data: list[McapRecord]
    """The data section without its DataEnd."""
    header: Header = field(default_factory=lambda: Header("", "tests"))
    data_end: list[McapRecord] = field(default_factory=lambda: [DataEnd(0)])
    summary: list[McapRecord] = field(default_factory=list)
    offsets: list[SummaryOffset] = field(default_factory=list)
    footer: Footer = field(default_factory=lambda: Footer(0, 0, 0))

    @property
    def front(self) -> bytes:
        """All bytes before the summary."""
        return MAGIC + written([self.header, *self.data, *self.data_end])

    def summarise(self) -> Draft:
        """Fill in the summary that fits the data section."""
        self.summary = [
            *_definitions(self.data),
            _statistics(self.data),
            *_indexes(self.data, len(MAGIC + written([self.header]))),
        ]
        return self

    def locate(self) -> Draft:
        """Fill in the summary offsets that fit the summary."""
        self.offsets, start = [], len(self.front)
        for opcode, group in groupby(self.summary, key=lambda record: written([record])[0]):
            length = len(written(group))
            self.offsets.append(SummaryOffset(Opcode(opcode), start, length))
            start += length
        return self

    def close(self) -> Draft:
        """Fill in the footer that fits everything before it."""
        start, summary = len(self.front), written(self.summary)
        footer = Footer(start, start + len(summary) if self.offsets else 0, 0)
        covered = summary + written(self.offsets) + written([footer])[:-4]
        self.footer = replace(footer, summary_crc=zlib.crc32(covered))
        return self

    def finish(self) -> bytes:
        """Fill in offsets and footer, and return the whole file."""
        return self.locate().close().bytes()

    def bytes(self) -> bytes:
        """The whole file as it stands."""
        return self.front + written([*self.summary, *self.offsets, self.footer]) + MAGIC

    def save(self, path: Path) -> Path:
        """Write the finished file."""
        path.write_bytes(self.finish())
        return path


def written(records: Iterable[McapRecord]) -> bytes:
    """Records one after the other, as bytes."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def bundle(records: Sequence[McapRecord]) -> list[McapRecord]:
    """An uncompressed chunk of these records, and the message indexes that belong after it."""
    raw = written(records)
    times = [record.log_time for record in records if isinstance(record, Message)]
    entries: dict[int, list[tuple[int, int]]] = {}
    for number, record in enumerate(records):
        if isinstance(record, Message):
            entries.setdefault(record.channel_id, []).append((record.log_time, len(written(records[:number]))))
    chunk = Bundle("", raw, max(times, default=0), min(times, default=0), zlib.crc32(raw), len(raw), records)
    return [chunk, *(MessageIndex(channel_id, found) for channel_id, found in entries.items())]


def _flat(data: Iterable[McapRecord]) -> list[McapRecord]:
    return [inner for record in data for inner in (record.inside if isinstance(record, Bundle) else [record])]


def _definitions(data: list[McapRecord]) -> list[McapRecord]:
    schemas = {record.id: record for record in _flat(data) if isinstance(record, Schema)}
    channels = {record.id: record for record in _flat(data) if isinstance(record, Channel)}
    return [*schemas.values(), *channels.values()]


def _statistics(data: list[McapRecord]) -> Statistics:
    flat = _flat(data)
    messages = [record for record in flat if isinstance(record, Message)]
    counts: dict[int, int] = {}
    for message in messages:
        counts[message.channel_id] = counts.get(message.channel_id, 0) + 1
    return Statistics(
        attachment_count=sum(isinstance(record, Attachment) for record in flat),
        channel_count=len({record.id for record in flat if isinstance(record, Channel)}),
        channel_message_counts=counts,
        chunk_count=sum(isinstance(record, Chunk) for record in data),
        message_count=len(messages),
        message_end_time=max((message.log_time for message in messages), default=0),
        message_start_time=min((message.log_time for message in messages), default=0),
        metadata_count=sum(isinstance(record, Metadata) for record in flat),
        schema_count=len({record.id for record in flat if isinstance(record, Schema)} - {0}),
    )


def _indexes(data: list[McapRecord], start: int) -> list[McapRecord]:
    """The index records of a data section that starts at byte `start`, grouped by kind."""
    chunks: list[ChunkIndex] = []
    others: list[McapRecord] = []
    offset = start
    for record in data:
        size = len(written([record]))
        if isinstance(record, Chunk):
            chunks.append(_chunk_index(record, offset, size))
        elif isinstance(record, MessageIndex) and chunks:
            chunks[-1].message_index_offsets[record.channel_id] = offset
            chunks[-1].message_index_length += size
        elif isinstance(record, Attachment):
            others.append(_attachment_index(record, offset, size))
        elif isinstance(record, Metadata):
            others.append(MetadataIndex(offset, size, record.name))
        offset += size
    return [*chunks, *sorted(others, key=lambda record: type(record).__name__)]


def _chunk_index(chunk: Chunk, offset: int, size: int) -> ChunkIndex:
    return ChunkIndex(
        chunk_length=size,
        chunk_start_offset=offset,
        compression=chunk.compression,
        compressed_size=len(chunk.data),
        message_end_time=chunk.message_end_time,
        message_index_length=0,
        message_index_offsets={},
        message_start_time=chunk.message_start_time,
        uncompressed_size=chunk.uncompressed_size,
    )


def _attachment_index(attachment: Attachment, offset: int, size: int) -> AttachmentIndex:
    return AttachmentIndex(
        offset=offset,
        length=size,
        log_time=attachment.log_time,
        create_time=attachment.create_time,
        data_size=len(attachment.data),
        name=attachment.name,
        media_type=attachment.media_type,
    )
