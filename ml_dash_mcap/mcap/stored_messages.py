"""Yields a file's messages of all channels in the order in which they are stored, for copies that decode nothing."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import NamedTuple

import numpy as np

from ..store import read_ahead
from . import attachment_records, audit, chunk_table
from .chunk_messages import Messages
from .file_index import ReindexedError
from .file_reader import McapFile
from .message import Connection, MessageBlock
from .message_records import MESSAGE_HEAD_BYTES
from .records import LOOSE, AttachmentEntry, Chunk

_MOST_BYTES = 4 << 20
_MOST_MESSAGES = 16384
"""Blocks end at about so much: the messages outside of chunks may be a whole file."""

_PIECE = 1 << 20
"""Attachments are copied so many bytes at a time."""

LAST_NS = 2**64 - 1


class StoredChunk(NamedTuple):
    """A chunk as it lies in its file, and the messages in it."""

    chunk: Chunk
    record: bytes
    """The whole Chunk record; empty for messages that lie outside of chunks, or where some of them were left out."""
    messages: list[Messages]
    """Those of each channel, by their offsets in the chunk's records."""


def channels(file: McapFile) -> dict[int, Connection]:
    """Return a file's channels, by their ids."""
    connections = {}
    for number, channel in sorted(file.index.channels.items()):
        schema = file.index.schema_of(channel)
        name, encoding, data = ("", "", b"") if schema is None else (schema.name, schema.encoding, schema.data)
        metadata = tuple(channel.metadata.items())
        connections[number] = Connection(channel.topic, name, encoding, data, channel.message_encoding, metadata)
    return connections


def attachments(file: McapFile) -> Iterator[tuple[Iterator[bytes], AttachmentEntry]]:
    """Yield a file's Attachment records, each in pieces, with its index entry."""
    for entry in attachment_records.entries(file):
        end = entry.offset + entry.length
        pieces = (file.source.read(at, min(_PIECE, end - at)) for at in range(entry.offset, end, _PIECE))
        yield pieces, entry


def chunks(file: McapFile, wanted: Collection[int], start_ns: int = 0, end_ns: int = LAST_NS) -> Iterator[StoredChunk]:
    """Yield the chunks that hold messages of some channels and of a time range, in the order of the file.

    Their bytes are verified. Damage raises, or is noted and left out where the file is to be salvaged.

    Args:
        file: Where from.
        wanted: Ids of channels.
        start_ns: First log time, in ns.
        end_ns: Last log time, included, in ns.

    Raises:
        DamagedFileError: A chunk is damaged.
    """
    if start_ns <= 0 and end_ns >= LAST_NS:
        audit.survey(file)
    # What was yielded before the index was replaced must not come again.
    done: set[int] = set()
    while True:
        try:
            for stored in _chunks(file, wanted, start_ns, end_ns, done):
                done.add(stored.chunk.offset)
                if any(map(len, stored.messages)):
                    yield stored
        except ReindexedError:
            continue
        return


def _chunks(
    file: McapFile, wanted: Collection[int], start_ns: int, end_ns: int, done: Collection[int]
) -> Iterator[StoredChunk]:
    """Yield the chunks that `chunks` yields, by the index as it is now, without those whose offsets are in `done`."""
    held = [file.index.chunks[at] for at in chunk_table.holding(file.index.chunks, wanted, start_ns, end_ns).tolist()]
    in_file = sorted((chunk for chunk in held if chunk.offset not in done), key=lambda chunk: chunk.offset)

    def cut(chunk_and_span: tuple[Chunk, bytes]) -> StoredChunk:
        chunk, span = chunk_and_span
        present = [number for number in wanted if not chunk.indexed or number in chunk.message_index_offsets]
        messages = file.cut(chunk, present, start_ns, end_ns, memoryview(span))
        is_as_stored = chunk.compression != LOOSE and not file.is_partial(chunk)
        return StoredChunk(chunk, span[: chunk.length] if is_as_stored else b"", messages)

    def spans() -> Iterator[tuple[Chunk, bytes]]:
        groups = list(chunk_table.read_together(in_file))
        file.source.expect([(group[0].offset, group[-1].indexes_end) for group in groups])
        for group in groups:
            start = group[0].offset
            data = file.read_span(start, group[-1].indexes_end - start)
            for chunk in group:
                yield chunk, data[chunk.offset - start : chunk.indexes_end - start]

    return read_ahead.in_order(cut, spans(), weigh=lambda part: part[0].uncompressed_size)


def blocks(file: McapFile, wanted: Collection[int], start_ns: int = 0, end_ns: int = LAST_NS) -> Iterator[MessageBlock]:
    """Yield the messages of some channels and of a time range, in the order of the file.

    The arguments and errors are those of `chunks`.
    """
    for chunk in chunks(file, wanted, start_ns, end_ns):
        yield from in_pieces(block_of(chunk.messages))


def block_of(parts: list[Messages]) -> MessageBlock:
    """Return the messages of some channels of one chunk in the order in which they lie there."""
    numbers = np.repeat([part.channel_id for part in parts], [len(part) for part in parts]).astype(np.int64)
    offsets = np.concatenate([part.offsets for part in parts])
    order = np.argsort(offsets, kind="stable")
    data = memoryview(parts[0].data)
    starts = (offsets[order] + MESSAGE_HEAD_BYTES).tolist()
    ends = np.concatenate([part.ends for part in parts])[order].tolist()
    return MessageBlock(
        numbers[order],
        np.concatenate([part.times_ns for part in parts])[order],
        np.concatenate([part.published_ns for part in parts])[order],
        np.concatenate([part.sequences for part in parts])[order],
        [data[start:end] for start, end in zip(starts, ends, strict=True)],
    )


def in_pieces(block: MessageBlock) -> Iterator[MessageBlock]:
    """Cut a long block into some of a size that chunks may have."""
    if len(block) <= _MOST_MESSAGES and block.size <= _MOST_BYTES:
        if len(block):
            yield block
        return
    ends = np.cumsum([len(payload) for payload in block.payloads])
    first = 0
    while first < len(block):
        room = int(ends[first - 1]) if first else 0
        last = int(np.searchsorted(ends, room + _MOST_BYTES, "right"))
        last = min(max(last, first + 1), first + _MOST_MESSAGES)
        yield block.part(first, last)
        first = last


def joined(blocks: Iterator[MessageBlock], size: int) -> Iterator[MessageBlock]:
    """Join short blocks until they have about as many bytes as a chunk."""
    waiting: list[MessageBlock] = []
    held = 0
    for block in blocks:
        waiting.append(block)
        held += block.size
        if held >= size or sum(map(len, waiting)) >= _MOST_MESSAGES:
            yield MessageBlock.joined(waiting)
            waiting, held = [], 0
    if waiting:
        yield MessageBlock.joined(waiting)
