"""MCAP records from bytes that may be hostile (layouts: https://mcap.dev/spec, section "Records").

"Records may be extended by adding new fields at the end of existing fields. Readers should ignore any unknown fields.":
whatever follows the last field that is read here does not matter. Only a Footer and a Message are never extended.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from ..errors import DamagedFileError
from .record_fields import Bytes as Bytes
from .record_fields import Fields as Fields

MAGIC = b"\x89MCAP0\r\n"
PREFIX_BYTES = 9
"""A record starts with its opcode (1 byte) and the length of what follows (8 bytes)."""

ENTRY_BYTES = 16
"""One entry of a message index."""

FOOTER_BYTES = PREFIX_BYTES + 20
"""A footer, with its prefix."""

CRC_BYTES = 4
"""What follows an attachment's data."""

CHUNK_HEAD_BYTES = 8 + 8 + 8 + 4 + 4 + 32 + 8
"""Enough of a chunk's content to hold everything before its records, for a compression name of up to 32 bytes."""

FIRST_PRIVATE = 0x80
"""From this opcode on records belong to applications."""

LOOSE = "\0loose"
"""Stands for the compression of messages that lie in the file outside any chunk."""

_PREFIX = struct.Struct("<BQ")


class Opcode(IntEnum):
    """The first byte of a record."""

    HEADER = 0x01
    FOOTER = 0x02
    SCHEMA = 0x03
    CHANNEL = 0x04
    MESSAGE = 0x05
    CHUNK = 0x06
    MESSAGE_INDEX = 0x07
    CHUNK_INDEX = 0x08
    ATTACHMENT = 0x09
    ATTACHMENT_INDEX = 0x0A
    STATISTICS = 0x0B
    METADATA = 0x0C
    METADATA_INDEX = 0x0D
    SUMMARY_OFFSET = 0x0E
    DATA_END = 0x0F


@dataclass(frozen=True, slots=True)
class Header:
    """What kind of file it is, and who wrote it."""

    profile: str
    library: str


@dataclass(frozen=True, slots=True)
class Schema:
    """What the messages of a channel look like."""

    id: int
    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic in one file."""

    id: int
    schema_id: int
    topic: str
    message_encoding: str
    metadata: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Chunk:
    """Where a chunk lies and what it says about itself."""

    offset: int
    """Of the record, from the start of the file, in bytes."""
    length: int
    """Of the whole record, in bytes."""
    start_ns: int
    end_ns: int
    """Log times of its first and last messages, both included, in ns."""
    compression: str
    """"zstd", "lz4", "" for none, or `LOOSE`."""
    compressed_size: int
    uncompressed_size: int
    message_index_offsets: Mapping[int, int] = field(default_factory=dict)
    """Channel to the offset of its MessageIndex record."""
    message_index_length: int = 0
    """Of all MessageIndex records, which lie behind the chunk, in bytes."""
    indexed: bool = True
    """Whether the message indexes cover every message; if not, the chunk's own records have to be walked."""
    counts: Mapping[int, int] | None = None
    """Channel to how many messages; None where nobody has counted yet."""

    @property
    def end(self) -> int:
        """Where the record ends."""
        return self.offset + self.length


@dataclass(frozen=True, slots=True)
class ChunkHead:
    """What precedes a chunk's records."""

    start_ns: int
    end_ns: int
    uncompressed_size: int
    uncompressed_crc: int
    compression: str
    records_at: int
    """Where the (compressed) records start, from the start of the chunk's content, in bytes."""
    records_length: int


@dataclass(frozen=True, slots=True)
class MessageIndex:
    """Where the messages of one channel lie in a chunk."""

    channel_id: int
    times_ns: npt.NDArray[np.uint64]
    offsets: npt.NDArray[np.uint64]
    """From the start of the chunk's uncompressed records, in bytes."""


@dataclass(frozen=True, slots=True)
class Statistics:
    """How much of everything a file holds."""

    message_count: int
    schema_count: int
    channel_count: int
    chunk_count: int
    attachment_count: int
    metadata_count: int
    start_ns: int
    end_ns: int
    channel_message_counts: Mapping[int, int]


@dataclass(frozen=True, slots=True)
class Metadata:
    """A named set of texts."""

    name: str
    values: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class MetadataEntry:
    """Where a Metadata record lies."""

    name: str
    offset: int
    length: int


@dataclass(frozen=True, slots=True)
class AttachmentEntry:
    """Where an Attachment record lies."""

    name: str
    media_type: str
    log_time_ns: int
    create_time_ns: int
    """0 where nobody knows."""
    data_size: int
    offset: int
    length: int


@dataclass(frozen=True, slots=True)
class SummaryOffset:
    """Where the records of one kind lie in a summary."""

    opcode: int
    start: int
    length: int


@dataclass(frozen=True, slots=True)
class Footer:
    """Where the summary starts; 0 where there is none."""

    summary_start: int
    summary_offset_start: int
    summary_crc: int


def prefix(data: Bytes, at: int) -> tuple[int, int]:
    """Return the opcode and the content's length of the record that starts at `at`; its 9 bytes must be there."""
    opcode, length = _PREFIX.unpack_from(data, at)
    return opcode, length


def split(data: Bytes, path: str, base: int) -> Iterator[tuple[int, int, Fields]]:
    """Walk records that lie one behind the other and fill `data`.

    Yields:
        Opcode, offset in the file, content.

    Raises:
        DamagedFileError: The records do not end where `data` ends.
    """
    at = 0
    while at < len(data):
        opcode, fields = one(data, at, path, base)
        yield opcode, base + at, fields
        at = fields.end


def one(data: Bytes, at: int, path: str, base: int) -> tuple[int, Fields]:
    """Return the opcode and the content of the record that starts at `at`, which is `base + at` in the file.

    Raises:
        DamagedFileError: It does not end where `data` ends, or before.
    """
    content = at + PREFIX_BYTES
    if len(data) < content:
        raise DamagedFileError(path, base + at, f"{len(data) - at} bytes where a record should start")
    opcode, length = prefix(data, at)
    if length > len(data) - content:
        raise DamagedFileError(path, base + at, f"a record of {length} bytes where {len(data) - content} are left")
    return opcode, Fields(data, path, base, content, content + length)


def header(fields: Fields) -> Header:
    """Read a Header's content."""
    return Header(profile=fields.text(), library=fields.text())


def schema(fields: Fields) -> Schema:
    """Read a Schema's content."""
    return Schema(id=fields.u16(), name=fields.text(), encoding=fields.text(), data=fields.raw(fields.u32()))


def channel(fields: Fields) -> Channel:
    """Read a Channel's content."""
    return Channel(
        id=fields.u16(),
        schema_id=fields.u16(),
        topic=fields.text(),
        message_encoding=fields.text(),
        metadata=fields.texts(),
    )


def chunk_head(fields: Fields) -> ChunkHead:
    """Read the start of a Chunk's content."""
    start = fields.at
    start_ns, end_ns, size, crc = fields.u64(), fields.u64(), fields.u64(), fields.u32()
    compression = _compression(fields)
    length = fields.u64()
    return ChunkHead(start_ns, end_ns, size, crc, compression, fields.at - start, length)


def message_index(fields: Fields) -> MessageIndex:
    """Read a MessageIndex's content."""
    channel_id = fields.u16()
    times_ns, offsets = fields.entries()
    return MessageIndex(channel_id, times_ns, offsets)


def chunk_index(fields: Fields) -> Chunk:
    """Read a ChunkIndex's content."""
    start_ns, end_ns, offset, length = fields.u64(), fields.u64(), fields.u64(), fields.u64()
    message_index_offsets = fields.numbers()
    message_index_length = fields.u64()
    return Chunk(
        offset=offset,
        length=length,
        start_ns=start_ns,
        end_ns=end_ns,
        compression=_compression(fields),
        compressed_size=fields.u64(),
        uncompressed_size=fields.u64(),
        message_index_offsets=message_index_offsets,
        message_index_length=message_index_length,
        indexed=bool(message_index_offsets),
    )


def _compression(fields: Fields) -> str:
    name = fields.text()
    if name == LOOSE:
        fields.refuse(f"the compression {name!r}, which no chunk can have")
    return name


def statistics(fields: Fields) -> Statistics:
    """Read a Statistics record's content."""
    message_count, schema_count, channel_count = fields.u64(), fields.u16(), fields.u32()
    attachment_count, metadata_count, chunk_count = fields.u32(), fields.u32(), fields.u32()
    return Statistics(
        message_count=message_count,
        schema_count=schema_count,
        channel_count=channel_count,
        chunk_count=chunk_count,
        attachment_count=attachment_count,
        metadata_count=metadata_count,
        start_ns=fields.u64(),
        end_ns=fields.u64(),
        channel_message_counts=fields.numbers(),
    )


def metadata(fields: Fields) -> Metadata:
    """Read a Metadata record's content."""
    return Metadata(name=fields.text(), values=fields.texts())


def metadata_index(fields: Fields) -> MetadataEntry:
    """Read a MetadataIndex's content."""
    offset, length = fields.u64(), fields.u64()
    return MetadataEntry(name=fields.text(), offset=offset, length=length)


def attachment(fields: Fields, offset: int, length: int) -> AttachmentEntry:
    """Read the start of an Attachment's content, without its data."""
    log_time_ns, create_time_ns = fields.u64(), fields.u64()
    name, media_type = fields.text(), fields.text()
    return AttachmentEntry(name, media_type, log_time_ns, create_time_ns, fields.u64(), offset, length)


def attachment_index(fields: Fields) -> AttachmentEntry:
    """Read an AttachmentIndex's content."""
    offset, length, log_time_ns, create_time_ns = fields.u64(), fields.u64(), fields.u64(), fields.u64()
    data_size = fields.u64()
    return AttachmentEntry(fields.text(), fields.text(), log_time_ns, create_time_ns, data_size, offset, length)


def summary_offset(fields: Fields) -> SummaryOffset:
    """Read a SummaryOffset's content."""
    return SummaryOffset(fields.u8(), fields.u64(), fields.u64())


def data_end(fields: Fields) -> int:
    """Read a DataEnd's content: the checksum (CRC-32) of everything before it; 0 for none."""
    return fields.u32()


def footer(fields: Fields) -> Footer:
    """Read a Footer's content."""
    return Footer(fields.u64(), fields.u64(), fields.u32())
