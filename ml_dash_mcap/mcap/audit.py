"""Compares a file's indexes and statistics with its records, and notes what they say wrongly."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from ..errors import DamagedFileError
from ..store import read_ahead
from ..store.byte_source import ByteSource
from . import load_index, records, summary
from .chunk_messages import ChunkContents
from .file_index import FileIndex
from .file_reader import McapFile
from .limits import Limits
from .message_records import ENTRY_BYTES, MESSAGE_INDEX_HEAD
from .record_layout import PREFIX_BYTES
from .records import AttachmentEntry, Chunk, MetadataEntry, Opcode, Statistics

Fault = tuple[int, str]
"""The place in the file in bytes, and the fault in words."""

_OF_CHUNK = ("length", "start_ns", "end_ns", "compression", "compressed_size", "uncompressed_size")

T = TypeVar("T")

_FEW_CHUNKS = 256
"""The message indexes of so many are read in some milliseconds."""

_HEAD_BYTES = PREFIX_BYTES + MESSAGE_INDEX_HEAD.size
"""A message index up to its entries."""


def span(file: McapFile) -> tuple[int, int] | None:
    """Return the first and the last log time of a file's messages, in ns; None without any.

    As the statistics say it, until the index is asked for: then as far as that tells, without reading messages.
    """
    if file.is_loaded:
        survey_few(file)
    statistics = file.glance.statistics
    if statistics is not None and not file.is_corrected:
        return (statistics.start_ns, statistics.end_ns) if statistics.message_count else None
    full = [chunk for chunk in file.index.chunks if chunk.counts != {} and chunk.uncompressed_size]
    return (min(chunk.start_ns for chunk in full), max(chunk.end_ns for chunk in full)) if full else None


def settle(file: McapFile) -> None:
    """Correct a file's index if two parts of its summary disagree on the number or the times of the messages.

    That reads the whole file, once; every file whose summary agrees with itself is left alone.
    """
    if file.index.doubtful:
        audit(file, lambda chunk, contents: None)


def survey(file: McapFile) -> None:
    """Correct the times that a file's index states for its chunks, by their message indexes. Happens once a file.

    Reading everything in the order of time needs correct times. Files of our own recorder are not checked.
    """
    settle(file)
    if not file.begin_survey() or not file.index.by_summary or file.index.is_ours:
        return
    for chunk in list(file.index.chunks):
        if chunk.indexed and not _are_times_right(file.source, chunk, file.limits):
            file.correct_once(chunk)


def survey_few(file: McapFile) -> None:
    """Call `survey` if the file has so few chunks that it takes hardly any time; otherwise `settle`."""
    if len(file.index.chunks) <= _FEW_CHUNKS:
        survey(file)
    else:
        settle(file)


def _are_times_right(source: ByteSource, chunk: Chunk, limits: Limits) -> bool:
    """Whether the message indexes behind a chunk lie in the time that the file's index states for it."""
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
        # An entry is a time and an offset, so every second number is a time.
        times = np.frombuffer(data, np.uint64, 2 * count, at + _HEAD_BYTES)[::2]
        if count and not (chunk.start_ns <= times.min() and times.max() <= chunk.end_ns):
            return False
    return True


def audit(file: McapFile, collect: Callable[[Chunk, ChunkContents], T]) -> list[T | DamagedFileError]:
    """Read all of a file, note the faults of its indexes and statistics, and correct its index.

    Args:
        file: Gets the notes, and the losses of damage that is met.
        collect: Called with each chunk and its contents, on several threads.

    Returns:
        What `collect` did for each chunk, in the order of the file; in the place of a damaged one what is wrong with
        it, unless it is among the losses of a file that is to be salvaged.
    """
    before = file.index
    scanned = load_index.by_scanning(file.source, file.limits, before) if before.finished else before
    is_whole = not any(not loss.corrected for loss in scanned.losses)
    base = scanned if is_whole else before

    def do(chunk: Chunk) -> tuple[Chunk, ChunkContents | None, T | DamagedFileError | None]:
        try:
            contents = file.contents(chunk)
            return file.correct(chunk, contents), _without_messages(contents), collect(chunk, contents)
        except DamagedFileError as error:
            return chunk, None, _lost(file, chunk, error)

    opened = list(read_ahead.in_order(do, list(base.chunks), weigh=lambda chunk: chunk.uncompressed_size))
    if before.finished:
        for loss in scanned.losses:
            file.add(loss)
        if is_whole:
            true = _index(base, [(chunk, contents) for chunk, contents, _ in opened])
            is_read = all(contents is not None and not file.is_partial(chunk) for chunk, contents, _ in opened)
            for offset, what in _faults(file.source, file.limits, scanned, true, is_read=is_read):
                file.note(offset, what)
            file.adopt(replace(true, losses=before.losses))
    return [result for _, contents, result in opened if contents is not None or result is not None]  # type: ignore[misc]


def _lost(file: McapFile, chunk: Chunk, error: DamagedFileError) -> DamagedFileError | None:
    try:
        file.lose_chunk(chunk, error)
    except DamagedFileError as again:
        return again
    return None


def _without_messages(contents: ChunkContents) -> ChunkContents:
    """Return a chunk's contents without its messages, which would keep all its bytes in memory."""
    return replace(contents, messages={})


def _index(base: FileIndex, opened: list[tuple[Chunk, ChunkContents | None]]) -> FileIndex:
    """Return the index of a scan, with the contents of the chunks added."""
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


def _faults(
    source: ByteSource, limits: Limits, scanned: FileIndex, true: FileIndex, *, is_read: bool
) -> Iterator[Fault]:
    """Yield every false statement of a file's summary. Things that it leaves out altogether are not false.

    Args:
        source: The file.
        limits: Limits for reading.
        scanned: The index by its records.
        true: The corrected index.
        is_read: Whether all chunks could be read.
    """
    footer = summary.read_footer(source, true.size)
    if footer is None or not footer.summary_start:
        return
    start = footer.summary_start
    try:
        stated = summary.read_all(source, true.size, footer, limits)
    except DamagedFileError as error:
        yield error.offset, f"the summary cannot be used: {error.what}"
        return
    yield from ((start, what) for what in _of_statistics(stated.statistics, true if is_read else None))
    yield from _of_chunks(stated.chunks, scanned.chunks, {chunk.offset: chunk for chunk in true.chunks})
    yield from _of_entries("attachment", stated.attachments, scanned.attachments, start)
    yield from _of_entries("metadata", stated.metadata, scanned.metadata, start)
    if is_read:
        yield from ((start, what) for what in _of_records("schema", stated.schemas, true.schemas))
        yield from ((start, what) for what in _of_records("channel", stated.channels, true.channels))
    yield from ((start, what) for what in _of_groups(stated, footer.summary_offset_start))


def _of_statistics(stated: Statistics | None, true: FileIndex | None) -> Iterator[str]:
    actual = None if true is None else true.statistics
    if stated is None or actual is None:
        return
    for name in (field for field in Statistics.__slots__ if field != "channel_message_counts"):
        if getattr(stated, name) != getattr(actual, name):
            yield f"the statistics say {name} {getattr(stated, name)}, but it is {getattr(actual, name)}"
    counts, true_counts = stated.channel_message_counts, actual.channel_message_counts
    for channel_id in sorted(counts.keys() | true_counts.keys()) if counts else ():
        count, true_count = counts.get(channel_id, 0), true_counts.get(channel_id, 0)
        if count != true_count:
            yield f"the statistics say {count} messages of channel {channel_id}, but there are {true_count}"


def _of_chunks(stated: Sequence[Chunk], scanned: Sequence[Chunk], true: Mapping[int, Chunk]) -> Iterator[Fault]:
    if not stated:
        return
    by_offset = {chunk.offset: chunk for chunk in scanned if chunk.compression != records.LOOSE}
    count = Counter(chunk.offset for chunk in stated)
    yield from ((offset, f"the chunk here has {number} indexes") for offset, number in count.items() if number > 1)
    for chunk in stated:
        there = by_offset.get(chunk.offset)
        if there is None:
            yield chunk.offset, "a chunk index says that a chunk starts here, but none does"
            continue
        for name in _OF_CHUNK:
            value, true_value = getattr(chunk, name), getattr(there, name)
            if name in ("start_ns", "end_ns"):
                true_value = getattr(true[chunk.offset], name) if true[chunk.offset].counts else value
            if value != true_value:
                yield chunk.offset, f"the index of the chunk here says {name} {value!r}, but it is {true_value!r}"
        if chunk.message_index_offsets and (
            dict(chunk.message_index_offsets) != dict(there.message_index_offsets)
            or chunk.message_index_length != there.message_index_length
        ):
            yield chunk.offset, "the index of the chunk here says wrongly where its message indexes lie"
    for offset in sorted(by_offset.keys() - {chunk.offset for chunk in stated}):
        yield offset, "the chunk here has no chunk index"


def _of_entries(
    kind: str,
    stated: Sequence[AttachmentEntry] | Sequence[MetadataEntry],
    scanned: Sequence[AttachmentEntry] | Sequence[MetadataEntry],
    start: int,
) -> Iterator[Fault]:
    if not stated:
        return
    by_offset: Mapping[int, Any] = {entry.offset: entry for entry in scanned}
    count = Counter(entry.offset for entry in stated)
    yield from ((offset, f"the {kind} here has {number} indexes") for offset, number in count.items() if number > 1)
    for entry in stated:
        there = by_offset.get(entry.offset)
        if there is None:
            yield start, f"the {kind} index of {entry.name!r} points to byte {entry.offset}, where none starts"
        elif entry != there:
            yield entry.offset, f"the {kind} index says {entry}, but it is {there}"
    for offset in sorted(by_offset.keys() - {entry.offset for entry in stated}):
        yield offset, f"the {kind} {by_offset[offset].name!r} has no index"


def _of_records(kind: str, stated: Mapping[int, Any], true: Mapping[int, Any]) -> Iterator[str]:
    for number, record in stated.items():
        if number not in true:
            yield f"the summary has {kind} {number}, which the data do not have"
        elif record != true[number]:
            yield f"the summary has another {kind} {number} than the data"
    if stated:
        yield from (f"the summary does not repeat {kind} {number}" for number in sorted(true.keys() - stated.keys()))


def _of_groups(stated: summary.SummaryContents, offsets_start: int) -> Iterator[str]:
    if not offsets_start:
        return
    groups = {(offset.opcode, offset.start, offset.length) for offset in stated.offsets if offset.length}
    for opcode, start, length in sorted(groups - set(stated.groups)):
        yield f"a summary offset says that {length} bytes of records of kind {opcode} lie at byte {start}"
