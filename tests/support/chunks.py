"""A chunk opened, and held against its own messages and message indexes."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from tests.support.records import (
    Channel,
    Chunk,
    MalformedError,
    Message,
    MessageIndex,
    Record,
    Schema,
    Unreadable,
    walk,
)

LARGEST_CHUNK_BYTES = 4_000_000
"""Uncompressed; a chunk that holds one message only may be larger."""

LARGEST_OPENED_BYTES = 1 << 30
"""A chunk that claims more is not opened, so that a bad length cannot take the machine's memory."""


@dataclass(frozen=True, slots=True)
class OpenChunk:
    """A chunk with what is in it and the message indexes directly after it."""

    chunk: Chunk
    raw: bytes
    """The uncompressed records."""
    records: list[Record]
    indexes: list[MessageIndex]
    faults: list[str]
    """Why the chunk could not be opened or read to its end."""

    @property
    def messages(self) -> list[Message]:
        return [record for record in self.records if isinstance(record, Message)]


def open_chunk(chunk: Chunk, indexes: list[MessageIndex]) -> OpenChunk:
    """Decompress a chunk and walk its records."""
    records: list[Record] = []
    try:
        raw = _decompressed(chunk)
    except (MalformedError, zstandard.ZstdError, RuntimeError) as error:
        return OpenChunk(chunk, b"", records, indexes, [f"{chunk.where} cannot be decompressed: {error}."])
    try:
        records.extend(walk(raw, chunk=chunk.offset))
    except MalformedError as error:
        return OpenChunk(chunk, raw, records, indexes, [f"{chunk.where} cannot be read to its end: {error}."])
    return OpenChunk(chunk, raw, records, indexes, [])


def _decompressed(chunk: Chunk) -> bytes:
    if chunk.uncompressed_size > LARGEST_OPENED_BYTES:
        raise MalformedError(f"it claims {chunk.uncompressed_size} uncompressed bytes")
    if chunk.compression == "":
        return chunk.data
    if chunk.compression == "zstd":
        if zstandard.get_frame_parameters(chunk.data).content_size not in (
            chunk.uncompressed_size,
            zstandard.CONTENTSIZE_UNKNOWN,
        ):
            raise MalformedError("its zstd frame and its uncompressed_size disagree")
        decompressor = zstandard.ZstdDecompressor()
        return decompressor.decompress(chunk.data, max_output_size=chunk.uncompressed_size, allow_extra_data=False)
    if chunk.compression == "lz4":
        raw, used = lz4.frame.decompress(chunk.data, return_bytes_read=True)
        if used != len(chunk.data):
            raise MalformedError(f"{len(chunk.data) - used} bytes follow its lz4 frame")
        return bytes(raw)
    raise MalformedError(f"{chunk.compression!r} is not a compression that viewers know")


def problems(opened: OpenChunk) -> Iterator[str]:
    """Every violation that shows in a chunk alone."""
    yield from opened.faults
    if opened.faults:
        return
    yield from _size_problems(opened)
    yield from _crc_problems(opened)
    yield from _record_problems(opened)
    yield from _time_problems(opened)
    yield from _index_problems(opened)


def _size_problems(opened: OpenChunk) -> Iterator[str]:
    chunk, size = opened.chunk, len(opened.raw)
    if size != chunk.uncompressed_size:
        yield f"{chunk.where} has uncompressed_size {chunk.uncompressed_size}, but holds {size} bytes."
    if not opened.messages:
        yield f"{chunk.where} is empty: it holds no message."
    if size > LARGEST_CHUNK_BYTES and len(opened.messages) > 1:
        yield f"{chunk.where} holds {size} bytes and {len(opened.messages)} messages; above {LARGEST_CHUNK_BYTES} is for a single message."


def _crc_problems(opened: OpenChunk) -> Iterator[str]:
    stored, actual = opened.chunk.uncompressed_crc, zlib.crc32(opened.raw)
    if stored == 0 and actual != 0:
        yield f"{opened.chunk.where} has no CRC."
    elif stored != actual:
        yield f"{opened.chunk.where} has the CRC {stored:#010x}, but its records have {actual:#010x}."


def _record_problems(opened: OpenChunk) -> Iterator[str]:
    for record in opened.records:
        if isinstance(record, Unreadable):
            yield f"{record.where} {record.reason}."
        elif not isinstance(record, Schema | Channel | Message):
            yield f"{record.where} (opcode {record.opcode:#04x}) is not allowed in a chunk."


def _time_problems(opened: OpenChunk) -> Iterator[str]:
    chunk, times = opened.chunk, [message.log_time for message in opened.messages]
    first, last = min(times, default=0), max(times, default=0)
    if chunk.message_start_time != first:
        yield f"{chunk.where} has message_start_time {chunk.message_start_time}, but its first log time is {first}."
    if chunk.message_end_time != last:
        yield f"{chunk.where} has message_end_time {chunk.message_end_time}, but its last log time is {last}."


def _index_problems(opened: OpenChunk) -> Iterator[str]:
    times: dict[int, dict[int, int]] = {}
    for message in opened.messages:
        times.setdefault(message.channel_id, {})[message.offset] = message.log_time
    seen: set[int] = set()
    for index in opened.indexes:
        if index.channel_id in seen:
            yield f"{index.where} is a second message index of channel {index.channel_id} for the chunk at byte {opened.chunk.offset}."
        seen.add(index.channel_id)
        yield from _entry_problems(index, times.get(index.channel_id, {}), opened.chunk)
    for channel_id in times.keys() - seen:
        yield f"{opened.chunk.where} has no message index for channel {channel_id}."


def _entry_problems(index: MessageIndex, times: dict[int, int], chunk: Chunk) -> Iterator[str]:
    """Hold one message index against the log time (ns) by offset of its channel's messages."""
    if not times:
        yield f"{index.where} is for channel {index.channel_id}, which has no message in the chunk at byte {chunk.offset}."
        return
    pointed: set[int] = set()
    for time_ns, offset in index.entries:
        if offset not in times:
            yield f"{index.where} points to byte {offset} of the chunk, where no message of channel {index.channel_id} starts."
        elif offset in pointed:
            yield f"{index.where} points twice to the message at byte {offset} of the chunk."
        elif times[offset] != time_ns:
            yield f"{index.where} gives {time_ns} for the message at byte {offset} of the chunk, whose log time is {times[offset]}."
        pointed.add(offset)
    for offset in sorted(times.keys() - pointed):
        yield f"{index.where} leaves out the message at byte {offset} of the chunk."
