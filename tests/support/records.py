"""The records of an MCAP file, cut out of its bytes.

The layouts are those of https://mcap.dev/spec, section "Records". Nothing here comes from the library under test, so its writer and this
walker cannot share a mistake.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import TypeVar

MAGIC = b"\x89MCAP0\r\n"
PREFIX_BYTES = 9
"""The opcode (1 byte) and the length of the fields (8 bytes) before them."""

K = TypeVar("K")
V = TypeVar("V")


class Opcode(IntEnum):
    """The kinds of record that the specification defines."""

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


class MalformedError(ValueError):
    """Bytes that are not the record that they should be; the message says why."""


@dataclass(frozen=True, slots=True)
class Record:
    """One record: where it stands and what it holds."""

    opcode: int
    offset: int
    """Of the opcode, in bytes from the start of the file; inside a chunk from the start of its uncompressed records."""
    chunk: int | None
    """Where in the file the chunk around the record starts; None outside chunks."""
    content: bytes
    """The fields as they are written."""

    @property
    def size(self) -> int:
        """Bytes from the opcode to the last field."""
        return PREFIX_BYTES + len(self.content)

    @property
    def end(self) -> int:
        """The offset of the first byte after the record."""
        return self.offset + self.size

    @property
    def where(self) -> str:
        """The subject of a sentence about this record."""
        name = f"{type(self).__name__} at byte {self.offset}"
        return name if self.chunk is None else f"{name} in the chunk at byte {self.chunk}"


@dataclass(frozen=True, slots=True)
class Unknown(Record):
    """A record whose opcode the specification does not define."""


@dataclass(frozen=True, slots=True)
class Unreadable(Record):
    """A record of a known kind whose fields do not fit its length."""

    reason: str


@dataclass(frozen=True, slots=True)
class Header(Record):
    profile: str
    library: str


@dataclass(frozen=True, slots=True)
class Footer(Record):
    summary_start: int
    summary_offset_start: int
    summary_crc: int


@dataclass(frozen=True, slots=True)
class Schema(Record):
    id: int
    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True, slots=True)
class Channel(Record):
    id: int
    schema_id: int
    topic: str
    message_encoding: str
    metadata: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Message(Record):
    channel_id: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Chunk(Record):
    message_start_time: int
    message_end_time: int
    uncompressed_size: int
    uncompressed_crc: int
    compression: str
    data: bytes


@dataclass(frozen=True, slots=True)
class MessageIndex(Record):
    channel_id: int
    entries: tuple[tuple[int, int], ...]
    """Log time (ns) and offset in the uncompressed chunk (bytes) of each message."""


@dataclass(frozen=True, slots=True)
class ChunkIndex(Record):
    message_start_time: int
    message_end_time: int
    chunk_start_offset: int
    chunk_length: int
    message_index_offsets: Mapping[int, int]
    message_index_length: int
    compression: str
    compressed_size: int
    uncompressed_size: int


@dataclass(frozen=True, slots=True)
class Attachment(Record):
    log_time: int
    create_time: int
    name: str
    media_type: str
    data: bytes
    crc: int


@dataclass(frozen=True, slots=True)
class AttachmentIndex(Record):
    attachment_offset: int
    attachment_length: int
    log_time: int
    create_time: int
    data_size: int
    name: str
    media_type: str


@dataclass(frozen=True, slots=True)
class Statistics(Record):
    message_count: int
    schema_count: int
    channel_count: int
    attachment_count: int
    metadata_count: int
    chunk_count: int
    message_start_time: int
    message_end_time: int
    channel_message_counts: Mapping[int, int]


@dataclass(frozen=True, slots=True)
class Metadata(Record):
    name: str
    metadata: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class MetadataIndex(Record):
    metadata_offset: int
    metadata_length: int
    name: str


@dataclass(frozen=True, slots=True)
class SummaryOffset(Record):
    group_opcode: int
    group_start: int
    group_length: int


@dataclass(frozen=True, slots=True)
class DataEnd(Record):
    data_section_crc: int


class Fields:
    """Takes the fields of one record from front to back."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self._position = 0

    @property
    def left(self) -> int:
        """Bytes not yet taken."""
        return len(self._content) - self._position

    def raw(self, count: int) -> bytes:
        if count > self.left:
            raise MalformedError(
                f"needs {count} bytes at byte {self._position} of its fields, but only {self.left} are left"
            )
        self._position += count
        return self._content[self._position - count : self._position]

    def u8(self) -> int:
        return self.raw(1)[0]

    def u16(self) -> int:
        return int.from_bytes(self.raw(2), "little")

    def u32(self) -> int:
        return int.from_bytes(self.raw(4), "little")

    def u64(self) -> int:
        return int.from_bytes(self.raw(8), "little")

    def text(self) -> str:
        data = self.raw(self.u32())
        try:
            return data.decode("utf-8")
        except UnicodeDecodeError as error:
            raise MalformedError(f"has a text that is not UTF-8: {data!r}") from error

    def array(self, take: Callable[[Fields], V]) -> tuple[V, ...]:
        inner = Fields(self.raw(self.u32()))
        items = []
        while inner.left:
            items.append(take(inner))
        return tuple(items)

    def mapping(self, key: Callable[[Fields], K], value: Callable[[Fields], V]) -> dict[K, V]:
        pairs = self.array(lambda fields: (key(fields), value(fields)))
        result = dict(pairs)
        if len(result) < len(pairs):
            raise MalformedError(f"has a key twice in one map: {[pair[0] for pair in pairs]}")
        return result


_PLANS: dict[int, tuple[type[Record], tuple[Callable[[Fields], object], ...]]] = {}
"""For each opcode the class of its record, and how its fields are taken in the order of the specification."""


def _plan(opcode: Opcode, kind: type[Record], *takes: Callable[[Fields], object]) -> None:
    _PLANS[opcode] = (kind, takes)


def _text_map(fields: Fields) -> dict[str, str]:
    return fields.mapping(Fields.text, Fields.text)


def _count_map(fields: Fields) -> dict[int, int]:
    return fields.mapping(Fields.u16, Fields.u64)


def _time_and_offset(fields: Fields) -> tuple[int, int]:
    return fields.u64(), fields.u64()


def _entries(fields: Fields) -> tuple[tuple[int, int], ...]:
    return fields.array(_time_and_offset)


def _short_blob(fields: Fields) -> bytes:
    return fields.raw(fields.u32())


def _long_blob(fields: Fields) -> bytes:
    return fields.raw(fields.u64())


def _rest(fields: Fields) -> bytes:
    return fields.raw(fields.left)


_U8, _U16, _U32, _U64, _TEXT = Fields.u8, Fields.u16, Fields.u32, Fields.u64, Fields.text

_plan(Opcode.HEADER, Header, _TEXT, _TEXT)
_plan(Opcode.FOOTER, Footer, _U64, _U64, _U32)
_plan(Opcode.SCHEMA, Schema, _U16, _TEXT, _TEXT, _short_blob)
_plan(Opcode.CHANNEL, Channel, _U16, _U16, _TEXT, _TEXT, _text_map)
_plan(Opcode.MESSAGE, Message, _U16, _U32, _U64, _U64, _rest)
_plan(Opcode.CHUNK, Chunk, _U64, _U64, _U64, _U32, _TEXT, _long_blob)
_plan(Opcode.MESSAGE_INDEX, MessageIndex, _U16, _entries)
_plan(Opcode.CHUNK_INDEX, ChunkIndex, _U64, _U64, _U64, _U64, _count_map, _U64, _TEXT, _U64, _U64)
_plan(Opcode.ATTACHMENT, Attachment, _U64, _U64, _TEXT, _TEXT, _long_blob, _U32)
_plan(Opcode.ATTACHMENT_INDEX, AttachmentIndex, _U64, _U64, _U64, _U64, _U64, _TEXT, _TEXT)
_plan(Opcode.STATISTICS, Statistics, _U64, _U16, _U32, _U32, _U32, _U32, _U64, _U64, _count_map)
_plan(Opcode.METADATA, Metadata, _TEXT, _text_map)
_plan(Opcode.METADATA_INDEX, MetadataIndex, _U64, _U64, _TEXT)
_plan(Opcode.SUMMARY_OFFSET, SummaryOffset, _U8, _U64, _U64)
_plan(Opcode.DATA_END, DataEnd, _U32)


def parse(opcode: int, offset: int, chunk: int | None, content: bytes) -> Record:
    """One record from its fields; an `Unreadable` one when they do not fit."""
    if opcode not in _PLANS:
        return Unknown(opcode, offset, chunk, content)
    kind, takes = _PLANS[opcode]
    fields = Fields(content)
    try:
        values = [take(fields) for take in takes]
    except MalformedError as error:
        return Unreadable(opcode, offset, chunk, content, f"should be a {kind.__name__} but {error}")
    if fields.left:
        return Unreadable(
            opcode,
            offset,
            chunk,
            content,
            f"should be a {kind.__name__} but has {fields.left} bytes after its last field",
        )
    return kind(opcode, offset, chunk, content, *values)


def walk(data: bytes, start: int = 0, chunk: int | None = None) -> Iterator[Record]:
    """The records of `data` from byte `start` on: to the Footer in a file, to the end in a chunk.

    Args:
        data: a whole file, or the uncompressed records of a chunk.
        start: where the first record begins.
        chunk: where in the file the chunk begins whose records these are; None for a file.

    Raises:
        MalformedError: a record reaches beyond the end.
    """
    offset = start
    while offset < len(data):
        length = int.from_bytes(data[offset + 1 : offset + PREFIX_BYTES], "little")
        end = offset + PREFIX_BYTES + length
        if offset + PREFIX_BYTES > len(data) or end > len(data):
            raise MalformedError(
                f"the record at byte {offset} (opcode {data[offset]:#04x}) reaches beyond the last byte, {len(data)}"
            )
        record = parse(data[offset], offset, chunk, data[offset + PREFIX_BYTES : end])
        yield record
        if record.opcode == Opcode.FOOTER and chunk is None:
            return
        offset = end
