"""What a summary says, held against what is true of its file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ..errors import DamagedFileError
from ..store.file_source import Source
from . import records, summary
from .file_index import FileIndex
from .limits import Limits
from .records import AttachmentEntry, Chunk, MetadataEntry, Statistics

Wrong = tuple[int, str]
"""Where in the file, and what, in words."""

_OF_CHUNK = ("length", "start_ns", "end_ns", "compression", "compressed_size", "uncompressed_size")


def wrong(source: Source, limits: Limits, walked: FileIndex, true: FileIndex, *, is_read: bool) -> Iterator[Wrong]:
    """Yield everything that a file's summary says and that is not so. What it leaves out altogether is not wrong.

    Args:
        source: The file.
        limits: For what is read.
        walked: What its records say of its chunks.
        true: What is true.
        is_read: Whether all chunks could be read.
    """
    found = summary.footer(source, true.size)
    if found is None or not found.summary_start:
        return
    start = found.summary_start
    try:
        said = summary.contents(source, true.size, found, limits)
    except DamagedFileError as error:
        yield error.offset, f"the summary cannot be used: {error.what}"
        return
    yield from ((start, what) for what in _of_statistics(said.statistics, true if is_read else None))
    yield from _of_chunks(said.chunks, walked.chunks, {chunk.offset: chunk for chunk in true.chunks})
    yield from _of_entries("attachment", said.attachments, walked.attachments, start)
    yield from _of_entries("metadata", said.metadata, walked.metadata, start)
    if is_read:
        yield from ((start, what) for what in _of_records("schema", said.schemas, true.schemas))
        yield from ((start, what) for what in _of_records("channel", said.channels, true.channels))
    yield from ((start, what) for what in _of_groups(said, found.summary_offset_start))


def _of_statistics(said: Statistics | None, true: FileIndex | None) -> Iterator[str]:
    known = None if true is None else true.statistics
    if said is None or known is None:
        return
    for name in (field for field in Statistics.__slots__ if field != "channel_message_counts"):
        if getattr(said, name) != getattr(known, name):
            yield f"the statistics say {name} {getattr(said, name)}, but it is {getattr(known, name)}"
    counts, true_counts = said.channel_message_counts, known.channel_message_counts
    for channel_id in sorted(counts.keys() | true_counts.keys()) if counts else ():
        count, true_count = counts.get(channel_id, 0), true_counts.get(channel_id, 0)
        if count != true_count:
            yield f"the statistics say {count} messages of channel {channel_id}, but there are {true_count}"


def _of_chunks(said: Sequence[Chunk], walked: Sequence[Chunk], true: Mapping[int, Chunk]) -> Iterator[Wrong]:
    if not said:
        return
    by_offset = {chunk.offset: chunk for chunk in walked if chunk.compression != records.LOOSE}
    count = Counter(chunk.offset for chunk in said)
    yield from ((offset, f"the chunk here has {number} indexes") for offset, number in count.items() if number > 1)
    for chunk in said:
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
    for offset in sorted(by_offset.keys() - {chunk.offset for chunk in said}):
        yield offset, "the chunk here has no chunk index"


def _of_entries(
    kind: str,
    said: Sequence[AttachmentEntry] | Sequence[MetadataEntry],
    walked: Sequence[AttachmentEntry] | Sequence[MetadataEntry],
    start: int,
) -> Iterator[Wrong]:
    if not said:
        return
    by_offset: Mapping[int, Any] = {entry.offset: entry for entry in walked}
    count = Counter(entry.offset for entry in said)
    yield from ((offset, f"the {kind} here has {number} indexes") for offset, number in count.items() if number > 1)
    for entry in said:
        there = by_offset.get(entry.offset)
        if there is None:
            yield start, f"the {kind} index of {entry.name!r} points to byte {entry.offset}, where none starts"
        elif entry != there:
            yield entry.offset, f"the {kind} index says {entry}, but it is {there}"
    for offset in sorted(by_offset.keys() - {entry.offset for entry in said}):
        yield offset, f"the {kind} {by_offset[offset].name!r} has no index"


def _of_records(kind: str, said: Mapping[int, Any], true: Mapping[int, Any]) -> Iterator[str]:
    for number, record in said.items():
        if number not in true:
            yield f"the summary has {kind} {number}, which the data do not have"
        elif record != true[number]:
            yield f"the summary has another {kind} {number} than the data"
    if said:
        yield from (f"the summary does not repeat {kind} {number}" for number in sorted(true.keys() - said.keys()))


def _of_groups(said: summary.Contents, offsets_start: int) -> Iterator[str]:
    if not offsets_start:
        return
    groups = {(one.opcode, one.start, one.length) for one in said.offsets if one.length}
    for opcode, start, length in sorted(groups - set(said.groups)):
        yield f"a summary offset says that {length} bytes of records of kind {opcode} lie at byte {start}"
