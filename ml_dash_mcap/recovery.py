"""What a recorder that died left behind, made whole: its unfinished segment finished, its journal folded in."""

from __future__ import annotations

import errno
import glob
import json
import logging
import os
import socket
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Channel, ChunkIndex, MetadataIndex, Schema

from .errors import DamagedFileError, MissingRecordingError
from .layout import (
    ABOUT_RECORD,
    ACTIVE_SUFFIX,
    BLOCK_OPCODE,
    JOURNAL_FILE,
    JOURNAL_RECORD,
    KIND_KEY,
    SEGMENT_SUFFIX,
    SESSION_GLOB,
    TRACK,
)
from .options import RecorderOptions
from .read import chunk as read_chunk
from .read import records as read
from .read.file import File
from .read.index import FileIndex
from .version import LIBRARY
from .write import records
from .write.blocks import STAMP, BlockWriter
from .write.channels import ChannelInfo
from .write.lock import SessionLock
from .write.rows import Block
from .write.segment import Contents, Segment

_log = logging.getLogger("ml_dash_mcap")


@dataclass(frozen=True, slots=True)
class Recovered:
    """What a recovery did."""

    finished: list[Path] = field(default_factory=list)
    """Segments that had lost their end, and the one made of the journal."""
    rows: int = 0
    """Rows that were in the journal only."""
    lost_bytes: int = 0
    """What the machine's crash left of chunks that are in no journal either: their rows are lost."""
    left: list[Path] = field(default_factory=list)
    """Session files of dead recorders whose leftovers could not be recovered here; the log says why."""

    def __add__(self, other: Recovered) -> Recovered:
        """Return what both did."""
        return Recovered(
            [*self.finished, *other.finished],
            self.rows + other.rows,
            self.lost_bytes + other.lost_bytes,
            [*self.left, *other.left],
        )


@dataclass(slots=True)
class _Leftover:
    """A journal buffer of a dead recorder."""

    path: Path
    data: bytes
    begin: int
    """Where in it the first record starts."""
    end: int
    """Where the last sound one ends."""
    session: str | None = None
    block: int = -1
    """Its number among the session's blocks with rows."""
    starts: list[int] = field(default_factory=list)
    gaps: list[tuple[int, int]] = field(default_factory=list)
    extras: list[tuple[int, int]] = field(default_factory=list)
    channels: dict[int, ChannelInfo] = field(default_factory=dict)

    def take(self, opcode: int, at: int, end: int, schemas: dict[int, read.Schema]) -> None:
        """Take in one record.

        Raises:
            DamagedFileError: It contradicts itself.
        """
        if opcode == read.Opcode.MESSAGE:
            self.starts.append(at)
            return
        fields = read.Fields(self.data, str(self.path), 0, at + read.PREFIX_BYTES, end)
        if opcode == read.Opcode.SCHEMA:
            schema = read.schema(fields)
            schemas[schema.id] = schema
        elif opcode == read.Opcode.CHANNEL:
            info = _channel_info(read.channel(fields), schemas)
            self.channels[info.number] = info
        elif opcode == read.Opcode.METADATA:
            found = read.metadata(fields)
            if found.name == JOURNAL_RECORD:
                self.session, self.block = found.values["session"], int(found.values["block"])
            else:
                self.extras.append((at, end))
        self.gaps.append((at, end))


def recover(path: str | Path) -> Recovered:
    """Recover what dead recorders left in a run's folder; leave alone what living ones are writing.

    `Recorder` and `Recording` do this when they open a folder. Nothing is lost if it is interrupted.

    Args:
        path: The run's folder.

    Raises:
        MissingRecordingError: There is no such folder.
    """
    folder = Path(path).expanduser()
    if not folder.is_dir():
        raise MissingRecordingError(errno.ENOENT, "no recording here", str(path))
    done = Recovered()
    for session_file in sorted(folder.glob(SESSION_GLOB)):
        if session_file.is_symlink() or not session_file.is_file():
            continue  # a folder from outside may hold pipes, which would be waited for, and ways to others' sessions
        lock = SessionLock.seize(session_file)
        if lock is None:
            continue
        try:
            done += _recover_session(folder, lock)
        except Exception as error:  # whatever is wrong with one session, the others and this folder's user go on
            _log.warning("the leftovers of a crashed recorder in %s stay as they are: %r", folder, error)
            done += Recovered(left=[session_file])
        finally:
            lock.release()
    return done


def _recover_session(folder: Path, lock: SessionLock) -> Recovered:
    said = _read_session(lock.path)
    session = str(said.get("session") or lock.path.stem.removeprefix(".ml_dash-"))
    journals = [Path(name) for name in _journal_names(str(said.get("journals") or ""), session)]
    is_copy = _is_copy(said, lock)
    if is_copy and SessionLock.is_held(Path(said["path"])):
        journals = []  # their recorder lives; this folder is a copy of its
    elif not journals and said.get("host") not in (None, socket.gethostname()):
        _log.warning(
            "%s: the rows that a recorder on %s had not written yet are in its journal there (%s); open the recording"
            " there to get them",
            folder,
            said["host"],
            said.get("journals"),
        )
        return Recovered(left=[lock.path])
    leftovers = _read_journals(journals, session)
    about = {str(key): str(value) for key, value in dict(said.get("about") or {}).items()}
    unfinished = list(_unfinished(folder, session, about.pop(STAMP, "")))
    torn_bytes = sum(map(_torn_chunk, unfinished))
    journaled = {leftover.block for leftover in leftovers if leftover.starts}
    finished = [_finish(path, journaled) for path in unfinished]
    written, sequences = _written_so_far(folder, session)
    pending = [leftover for leftover in leftovers if leftover.block >= written]
    rows = sum(len(leftover.starts) for leftover in pending)
    if rows or any(leftover.extras for leftover in pending):
        about = {"prefix": folder.name, "run": session, **about, "library": LIBRARY, "recovered": "true"}
        finished += _fold_in(folder, about, pending, written, sequences)
    if not is_copy:
        for journal in journals:
            journal.unlink(missing_ok=True)
    lock.remove()
    return Recovered(finished, rows, lost_bytes=0 if pending else torn_bytes)


def _is_copy(said: dict[str, Any], lock: SessionLock) -> bool:
    """Whether a session file was copied along with its folder, and the one that the journal belongs to is there yet."""
    original = said.get("path")
    if not isinstance(original, str) or said.get("inode") in (None, lock.inode):
        return False
    return Path(original) != lock.path.absolute() and Path(original).exists()


def _read_session(session_file: Path) -> dict[str, Any]:
    try:
        said = json.loads(session_file.read_bytes())
    except ValueError:  # the process died while it wrote this, before it recorded anything
        return {}
    return said if isinstance(said, dict) else {}


def _journal_names(pattern: str, session: str) -> list[str]:
    """Return the session's buffers; a session file from outside may name those of others, who may be alive."""
    folder, _, name = pattern.rpartition("/")
    if not session.isalnum() or name != JOURNAL_FILE.format(session=session, number="*"):
        return []
    return [found for found in glob.glob(f"{glob.escape(folder)}/{name}") if os.path.isfile(found)]


# -- the journal -------------------------------------------------------------------------------------------------------


def _read_journals(paths: list[Path], session: str) -> list[_Leftover]:
    """Read the buffers that hold something, in the order in which they were filled."""
    found = [_read_journal(path, session) for path in paths]
    return sorted((one for one in found if one is not None), key=lambda one: (one.block, bool(one.starts)))


def _read_journal(path: Path, session: str) -> _Leftover | None:
    """Walk a buffer's records up to the first byte that begins none; None where nothing was recorded in it."""
    data = path.read_bytes()
    if not data.startswith(read.MAGIC):
        return None
    found = _Leftover(path, data, begin=len(read.MAGIC), end=len(read.MAGIC))
    schemas: dict[int, read.Schema] = {}
    while found.end + read.PREFIX_BYTES <= len(data):
        at = found.end
        opcode, length = read.prefix(data, at)
        end = at + read.PREFIX_BYTES + length
        if opcode == 0 or end > len(data):
            break
        try:
            found.take(opcode, at, end, schemas)
        except DamagedFileError:  # the machine did this, not the recorder; what came before is whole
            break
        found.end = end
    return found if found.session == session and (found.starts or found.extras) else None


def _channel_info(channel: read.Channel, schemas: dict[int, read.Schema]) -> ChannelInfo:
    metadata = dict(channel.metadata)
    kind = metadata.pop(KIND_KEY, TRACK)
    schema = schemas[channel.schema_id]
    said = json.loads(schema.data)
    fixed = said if "properties" in said else None  # an inferred one is still bare in the journal
    return ChannelInfo(channel.id, channel.topic, kind, metadata, fixed, schema.name)


def _fold_in(
    folder: Path, about: dict[str, str], pending: list[_Leftover], written: int, sequences: dict[str, int]
) -> list[Path]:
    """Write buffers, in order, into a segment of their own."""
    channels: dict[int, ChannelInfo] = {}
    for leftover in pending:
        channels.update(leftover.channels)
    by_number = {number: sequences.get(info.topic, 0) for number, info in channels.items()}
    blocks = BlockWriter(folder, RecorderOptions(), about, channels, written, by_number)
    for one in pending:
        data = np.frombuffer(bytearray(one.data), np.uint8)
        blocks.commit(blocks.prepare(Block(data, one.begin, one.end, one.starts, one.gaps, one.extras)))
    blocks.finish({})
    return blocks.finished


# -- the segments ------------------------------------------------------------------------------------------------------


def _unfinished(folder: Path, session: str, stamp: str) -> Iterable[Path]:
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
        file = File(path)
    except DamagedFileError:
        return None
    try:
        about = next((record.values for record in file.metadata() if record.name == ABOUT_RECORD), None)
        return None if about is None else about.get("run")
    finally:
        file.close()


def _finish(path: Path, journaled: Collection[int]) -> Path:
    """Give an unfinished segment its end, and its name if that is all it lacks.

    Args:
        path: The segment.
        journaled: Numbers of the blocks that can be written again: what a crash left of the chunks of one is cut off.
    """
    file = File(path)
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
            scan = read_chunk.scan(file.unpack(last), last, file.source.name)
            rebuilt = {number: _message_index(found) for number, found in scan.indexes.items()}
            contents.counts = _add(contents.counts, scan.counts)
            size = last.end
        contents.metadata = [entry for entry in contents.metadata if entry.offset < size]
    finally:
        file.close()
    segment = Segment.reopen(path, size, contents, torn)
    if rebuilt:
        segment.add_message_indexes(rebuilt)
    return segment.finish()


def _whole_blocks(file: File) -> tuple[int, int]:
    """Return how many blocks a session has up to the last whole one in a file, and how many of its chunks those are."""
    chunks = file.index.chunks
    for number in range(len(chunks), 0, -1):
        chunk = chunks[number - 1]
        at = chunk.end + chunk.message_index_length
        opcode, length = read.prefix(file.source.read(at, read.PREFIX_BYTES).ljust(read.PREFIX_BYTES, b"\0"), 0)
        if chunk.indexed and (opcode, length) == (BLOCK_OPCODE, 8):
            said = file.source.read(at + read.PREFIX_BYTES, 8)
            if len(said) == 8:
                return int.from_bytes(said, "little") + 1, number
    about = next((record.values for record in file.metadata() if record.name == ABOUT_RECORD), {})
    return int(about.get("first_block", 0)), 0


def _torn_chunk(path: Path) -> int:
    """Return how many bytes there are of a chunk that the end of a file cuts; 0 if none is cut."""
    file = File(path)
    try:
        end, size = file.index.end, file.source.size()
        is_cut = not file.index.finished and end < size
        return size - end if is_cut and file.source.read(end, 1) == bytes([read.Opcode.CHUNK]) else 0
    finally:
        file.close()


def _torn_schemas(file: File) -> dict[int, int]:
    """Return where those schemas lie, by id, that a crash cut while they were rewritten in place."""
    torn = {number for number, schema in file.index.schemas.items() if not _is_json(schema)}
    found: dict[int, int] = {}
    at = len(read.MAGIC)
    while torn - set(found) and at < file.index.end:
        opcode, length = read.prefix(file.source.read(at, read.PREFIX_BYTES), 0)
        if opcode == read.Opcode.SCHEMA:
            number = int.from_bytes(file.source.read(at + read.PREFIX_BYTES, 2), "little")
            if number in torn:
                found[number] = at
        at += read.PREFIX_BYTES + length
    return found


def _is_json(schema: read.Schema) -> bool:
    try:
        return schema.encoding != "jsonschema" or isinstance(json.loads(schema.data), dict)
    except ValueError:
        return False


def _bare(record: bytes) -> bytes:
    """Return a Schema record of the same length whose text says only that messages are objects."""
    schema = read.schema(read.Fields(record, "", 0, read.PREFIX_BYTES))
    return record[: len(record) - len(schema.data)] + b'{"type":"object"}'.ljust(len(schema.data))


def _contents(index: FileIndex, chunks: Iterable[read.Chunk]) -> Contents:
    """Say what an unfinished file holds in the terms of its summary; its last chunk may lack its message index."""
    contents = Contents()
    for schema in index.schemas.values():
        contents.schemas[schema.id] = records.to_bytes(
            Schema(id=schema.id, name=schema.name, encoding=schema.encoding, data=schema.data)
        )
    for channel in index.channels.values():
        contents.channels[channel.id] = records.to_bytes(
            Channel(
                id=channel.id,
                schema_id=channel.schema_id,
                topic=channel.topic,
                message_encoding=channel.message_encoding,
                metadata=dict(channel.metadata),
            )
        )
    for chunk in chunks:
        contents.chunks.append(
            ChunkIndex(
                chunk_length=chunk.length,
                chunk_start_offset=chunk.offset,
                compression=chunk.compression,
                compressed_size=chunk.compressed_size,
                message_end_time=chunk.end_ns,
                message_index_length=chunk.message_index_length,
                message_index_offsets=dict(chunk.message_index_offsets),
                message_start_time=chunk.start_ns,
                uncompressed_size=chunk.uncompressed_size,
            )
        )
        if chunk.indexed:
            contents.counts = _add(contents.counts, chunk.counts or {})
    for entry in index.metadata:
        contents.metadata.append(MetadataIndex(offset=entry.offset, length=entry.length, name=entry.name))
    return contents


def _message_index(found: read.MessageIndex) -> bytes:
    order = np.argsort(found.times_ns, kind="stable")
    entries = np.empty(len(order), records.INDEX_ENTRY_DTYPE)
    entries["time"], entries["offset"] = found.times_ns[order], found.offsets[order]
    return records.message_index(found.channel_id, entries)


def _add(counts: dict[int, int], more: Any) -> dict[int, int]:
    return {number: counts.get(number, 0) + more.get(number, 0) for number in {*counts, *more}}


def _written_so_far(folder: Path, session: str) -> tuple[int, dict[str, int]]:
    """Return how many blocks with rows a session has in finished segments, and how many rows each topic has there.

    The session's segments are its newest ones, so that older runs in the folder are not opened.
    """
    blocks, rows = 0, dict[str, int]()
    for path in sorted(folder.glob(f"*{SEGMENT_SUFFIX}"), reverse=True):
        try:
            file = File(path)
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
