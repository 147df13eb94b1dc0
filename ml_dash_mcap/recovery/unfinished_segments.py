"""Finishes the segments that a dead recorder left without their end."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..codecs import codec_table, json_schema
from ..codecs.codec import Codec
from ..errors import DamagedFileError, EncodingError
from ..file_names import ACTIVE_SUFFIX, SEGMENT_SUFFIX, WIDER_SCHEMA_OPCODE
from ..mcap import chunk_messages
from ..mcap.file_index import FileIndex
from ..mcap.file_reader import McapFile
from ..mcap.file_writer import WrittenContents
from ..mcap.message_records import MessageIndex, index_entries, pack_message_index
from ..mcap.record_layout import PREFIX_BYTES, read_prefix
from ..mcap.records import CHANNEL, MAGIC, SCHEMA, Chunk, Opcode
from ..mcap.segment import Segment
from .session_progress import whole_blocks


def unfinished(folder: Path, session: str, stamp: str) -> Iterable[Path]:
    """Yield the session's segments in progress; delete a segment that the crash left without a header.

    Args:
        folder: The run's folder.
        session: The session whose segments they are.
        stamp: How their names begin.
    """
    for path in sorted(folder.glob(f"*{SEGMENT_SUFFIX}{ACTIVE_SUFFIX}")):
        run = _run_of(path)
        if run == session:
            yield path
        elif run is None and stamp and path.name.startswith(f"{stamp}_"):
            path.unlink()


def _run_of(path: Path) -> str | None:
    """Return which session wrote a segment; None where that is not recorded."""
    try:
        file = McapFile(path)
    except DamagedFileError:
        return None
    try:
        return file.about().get("run")
    finally:
        file.close()


def finish(path: Path, journaled: Collection[int]) -> Path:
    """Give an unfinished segment its end, and its name if that is all it lacks.

    Args:
        path: The segment.
        journaled: Numbers of the blocks that can be written again: the remains of their chunks are cut off.
    """
    file = McapFile(path)
    try:
        index = file.index
        texts = {**_mended_schemas(index), **_wider_schemas(file)}
        torn = _schema_offsets(file, texts)
        if index.finished and not torn:
            finished = path.with_name(path.name.removesuffix(ACTIVE_SUFFIX))
            path.rename(finished)
            return finished
        blocks, kept = whole_blocks(file)
        chunks = index.chunks if blocks not in journaled else index.chunks[:kept]
        contents = _contents(index, chunks)
        for number in torn:
            # A text of the same length, so that nothing behind it moves.
            contents.schemas[number] = SCHEMA.pack(replace(index.schemas[number], data=texts[number]))
        last = chunks[-1] if chunks else None
        rebuilt: dict[int, bytes] = {}
        size = index.end if len(chunks) == len(index.chunks) else index.chunks[kept].offset
        # The crash came between a chunk and its message indexes, which are made again from the chunk.
        if last is not None and not last.indexed:
            scan = chunk_messages.scan(file.unpack(last), last, file.source.name)
            rebuilt = {number: _message_index(entries) for number, entries in scan.indexes.items()}
            contents.count(scan.counts)
            size = last.end
        # The summary must not list a record behind the place where the file is cut.
        contents.metadata = [entry for entry in contents.metadata if entry.offset < size]
    finally:
        file.close()
    segment = Segment.reopen(path, size, contents, torn)
    if rebuilt:
        segment.add_message_indexes(rebuilt)
    return segment.finish()


def torn_chunk_bytes(path: Path) -> int:
    """Return how many bytes there are of a chunk that the end of a file cuts; 0 if none is cut."""
    file = McapFile(path)
    try:
        end, size = file.index.end, file.source.size()
        is_cut = not file.index.finished and end < size
        return size - end if is_cut and file.source.read(end, 1) == bytes([Opcode.CHUNK]) else 0
    finally:
        file.close()


def _mended_schemas(index: FileIndex) -> dict[int, bytes]:
    """Return a valid text for each schema, by id, that a crash cut while it was rewritten in place."""
    codecs = {channel.schema_id: _codec(channel.message_encoding) for channel in index.channels.values()}
    texts: dict[int, bytes] = {}
    for number, schema in index.schemas.items():
        codec = codecs.get(number)
        if codec is not None and codec.schema_encoding == schema.encoding:
            text = codec.mended(schema.data)
        else:
            text = json_schema.mended(schema.data) if schema.encoding == json_schema.ENCODING else None
        if text is not None and len(text) == len(schema.data):
            texts[number] = text
    return texts


def _wider_schemas(file: McapFile) -> dict[int, bytes]:
    """Return the schemas, by id, of which a wider copy was written and is not what lies in its place."""
    index = file.index
    copied = [number for number, (at, _) in index.schema_places.items() if _opcode(file, at) == WIDER_SCHEMA_OPCODE]
    wider: dict[int, bytes] = {}
    for number, at in _schema_offsets(file, copied).items():
        record = SCHEMA.pack(index.schemas[number])
        if file.source.read(at, len(record)) != record and index.schema_places[number][1] == _length(file, at):
            wider[number] = index.schemas[number].data
    return wider


def _opcode(file: McapFile, at: int) -> int:
    return read_prefix(file.source.read(at, PREFIX_BYTES), 0)[0]


def _length(file: McapFile, at: int) -> int:
    return read_prefix(file.source.read(at, PREFIX_BYTES), 0)[1]


def _codec(encoding: str) -> Codec | None:
    """Return the codec of an encoding that rows can be recorded in; None if there is none here."""
    try:
        codec = codec_table.find(encoding)
    except EncodingError:  # its package is not installed
        return None
    return codec if isinstance(codec, Codec) else None


def _schema_offsets(file: McapFile, numbers: Collection[int]) -> dict[int, int]:
    """Return where the first Schema records of some ids lie, by id."""
    offsets: dict[int, int] = {}
    at = len(MAGIC)
    while set(numbers) - set(offsets) and at < file.index.end:
        opcode, length = read_prefix(file.source.read(at, PREFIX_BYTES), 0)
        if opcode == Opcode.SCHEMA:
            number = int.from_bytes(file.source.read(at + PREFIX_BYTES, 2), "little")
            if number in numbers:
                offsets[number] = at
        at += PREFIX_BYTES + length
    return offsets


def _contents(index: FileIndex, chunks: Iterable[Chunk]) -> WrittenContents:
    """Return the contents that the summary will list. The last chunk may lack its message indexes."""
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
    # The MCAP specification has message indexes in order of time. Stable: rows of one time keep the order of writing.
    order = np.argsort(index.times_ns, kind="stable")
    return pack_message_index(index.channel_id, index_entries(index.times_ns[order], index.offsets[order]))
