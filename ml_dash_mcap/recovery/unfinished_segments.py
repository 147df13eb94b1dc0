"""The segments that a dead recorder left unfinished: what in them is whole, and their end."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path

import numpy as np

from ..errors import DamagedFileError
from ..file_names import ABOUT_RECORD, ACTIVE_SUFFIX, BLOCK_OPCODE, SEGMENT_SUFFIX, STEPS_RECORD
from ..mcap import chunk_messages
from ..mcap.file_index import FileIndex
from ..mcap.file_reader import McapFile
from ..mcap.file_writer import WrittenContents
from ..mcap.message_records import MessageIndex, index_entries, pack_message_index
from ..mcap.record_layout import PREFIX_BYTES, Fields, read_prefix
from ..mcap.records import BLOCK_END, CHANNEL, MAGIC, SCHEMA, Chunk, Opcode, Schema
from ..mcap.segment import Segment
from ..query.stored_topic import LAST_NS


def unfinished(folder: Path, session: str, stamp: str) -> Iterable[Path]:
    """Yield the session's segments in progress; one that the crash left without a header is deleted.

    Args:
        folder: The run's folder.
        session: Whose segments.
        stamp: How their names begin.
    """
    for path in sorted(folder.glob(f"*{SEGMENT_SUFFIX}{ACTIVE_SUFFIX}")):
        run = _run_of(path)
        if run == session:
            yield path
        elif run is None and stamp and path.name.startswith(f"{stamp}_"):
            path.unlink()


def _run_of(path: Path) -> str | None:
    """Return which session wrote a segment; None where it does not say."""
    try:
        file = McapFile(path)
    except DamagedFileError:
        return None
    try:
        about = next((record.values for record in file.metadata() if record.name == ABOUT_RECORD), None)
        return None if about is None else about.get("run")
    finally:
        file.close()


def finish(path: Path, journaled: Collection[int]) -> Path:
    """Give an unfinished segment its end, and its name if that is all it lacks.

    Args:
        path: The segment.
        journaled: Numbers of the blocks that can be written again: what a crash left of the chunks of one is cut off.
    """
    file = McapFile(path)
    try:
        index = file.index
        torn = _torn_schemas(file)
        if index.finished and not torn:
            finished = path.with_name(path.name.removesuffix(ACTIVE_SUFFIX))
            path.rename(finished)
            return finished
        blocks, kept = _whole_blocks(file)
        chunks = index.chunks if blocks not in journaled else index.chunks[:kept]
        contents = _contents(index, chunks)
        for number in torn:
            contents.schemas[number] = _bare(contents.schemas[number])
        last = chunks[-1] if chunks else None
        rebuilt: dict[int, bytes] = {}
        size = index.end if len(chunks) == len(index.chunks) else index.chunks[kept].offset
        if last is not None and not last.indexed:
            scan = chunk_messages.scan(file.unpack(last), last, file.source.name)
            rebuilt = {number: _message_index(found) for number, found in scan.indexes.items()}
            contents.count(scan.counts)
            size = last.end
        contents.metadata = [entry for entry in contents.metadata if entry.offset < size]
    finally:
        file.close()
    segment = Segment.reopen(path, size, contents, torn)
    if rebuilt:
        segment.add_message_indexes(rebuilt)
    return segment.finish()


def _whole_blocks(file: McapFile) -> tuple[int, int]:
    """Return how many blocks a session has up to the last whole one in a file, and how many of its chunks those are."""
    chunks = file.index.chunks
    for number in range(len(chunks), 0, -1):
        chunk = chunks[number - 1]
        at = chunk.indexes_end
        opcode, length = read_prefix(file.source.read(at, PREFIX_BYTES).ljust(PREFIX_BYTES, b"\0"), 0)
        if chunk.indexed and (opcode, length) == (BLOCK_OPCODE, 8):
            content = file.source.read(at + PREFIX_BYTES, length)
            if len(content) == length:
                return BLOCK_END.read(Fields(content, file.source.name)).number + 1, number
    about = next((record.values for record in file.metadata() if record.name == ABOUT_RECORD), {})
    return int(about.get("first_block", 0)), 0


def torn_chunk_bytes(path: Path) -> int:
    """Return how many bytes there are of a chunk that the end of a file cuts; 0 if none is cut."""
    file = McapFile(path)
    try:
        end, size = file.index.end, file.source.size()
        is_cut = not file.index.finished and end < size
        return size - end if is_cut and file.source.read(end, 1) == bytes([Opcode.CHUNK]) else 0
    finally:
        file.close()


def _torn_schemas(file: McapFile) -> dict[int, int]:
    """Return where those schemas lie, by id, that a crash cut while they were rewritten in place."""
    torn = {number for number, schema in file.index.schemas.items() if not _is_json(schema)}
    found: dict[int, int] = {}
    at = len(MAGIC)
    while torn - set(found) and at < file.index.end:
        opcode, length = read_prefix(file.source.read(at, PREFIX_BYTES), 0)
        if opcode == Opcode.SCHEMA:
            number = int.from_bytes(file.source.read(at + PREFIX_BYTES, 2), "little")
            if number in torn:
                found[number] = at
        at += PREFIX_BYTES + length
    return found


def _is_json(schema: Schema) -> bool:
    try:
        return schema.encoding != "jsonschema" or isinstance(json.loads(schema.data), dict)
    except ValueError:
        return False


def _bare(record: bytes) -> bytes:
    """Return a Schema record of the same length whose text says only that messages are objects."""
    schema = SCHEMA.read(Fields(record, "", 0, PREFIX_BYTES))
    return record[: len(record) - len(schema.data)] + b'{"type":"object"}'.ljust(len(schema.data))


def _contents(index: FileIndex, chunks: Iterable[Chunk]) -> WrittenContents:
    """Say what an unfinished file holds in the terms of its summary; its last chunk may lack its message index."""
    contents = WrittenContents(
        {schema.id: SCHEMA.pack(schema) for schema in index.schemas.values()},
        {channel.id: CHANNEL.pack(channel) for channel in index.channels.values()},
        list(chunks),
        list(index.metadata),
    )
    for chunk in contents.chunks:
        if chunk.indexed:
            contents.count(chunk.counts or {})
    return contents


def _message_index(index: MessageIndex) -> bytes:
    order = np.argsort(index.times_ns, kind="stable")
    return pack_message_index(index.channel_id, index_entries(index.times_ns[order], index.offsets[order]))


def written_so_far(folder: Path, session: str) -> tuple[int, dict[str, int]]:
    """Return how many blocks with rows a session has in finished segments, and how many rows each topic has there.

    The session's segments are its newest ones, so that older runs in the folder are not opened.
    """
    blocks, rows = 0, dict[str, int]()
    for path in sorted(folder.glob(f"*{SEGMENT_SUFFIX}"), reverse=True):
        try:
            file = McapFile(path)
        except DamagedFileError:
            continue
        try:
            about = next((record.values for record in file.metadata() if record.name == ABOUT_RECORD), {})
            if about.get("run") != session:
                if blocks:
                    break
                continue
            blocks = max(blocks, _whole_blocks(file)[0])
            for number, count in file.index.message_counts.items():
                topic = file.index.channels[number].topic
                rows[topic] = rows.get(topic, 0) + count
        finally:
            file.close()
    return blocks, rows


def last_times(folder: Path, session: str, rows: Mapping[str, int]) -> dict[str, int]:
    """Return the time of the last row that was appended to each topic and is in finished segments, in ns.

    Args:
        folder: The run's folder.
        session: Whose segments, its newest ones.
        rows: How many rows each topic has in them.
    """
    found: dict[str, int] = {}
    wanted = {topic for topic, count in rows.items() if count}
    for path in sorted(folder.glob(f"*{SEGMENT_SUFFIX}"), reverse=True):
        if wanted <= found.keys():
            break
        try:
            file = McapFile(path)
        except DamagedFileError:
            continue
        try:
            if _run_named(file) == session:
                found = {**_last_times_of(file, wanted - found.keys(), rows), **found}
        except DamagedFileError:  # a step back between the two blocks is not counted, and nothing else is lost
            continue
        finally:
            file.close()
    return found


def _run_named(file: McapFile) -> str | None:
    return next((record.values.get("run") for record in file.metadata() if record.name == ABOUT_RECORD), None)


def _last_times_of(file: McapFile, wanted: Collection[str], rows: Mapping[str, int]) -> dict[str, int]:
    """Return the same of one file, for some topics; unpacks the last chunk of each.

    Where rows merged, the last row in the file may not be the last one that was appended. Then the block has a record
    that tells, which counts as long as no row of the topic came after that block.
    """
    found: dict[str, int] = {}
    for record in file.metadata():
        if record.name == STEPS_RECORD:
            for topic, counts in json.loads(record.values["topics"]).items():
                if counts["rows"] == rows.get(topic):
                    found[topic] = int(counts["last_ns"])
    numbers = {number: channel.topic for number, channel in file.index.channels.items()}
    for chunk in reversed(file.index.chunks):  # finished files have an index for each
        missing = {number for number, topic in numbers.items() if topic in wanted and topic not in found}
        if not missing:
            break
        for messages in file.cut(chunk, sorted(missing & chunk.message_index_offsets.keys()), 0, LAST_NS):
            if len(messages.offsets):
                found[numbers[messages.channel_id]] = int(messages.times_ns[messages.offsets.argmax()])
    return found
