"""The records of an MCAP file and the layout of each, for reading and for writing (https://mcap.dev/spec, "Records").

Message and MessageIndex records are in `message_records`: there are too many of them to go field by field. A record is
read by `SCHEMA.read(fields)` and written by `SCHEMA.pack(schema)`. Whether our reader and our writer are both wrong is
told by bytes that the tests lay out by hand, and by other tools.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

from ..file_names import BLOCK_OPCODE, WIDER_SCHEMA_OPCODE
from .record_layout import (
    DATA,
    NUMBER_MAP,
    PREFIX_BYTES,
    TEXT,
    TEXT_MAP,
    U8,
    U16,
    U32,
    U64,
    FieldKind,
    Fields,
    RecordLayout,
)

MAGIC = b"\x89MCAP0\r\n"

FOOTER_BYTES = PREFIX_BYTES + 20
"""A footer, with its prefix."""

CRC_BYTES = 4
"""The size of the checksum behind an attachment's data."""

_USUAL_NAME_BYTES = 32

CHUNK_HEAD_BYTES = 8 + 8 + 8 + 4 + 4 + _USUAL_NAME_BYTES + 8
"""Enough of a chunk's content to hold everything before its records, for a compression name of up to 32 bytes."""

FIRST_PRIVATE = 0x80
"""From this opcode on records belong to applications."""

LOOSE = "\0loose"
"""Stands for the compression of messages that lie in the file outside any chunk."""


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
    """The start of a file: the profile of its messages, and the library that wrote it."""

    profile: str
    library: str


@dataclass(frozen=True, slots=True)
class Schema:
    """The type of the messages of a channel."""

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
    """The place and the contents of a chunk, as a ChunkIndex record states them."""

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
    """Whether the message indexes cover every message; if not, the chunk's own records have to be scanned."""
    counts: Mapping[int, int] | None = None
    """Channel to how many messages; None where they have not been counted."""

    @property
    def end(self) -> int:
        """Where the record ends."""
        return self.offset + self.length

    @property
    def indexes_end(self) -> int:
        """Where the message indexes behind the chunk end."""
        return self.end + self.message_index_length


@dataclass(frozen=True, slots=True)
class ChunkHead:
    """The fields of a Chunk record before its records."""

    start_ns: int
    end_ns: int
    uncompressed_size: int
    uncompressed_crc: int
    compression: str
    records_length: int
    """Of the compressed records, in bytes."""

    @property
    def records_at(self) -> int:
        """Where the compressed records start, from the start of the chunk's content, in bytes."""
        return CHUNK_HEAD_BYTES - _USUAL_NAME_BYTES + len(self.compression.encode())


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
    """0 where it is not known."""
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


@dataclass(frozen=True, slots=True)
class DataEnd:
    """The end of the data section."""

    data_section_crc: int
    """The checksum (CRC-32) of everything before it; 0 for none, as in our files: schemas are rewritten in place."""


@dataclass(frozen=True, slots=True)
class BlockEnd:
    """A private record behind the chunks of one block of a recorder: see `file_names.BLOCK_OPCODE`."""

    number: int


def _chunk_compression(fields: Fields) -> str:
    name = fields.text()
    if name == LOOSE:
        fields.refuse(f"the compression {name!r}, which no chunk can have")
    return name


def _chunk(message_index_offsets: Mapping[int, int], **numbers: Any) -> Chunk:
    return Chunk(message_index_offsets=message_index_offsets, indexed=bool(message_index_offsets), **numbers)


_COMPRESSION = FieldKind(_chunk_compression, TEXT.write)

HEADER = RecordLayout(Opcode.HEADER, Header, profile=TEXT, library=TEXT)

FOOTER = RecordLayout(Opcode.FOOTER, Footer, summary_start=U64, summary_offset_start=U64, summary_crc=U32)

SCHEMA = RecordLayout(Opcode.SCHEMA, Schema, id=U16, name=TEXT, encoding=TEXT, data=DATA)

CHANNEL = RecordLayout(
    Opcode.CHANNEL, Channel, id=U16, schema_id=U16, topic=TEXT, message_encoding=TEXT, metadata=TEXT_MAP
)

CHUNK_HEAD = RecordLayout(
    Opcode.CHUNK,
    ChunkHead,
    start_ns=U64,
    end_ns=U64,
    uncompressed_size=U64,
    uncompressed_crc=U32,
    compression=_COMPRESSION,
    records_length=U64,
)
"""The records follow."""

CHUNK_INDEX = RecordLayout(
    Opcode.CHUNK_INDEX,
    _chunk,
    start_ns=U64,
    end_ns=U64,
    offset=U64,
    length=U64,
    message_index_offsets=NUMBER_MAP,
    message_index_length=U64,
    compression=_COMPRESSION,
    compressed_size=U64,
    uncompressed_size=U64,
)

ATTACHMENT_HEAD = RecordLayout(
    Opcode.ATTACHMENT,
    AttachmentEntry,
    log_time_ns=U64,
    create_time_ns=U64,
    name=TEXT,
    media_type=TEXT,
    data_size=U64,
)
"""The data and their checksum follow. Reading wants the `offset` and the `length` of the record besides."""

ATTACHMENT_INDEX = RecordLayout(
    Opcode.ATTACHMENT_INDEX,
    AttachmentEntry,
    offset=U64,
    length=U64,
    log_time_ns=U64,
    create_time_ns=U64,
    data_size=U64,
    name=TEXT,
    media_type=TEXT,
)

STATISTICS = RecordLayout(
    Opcode.STATISTICS,
    Statistics,
    message_count=U64,
    schema_count=U16,
    channel_count=U32,
    attachment_count=U32,
    metadata_count=U32,
    chunk_count=U32,
    start_ns=U64,
    end_ns=U64,
    channel_message_counts=NUMBER_MAP,
)

METADATA = RecordLayout(Opcode.METADATA, Metadata, name=TEXT, values=TEXT_MAP)

METADATA_INDEX = RecordLayout(Opcode.METADATA_INDEX, MetadataEntry, offset=U64, length=U64, name=TEXT)

SUMMARY_OFFSET = RecordLayout(Opcode.SUMMARY_OFFSET, SummaryOffset, opcode=U8, start=U64, length=U64)

DATA_END = RecordLayout(Opcode.DATA_END, DataEnd, data_section_crc=U32)

WIDER_SCHEMA = RecordLayout(WIDER_SCHEMA_OPCODE, Schema, id=U16, name=TEXT, encoding=TEXT, data=DATA)

BLOCK_END = RecordLayout(BLOCK_OPCODE, BlockEnd, number=U64)


def file_start(library: str, profile: str = "") -> bytes:
    """Return the bytes that a file begins with.

    Args:
        library: Who writes it.
        profile: The profile of the messages: "ros1", "ros2" or nothing.
    """
    return MAGIC + HEADER.pack(Header(profile, library))
