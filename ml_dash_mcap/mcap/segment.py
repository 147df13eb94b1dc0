"""One MCAP file being written: opened, grown by chunks, given its summary, and renamed when it is whole."""

from __future__ import annotations

import contextlib
import os
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, ChunkIndex, MetadataIndex, Statistics, SummaryOffset

from ..file_names import ABOUT_RECORD, ACTIVE_SUFFIX
from . import record_bytes
from .chunk_writer import Chunk


@dataclass(slots=True)
class Contents:
    """What a segment holds: all that its summary says. Offsets and lengths are in bytes, times in ns."""

    schemas: dict[int, bytes] = field(default_factory=dict)
    """Schema records by id, as they stand in the data section."""
    channels: dict[int, bytes] = field(default_factory=dict)
    """Channel records by id."""
    chunks: list[ChunkIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    """Messages by channel id."""

    def add_chunk(self, chunk: Chunk, at: int) -> int:
        """Take in a chunk that starts at a place in the file; returns where its message indexes end."""
        offsets, position = {}, at + chunk.length
        for channel, index in chunk.indexes.items():
            offsets[channel] = position
            position += len(index)
        self.chunks.append(
            ChunkIndex(
                chunk_length=chunk.length,
                chunk_start_offset=at,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                message_end_time=chunk.end_ns,
                message_index_length=position - at - chunk.length,
                message_index_offsets=offsets,
                message_start_time=chunk.start_ns,
                uncompressed_size=chunk.uncompressed_size,
            )
        )
        for channel, count in chunk.counts.items():
            self.counts[channel] = self.counts.get(channel, 0) + count
        return position

    def add_metadata(self, name: str, at: int, length: int) -> None:
        """Take in a Metadata record that starts at a place in the file."""
        self.metadata.append(MetadataIndex(offset=at, length=length, name=name))

    def summary(self, start: int) -> bytes:
        """Return everything from the summary section to the last byte of the file.

        Args:
            start: Where in the file the summary section begins.
        """
        groups: list[tuple[int, bytes]] = [
            (Opcode.SCHEMA, b"".join(self.schemas.values())),
            (Opcode.CHANNEL, b"".join(self.channels.values())),
            (Opcode.STATISTICS, record_bytes.to_bytes(self._statistics())),
            (Opcode.CHUNK_INDEX, record_bytes.to_bytes(*self.chunks)),
            (Opcode.ATTACHMENT_INDEX, record_bytes.to_bytes(*self.attachments)),
            (Opcode.METADATA_INDEX, record_bytes.to_bytes(*self.metadata)),
        ]
        summary, offsets = b"", b""
        for opcode, group in groups:
            if group:
                at = start + len(summary)
                offsets += record_bytes.to_bytes(
                    SummaryOffset(group_opcode=opcode, group_start=at, group_length=len(group))
                )
                summary += group
        foot = record_bytes.footer(start, start + len(summary), 0)
        crc = zlib.crc32(summary + offsets + foot[:-4])
        return summary + offsets + record_bytes.footer(start, start + len(summary), crc) + record_bytes.MAGIC

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self.attachments),
            channel_count=len(self.channels),
            channel_message_counts={channel: count for channel, count in self.counts.items() if count},
            chunk_count=len(self.chunks),
            message_count=sum(self.counts.values()),
            message_end_time=max((chunk.message_end_time for chunk in self.chunks), default=0),
            message_start_time=min((chunk.message_start_time for chunk in self.chunks), default=0),
            metadata_count=len(self.metadata),
            schema_count=len(self.schemas),
        )


class Segment:
    """A file in progress. Used by one thread at a time.

    Whatever fails leaves the file as it was before the call: what had reached it of the failed write is cut off.
    """

    def __init__(self, path: Path, library: str, about: Mapping[str, str]) -> None:
        """Create the file.

        Args:
            path: The finished file's name; until then it has `ACTIVE_SUFFIX`.
            library: What the MCAP header names as the writer.
            about: The `ml_dash` metadata record.

        Raises:
            FileExistsError: The name is taken.
        """
        self.path = path
        self.active_path = path.with_name(path.name + ACTIVE_SUFFIX)
        if path.exists():
            raise FileExistsError(path)
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
        self._descriptor = os.open(self.active_path, flags, 0o644)
        self.size = 0
        self.contents = Contents()
        self._schema_at: dict[int, int] = {}
        self._stale_schemas: set[int] = set()
        try:
            if path.exists():
                raise FileExistsError(path)
            self._write(record_bytes.header(library))
            self.add_metadata(ABOUT_RECORD, record_bytes.metadata(ABOUT_RECORD, about))
        except BaseException:
            self.discard()
            raise

    @classmethod
    def reopen(cls, active_path: Path, size: int, contents: Contents, torn_schemas: Mapping[int, int]) -> Segment:
        """Take over a file that its recorder left unfinished.

        Args:
            active_path: The file, with its `ACTIVE_SUFFIX`.
            size: How much of it is sound, in bytes; the rest is cut off.
            contents: What that holds.
            torn_schemas: Where those Schema records lie that `contents` has other text for, by id.
        """
        segment = cls.__new__(cls)
        segment.path = active_path.with_name(active_path.name.removesuffix(ACTIVE_SUFFIX))
        segment.active_path = active_path
        segment._descriptor = os.open(active_path, os.O_RDWR | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0))
        segment.size = size
        segment.contents = contents
        segment._schema_at = dict(torn_schemas)
        segment._stale_schemas = set(torn_schemas)
        return segment

    def add_message_indexes(self, indexes: Mapping[int, bytes]) -> None:
        """Write the MessageIndex records of the last chunk, by channel id, where a crash cut them off."""
        chunk, position = self.contents.chunks[-1], self.size
        chunk.message_index_offsets = {}
        for channel, index in indexes.items():
            chunk.message_index_offsets[channel] = position
            position += len(index)
        chunk.message_index_length = position - self.size
        self._write(*indexes.values())

    def add_channel(self, number: int, schema: bytes, channel: bytes) -> None:
        """Write a topic's Schema and Channel records."""
        self._schema_at[number] = self.size
        self._write(schema, channel)
        self.contents.schemas[number] = schema
        self.contents.channels[number] = channel
        self.contents.counts.setdefault(number, 0)

    def rewrite_schema(self, number: int, schema: bytes) -> None:
        """Put a schema in the place of one of the same length."""
        if len(schema) != len(self.contents.schemas[number]):
            raise AssertionError("a schema is rewritten at its length")
        if schema != self.contents.schemas[number]:
            self.contents.schemas[number] = schema
            self._stale_schemas.add(number)
        self._write_stale_schemas()

    def _write_stale_schemas(self) -> None:
        """Put the schemas that have changed into their places, again where that failed before."""
        for number in list(self._stale_schemas):
            os.lseek(self._descriptor, self._schema_at[number], os.SEEK_SET)
            _write_all(self._descriptor, [memoryview(self.contents.schemas[number])])
            self._stale_schemas.discard(number)

    def schema_space(self, number: int) -> int:
        """Return the length of a topic's Schema record, 0 where it has none yet."""
        return len(self.contents.schemas.get(number, b""))

    def add_metadata(self, name: str, record: bytes) -> None:
        """Write a Metadata record."""
        at = self.size
        self._write(record)
        self.contents.add_metadata(name, at, len(record))

    def add_block(self, chunks: Sequence[Chunk], number: int, name: str = "", metadata: bytes = b"") -> None:
        """Write a block's chunks with their message indexes, and what says that these are all, in one call.

        Args:
            chunks: Of the block.
            number: Of the block.
            name: Of its metadata record.
            metadata: That record, which goes before the chunks; empty if the block has none.
        """
        at = self.size
        pieces = [piece for chunk in chunks for piece in (chunk.head, chunk.data, *chunk.indexes.values())]
        self._write(metadata, *pieces, record_bytes.block_end(number))
        if metadata:
            self.contents.metadata.append(MetadataIndex(offset=at, length=len(metadata), name=name))
            at += len(metadata)
        for chunk in chunks:
            at = self.contents.add_chunk(chunk, at)

    def sync(self) -> None:
        """Wait until what was written would survive a power cut."""
        getattr(os, "fdatasync", os.fsync)(self._descriptor)

    def finish(self, sync: bool = True) -> Path:
        """Write the end of the file and give it its name; returns that. May be tried again.

        Args:
            sync: Whether to wait until the whole would survive a power cut.
        """
        data_end = self.size
        os.ftruncate(self._descriptor, data_end)  # what is behind it could not be cut off when its write failed
        self._write_stale_schemas()
        try:
            self._write(record_bytes.data_end(), self.contents.summary(self.size + len(record_bytes.data_end())))
            if sync:
                self.sync()
            os.rename(self.active_path, self.path)
        except BaseException:
            self._cut(data_end)
            raise
        os.close(self._descriptor)
        if sync:
            sync_folder(self.path.parent)
        return self.path

    def discard(self) -> None:
        """Close and delete the file."""
        os.close(self._descriptor)
        self.active_path.unlink(missing_ok=True)

    def _write(self, *pieces: bytes | memoryview) -> None:
        """Write all or nothing."""
        os.lseek(self._descriptor, self.size, os.SEEK_SET)
        try:
            self.size += _write_all(self._descriptor, [memoryview(piece) for piece in pieces])
        except BaseException:
            self._cut(self.size)
            raise

    def _cut(self, size: int) -> None:
        """Go back to an earlier size, as far as the system lets us."""
        self.size = size
        with contextlib.suppress(OSError):
            os.ftruncate(self._descriptor, size)


def _write_all(descriptor: int, pieces: list[memoryview]) -> int:
    """Write pieces one after the other, however many calls the system wants for that."""
    total = 0
    write: Callable[[int, list[memoryview]], int] = getattr(os, "writev", lambda fd, parts: os.write(fd, parts[0]))
    while pieces:
        done = write(descriptor, pieces[:512])
        total += done
        while pieces and done >= len(pieces[0]):
            done -= len(pieces.pop(0))
        if done:
            pieces[0] = pieces[0][done:]
    return total


def sync_folder(folder: Path) -> None:
    """Make a rename in a folder survive a power cut, where the system can."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
