"""What is true of a file, whatever its indexes and statistics say: its own records, read one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from ..errors import DamagedFileError
from ..mcap import load_index, records, summary_check
from ..mcap.chunk_reader import Contents
from ..mcap.file_index import FileIndex
from ..mcap.limits import Limits
from ..mcap.message_records import ENTRY_BYTES, MESSAGE_INDEX_HEAD
from ..mcap.record_layout import PREFIX_BYTES
from ..mcap.records import Chunk, Opcode, Statistics
from ..store import read_ahead
from ..store.file_source import Source

if TYPE_CHECKING:
    from .file import File

T = TypeVar("T")

_HEAD_BYTES = PREFIX_BYTES + MESSAGE_INDEX_HEAD.size
"""A message index up to its entries."""


def of(chunk: Chunk, contents: Contents) -> Chunk:
    """Return what is true of a chunk; without message indexes if those behind it are wrong."""
    start_ns, end_ns = contents.span or (chunk.start_ns, chunk.end_ns)
    return replace(
        chunk, start_ns=start_ns, end_ns=end_ns, counts=contents.counts, indexed=chunk.indexed and contents.is_indexed
    )


def differences(chunk: Chunk, contents: Contents) -> Iterator[tuple[str, str]]:
    """Yield what was said wrongly of a chunk, in words, each with a key that tells it from the others."""
    span = contents.span
    if span is not None and span != (chunk.start_ns, chunk.end_ns):
        yield (
            "times",
            f"the chunk is said to have log times from {chunk.start_ns} to {chunk.end_ns} ns,"
            f" but they go from {span[0]} to {span[1]} ns",
        )
    missing = sorted(contents.counts.keys() - chunk.message_index_offsets.keys())
    if chunk.message_index_offsets and missing:
        yield "message index", f"the chunk has no message index of channels {missing}, of which it has messages"
    elif chunk.message_index_offsets and not (chunk.indexed and contents.is_indexed):
        yield "message index", "the message indexes behind the chunk do not say where all its messages lie, and when"


def are_times_right(source: Source, chunk: Chunk, limits: Limits) -> bool:
    """Whether the message indexes behind a chunk lie in the time that is said of it."""
    length = chunk.message_index_length
    if length > limits.record_bytes:
        return True
    data = source.read(chunk.end, length)
    for offset in chunk.message_index_offsets.values():
        at = offset - chunk.end
        if at + _HEAD_BYTES > len(data) or data[at] != Opcode.MESSAGE_INDEX:
            return False
        size = int.from_bytes(data[at + _HEAD_BYTES - 4 : at + _HEAD_BYTES], "little")
        count = min(size, len(data) - at - _HEAD_BYTES) // ENTRY_BYTES
        times = np.frombuffer(data, np.uint64, 2 * count, at + _HEAD_BYTES)[::2]
        if count and not (chunk.start_ns <= times.min() and times.max() <= chunk.end_ns):
            return False
    return True


def audit(file: File, collect: Callable[[Chunk, Contents], T]) -> list[T | DamagedFileError]:
    """Read all of a file, note in it what its indexes and statistics say wrongly, and make its index true.

    Args:
        file: Gets the notes, and the losses of damage that is met.
        collect: Called with each chunk and what it holds, on several threads.

    Returns:
        What `collect` did for each chunk, in the order of the file; in the place of a damaged one what is wrong with
        it, unless it is among the losses of a file that is to be salvaged.
    """
    before = file.index
    walked = load_index.by_walking(file.source, file.limits, before) if before.finished else before
    is_whole = not any(not loss.corrected for loss in walked.losses)
    base = walked if is_whole else before

    def do(chunk: Chunk) -> tuple[Chunk, Contents | None, T | DamagedFileError | None]:
        try:
            contents = file.contents(chunk)
            return file.correct(chunk, contents), _without_messages(contents), collect(chunk, contents)
        except DamagedFileError as error:
            return chunk, None, _lost(file, chunk, error)

    opened = list(read_ahead.in_order(do, list(base.chunks), weigh=lambda chunk: chunk.uncompressed_size))
    if before.finished:
        for loss in walked.losses:
            file.add(loss)
        if is_whole:
            true = _index(base, [(chunk, contents) for chunk, contents, _ in opened])
            is_read = all(contents is not None and not file.is_partial(chunk) for chunk, contents, _ in opened)
            for offset, what in summary_check.wrong(file.source, file.limits, walked, true, is_read=is_read):
                file.note(offset, what)
            file.adopt(replace(true, losses=before.losses))
    return [found for _, contents, found in opened if contents is not None or found is not None]  # type: ignore[misc]


def _lost(file: File, chunk: Chunk, error: DamagedFileError) -> DamagedFileError | None:
    try:
        file.lose_chunk(chunk, error)
    except DamagedFileError as again:
        return again
    return None


def _without_messages(contents: Contents) -> Contents:
    """Return what a chunk holds besides its messages, which would keep all its bytes in memory."""
    return replace(contents, messages={})


def _index(base: FileIndex, opened: list[tuple[Chunk, Contents | None]]) -> FileIndex:
    """Return a walk's index with what the chunks were found to hold."""
    schemas, channels = dict(base.schemas), dict(base.channels)
    counts: dict[int, int] = {}
    for chunk, contents in opened:
        if contents is not None:
            schemas = {**contents.schemas, **schemas}
            channels = {**contents.channels, **channels}
        for channel_id, count in (chunk.counts or {}).items():
            counts[channel_id] = counts.get(channel_id, 0) + count
    counts = {channel_id: count for channel_id, count in counts.items() if channel_id in channels}
    chunks = [chunk for chunk, _ in opened]
    full = [chunk for chunk in chunks if chunk.counts]
    statistics = Statistics(
        message_count=sum(counts.values()),
        schema_count=len(schemas.keys() - {0}),
        channel_count=len(channels),
        chunk_count=sum(chunk.compression != records.LOOSE for chunk in chunks),
        attachment_count=len(base.attachments),
        metadata_count=len(base.metadata),
        start_ns=min((chunk.start_ns for chunk in full), default=0),
        end_ns=max((chunk.end_ns for chunk in full), default=0),
        channel_message_counts=counts,
    )
    return replace(
        base, schemas=schemas, channels=channels, chunks=chunks, message_counts=counts, statistics=statistics, losses=()
    )
