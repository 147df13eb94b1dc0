"""Reads a finished file's index from its footer and its summary."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TypeVar
from zlib import crc32

import numpy as np

from ..errors import DamagedFileError
from ..store.byte_source import ByteSource
from . import chunk_table, records
from .chunk_indexes import ChunkIndexes
from .file_index import FileIndex, Glance
from .limits import Limits
from .message_records import MESSAGE_HEAD_BYTES
from .record_layout import PREFIX_BYTES, Fields, read_prefix, split_records
from .records import (
    AttachmentEntry,
    Channel,
    Chunk,
    Footer,
    Header,
    MetadataEntry,
    Opcode,
    Schema,
    Statistics,
    SummaryOffset,
)

_TAIL_BYTES = records.FOOTER_BYTES + len(records.MAGIC)

_LAST = 2**64 - 1

_SMALL_BYTES = 64 * 1024
"""A summary up to this size is read whole at once."""


def read_footer(source: ByteSource, size: int) -> Footer | None:
    """Return a file's footer, or None if the file has no end: it is being recorded, or was cut."""
    if size < _TAIL_BYTES + len(records.MAGIC):
        return None
    start = size - _TAIL_BYTES
    tail = source.read(start, _TAIL_BYTES)
    if len(tail) < _TAIL_BYTES or not tail.endswith(records.MAGIC):
        return None
    opcode, length = read_prefix(tail, 0)
    if opcode != Opcode.FOOTER or length != records.FOOTER_BYTES - PREFIX_BYTES:
        return None
    return records.FOOTER.read(Fields(tail, source.name, start, PREFIX_BYTES))


def read(source: ByteSource, size: int, header: Header, footer: Footer, limits: Limits) -> FileIndex | None:
    """Build the index from the summary.

    Returns:
        None where the summary does not say enough to find every message, channel and metadata record.

    Raises:
        DamagedFileError: The summary contradicts itself.
    """
    start, end = footer.summary_start, size - _TAIL_BYTES
    if not _is_plausible(footer, size, limits):
        return None
    data = source.read(start, size - len(records.MAGIC) - start)
    if len(data) != end + records.FOOTER_BYTES - start:
        raise DamagedFileError(source.name, start, "the file was cut while its summary was read")
    # The checksum is the last field of the footer, and covers the footer up to it.
    if footer.summary_crc and crc32(memoryview(data)[:-4]) != footer.summary_crc:
        raise DamagedFileError(source.name, start, "a summary whose checksum (CRC-32) does not match its content")
    contents = SummaryContents(source.name)
    contents.take(memoryview(data)[: end - start], start)
    contents.chunks = contents.indexes.chunks(start)
    contents.check_apart(start)
    return replace(contents.index(header, start), size=size) if contents.is_sufficient(limits) else None


def glance(source: ByteSource, size: int, header: Header, footer: Footer, limits: Limits) -> Glance | None:
    """Read a long summary without its chunk indexes, so that opening a file costs the same however long it is.

    The parts that are read are not verified: the checksum is that of the whole summary.

    Returns:
        None where the summary is short, or does not say where its groups are: it is to be read as a whole.
    """
    start, end, groups_at = footer.summary_start, size - _TAIL_BYTES, footer.summary_offset_start
    if not _is_plausible(footer, size, limits) or not start < groups_at <= end:
        return None
    if end - start <= _SMALL_BYTES or end - groups_at > _SMALL_BYTES:
        return None
    contents = SummaryContents(source.name)
    try:
        groups = _groups(memoryview(source.read(groups_at, end - groups_at)), source.name, groups_at)
        wanted = {opcode: place for opcode, *place in groups if opcode != Opcode.CHUNK_INDEX}
        if len({opcode for opcode, _, _ in groups}) < len(groups):
            return None
        if any(at < start or length > _SMALL_BYTES or at + length > groups_at for at, length in wanted.values()):
            return None
        for at, length in wanted.values():
            contents.take(memoryview(source.read(at, length)), at)
        contents.check_apart(start)
    except DamagedFileError:
        return None
    if contents.statistics is None or not contents.knows_channels() or not contents.knows_entries():
        return None
    return Glance(
        header,
        contents.schemas,
        contents.channels,
        tuple(contents.metadata),
        tuple(contents.attachments),
        contents.statistics,
    )


def read_all(source: ByteSource, size: int, footer: Footer, limits: Limits) -> SummaryContents:
    """Return everything that a summary says, true or not.

    Raises:
        DamagedFileError: It cannot be parsed, or its checksum does not match.
    """
    start, end = footer.summary_start, size - _TAIL_BYTES
    contents = SummaryContents(source.name)
    if not _is_plausible(footer, size, limits):
        raise DamagedFileError(source.name, end, "the footer says that it starts where it cannot")
    data = source.read(start, size - len(records.MAGIC) - start)
    if footer.summary_crc and crc32(memoryview(data)[:-4]) != footer.summary_crc:
        raise DamagedFileError(source.name, start, "its checksum (CRC-32) does not match its content")
    data = data[: end - start]
    contents.take(memoryview(data), start)
    contents.chunks = contents.indexes.chunks(start)
    for opcode, at, fields in split_records(data, source.name, start):
        if opcode == Opcode.SUMMARY_OFFSET:
            contents.offsets.append(records.SUMMARY_OFFSET.read(fields))
        length = PREFIX_BYTES + fields.end - fields.start
        last = contents.groups[-1] if contents.groups else None
        if last is not None and last[0] == opcode:
            contents.groups[-1] = (opcode, last[1], last[2] + length)
        else:
            contents.groups.append((opcode, at, length))
    return contents


@dataclass(frozen=True, slots=True)
class Clues:
    """The parts of an unreliable summary that help a scan."""

    places: list[int]
    """Where records of the data section start, in bytes, sorted."""
    statistics: Statistics | None
    """The statistics in the summary."""

    def agree_with(self, index: FileIndex) -> bool:
        """Whether a scan found as many messages of each channel as the statistics say."""
        statistics = self.statistics
        if statistics is None or not statistics.channel_message_counts:
            return True
        return positive(statistics.channel_message_counts) == positive(index.message_counts)


def clues(source: ByteSource, size: int, footer: Footer, limits: Limits) -> Clues:
    """Return the places and statistics in a summary that may be wrong. A scan that steps over damage uses them."""
    if not _is_plausible(footer, size, limits):
        return Clues([], None)
    start = footer.summary_start
    contents = SummaryContents(source.name)
    with suppress(DamagedFileError):
        contents.take(memoryview(source.read(start, size - _TAIL_BYTES - start)), start)
    places = {entry.offset for entries in (contents.metadata, contents.attachments) for entry in entries}
    with suppress(DamagedFileError):
        places.update(chunk.offset for chunk in contents.indexes.chunks(start))
    return Clues(sorted(places), contents.statistics)


def _is_plausible(footer: Footer, size: int, limits: Limits) -> bool:
    return footer.summary_start > 0 and 0 < size - _TAIL_BYTES - footer.summary_start <= limits.summary_bytes


def _groups(data: memoryview, path: str, base: int) -> list[tuple[int, int, int]]:
    """Return the opcode, offset and length of each group of a summary."""
    offsets = [
        records.SUMMARY_OFFSET.read(fields)
        for opcode, _, fields in split_records(data, path, base)
        if opcode == Opcode.SUMMARY_OFFSET
    ]
    return [(offset.opcode, offset.start, offset.length) for offset in offsets]


Entry = TypeVar("Entry", MetadataEntry, AttachmentEntry)


@dataclass(slots=True)
class SummaryContents:
    """The contents of the records of a summary."""

    path: str
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: Sequence[Chunk] = ()
    metadata: list[MetadataEntry] = field(default_factory=list)
    attachments: list[AttachmentEntry] = field(default_factory=list)
    statistics: Statistics | None = None
    offsets: list[SummaryOffset] = field(default_factory=list)
    """The summary offset section; only `read_all` fills it."""
    groups: list[tuple[int, int, int]] = field(default_factory=list)
    """Opcode, start and length of each group of records of one kind; only `read_all` fills it."""
    indexes: ChunkIndexes = field(init=False)
    """The chunk indexes, from which `chunks` is made."""

    def __post_init__(self) -> None:
        self.indexes = ChunkIndexes(self.path)

    def take(self, data: memoryview, start: int) -> None:
        """Take in records; `start` is where in the file they start.

        Raises:
            DamagedFileError: A record contradicts itself.
        """
        for opcode, _, fields in self.indexes.split(data, start):
            if opcode == Opcode.SCHEMA:
                schema = records.SCHEMA.read(fields)
                self.schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = records.CHANNEL.read(fields)
                self.channels[channel.id] = channel
            elif opcode == Opcode.METADATA_INDEX:
                self.metadata.append(records.METADATA_INDEX.read(fields))
            elif opcode == Opcode.ATTACHMENT_INDEX:
                self.attachments.append(records.ATTACHMENT_INDEX.read(fields))
            elif opcode == Opcode.STATISTICS:
                self.statistics = records.STATISTICS.read(fields)

    def check_apart(self, end: int) -> None:
        """Sort everything by where it lies in the file, and check that nothing overlaps or lies behind `end`.

        Raises:
            DamagedFileError: Something does. Otherwise a small file could name one long record any number of times.
        """
        self.metadata = _in_order(self.metadata)
        self.attachments = _in_order(self.attachments)
        entries: list[MetadataEntry | AttachmentEntry] = [*self.metadata, *self.attachments]
        starts, stops = chunk_table.places(self.chunks)
        start = np.append(starts, np.array([entry.offset for entry in entries], np.uint64))
        # Python's numbers may be larger than 64 bits, which numpy refuses.
        stop = np.append(stops, np.array([min(entry.offset + entry.length, _LAST) for entry in entries], np.uint64))
        order = np.argsort(start, kind="stable")
        start, stop = start[order], stop[order]
        wrong = (start >= stop) | (stop > np.uint64(end))
        wrong[1:] |= start[1:] < stop[:-1]
        if wrong.any():
            at = int(start[wrong.argmax()])
            raise DamagedFileError(self.path, at, "the summary puts something here where it cannot be")

    def index(self, header: Header, end: int) -> FileIndex:
        """Return it as the index of a file whose data section ends at `end`."""
        statistics = self.statistics
        return FileIndex(
            path=self.path,
            header=header,
            schemas=self.schemas,
            channels=self.channels,
            chunks=self.chunks,
            message_counts=statistics.channel_message_counts if statistics is not None else {},
            metadata=tuple(self.metadata),
            attachments=tuple(self.attachments),
            finished=True,
            end=end,
            statistics=statistics,
            by_summary=True,
            doubtful=statistics is not None and not _agree(statistics, self.chunks),
        )

    def is_sufficient(self, limits: Limits) -> bool:
        """Whether the summary is enough to find every message, channel, metadata record and attachment."""
        statistics = self.statistics
        room = chunk_table.unpacked_bytes(self.chunks, limits.chunk_bytes)
        if (
            statistics is None
            or statistics.chunk_count != len(self.chunks)
            or statistics.message_count * MESSAGE_HEAD_BYTES > room
        ):
            return False
        return (
            chunk_table.channels(self.chunks) <= set(self.channels) and self.knows_channels() and self.knows_entries()
        )

    def knows_channels(self) -> bool:
        """Whether all channels that have messages are known, with their schemas."""
        counts = {} if self.statistics is None else self.statistics.channel_message_counts
        if self.statistics is None or self.statistics.message_count != sum(counts.values()):
            return False
        schemas = {channel.schema_id for channel in self.channels.values()}
        return set(counts) <= set(self.channels) and schemas <= {0, *self.schemas}

    def knows_entries(self) -> bool:
        """Whether all metadata records and attachments are known."""
        statistics = self.statistics
        if statistics is None:
            return False
        return (statistics.metadata_count, statistics.attachment_count) == (len(self.metadata), len(self.attachments))


def positive(counts: Mapping[int, int]) -> dict[int, int]:
    """Return the counts that are not 0: a channel without messages may be counted or left out."""
    return {channel_id: count for channel_id, count in counts.items() if count}


def _agree(statistics: Statistics, chunks: Sequence[Chunk]) -> bool:
    """Whether statistics and chunk indexes agree on the numbers of messages and on their times."""
    counted = chunk_table.counts(chunks)
    if counted is not None and counted != positive(statistics.channel_message_counts):
        return False
    spans = chunk_table.spans(chunks)
    return not spans or not statistics.message_count or (statistics.start_ns, statistics.end_ns) in spans


def _in_order(entries: list[Entry]) -> list[Entry]:
    return sorted(entries, key=lambda entry: entry.offset)
