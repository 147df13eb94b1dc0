"""One MCAP file: its bytes, its index, its metadata."""

from __future__ import annotations

import threading
from collections import OrderedDict
from pathlib import Path

from ..errors import DamagedFileError
from ..layout import ACTIVE_SUFFIX
from . import chunk as chunks
from . import index, limits, records, summary, walk
from .fields import Bytes, Fields
from .index import FileIndex, Glance
from .records import Chunk, Header, MessageIndex, Opcode
from .source import LocalFile, Source

_KEPT_CHUNKS = 4
_HEAD_BYTES = 4096


class File:
    """An MCAP file that is finished, was cut, or is still being recorded.

    Any thread may read; one at a time refreshes.
    """

    def __init__(self, path: Path, limits_: limits.Limits = limits.DEFAULT) -> None:
        """Open a file and index it.

        Raises:
            MissingRecordingError: There is no such file.
            DamagedFileError: It is no MCAP file, or a finished one that is broken.
        """
        self.path = path
        is_new = path.name.endswith(ACTIVE_SUFFIX)
        self.source: Source = LocalFile(path, stays_open=is_new)
        self.limits = limits_
        self._metadata: dict[int, records.Metadata] = {}
        self._unpacked_lock = threading.Lock()
        """Guards `_unpacked`."""
        self._unpacked: OrderedDict[int, bytes] = OrderedDict()
        self._size = self.source.size()
        self._loading_lock = threading.Lock()
        """Guards the loading of `_index`."""
        self._index: FileIndex | None = None
        self._glance: Glance | None = None
        try:
            self._open(is_new=is_new)
        except BaseException:
            self.source.close()
            raise

    def _open(self, *, is_new: bool) -> None:
        started = _start(self.source, self._size, is_new)
        found = None if started is None else summary.footer(self.source, self._size)
        if started is not None and found is not None:
            self._glance = summary.glance(self.source, self._size, started[0], found)
        if self._glance is None:
            self._index = load(self.source, self.limits, is_new=is_new)

    @property
    def index(self) -> FileIndex:
        """What the file holds, and where; of a long file, read when it is first asked for.

        Raises:
            DamagedFileError: Its summary and its data section are broken.
        """
        with self._loading_lock:
            if self._index is None:
                self._index = load(self.source, self.limits)
            return self._index

    @property
    def glance(self) -> Glance:
        """What is known of it without looking up its chunks."""
        return self._glance if self._index is None and self._glance is not None else self.index.glance()

    def refresh(self, path: Path | None = None) -> bool:
        """Take in what was written since.

        Args:
            path: The file's new name, if it was renamed.

        Returns:
            Whether anything changed.
        """
        if path is not None:
            self.path = path
        before = self._index
        if before is None or before.finished:
            return False
        size = self.source.size()
        if size == self._size:
            return False
        self._size = size
        fresh = load(self.source, self.limits, is_new=before.end == 0, previous=before)
        if fresh.end < before.end or fresh.finished:
            self._metadata.clear()  # a recovery may have rewritten the file
            with self._unpacked_lock:
                self._unpacked.clear()
        self._index = fresh
        return fresh.end != before.end or fresh.finished

    def is_at(self, path: Path) -> bool:
        """Whether a path leads to this very file, which may have been renamed since it was opened."""
        return isinstance(self.source, LocalFile) and self.source.is_at(path)

    def metadata(self) -> list[records.Metadata]:
        """Return all metadata records, in the order of the file. Each is read once."""
        return [self._read_metadata(entry) for entry in self.glance.metadata]

    def unpack(self, chunk: Chunk, record: Bytes | None = None) -> bytes:
        """Return a chunk's records, uncompressed and checked; the last few are kept.

        Args:
            chunk: Which one.
            record: Its bytes, if they have been read already.
        """
        with self._unpacked_lock:
            kept = self._unpacked.get(chunk.offset)
        if kept is not None:
            return kept
        if record is None:
            record = self.source.read(chunk.offset, chunk.length)
        data = chunks.unpack(record, chunk, self.source.name, self.limits)
        if chunk.compression != records.LOOSE:  # those grow
            with self._unpacked_lock:
                self._unpacked[chunk.offset] = data
                if len(self._unpacked) > _KEPT_CHUNKS:
                    self._unpacked.popitem(last=False)
        return data

    def message_index(self, chunk: Chunk, channel_id: int, span: Bytes | None = None, at: int = 0) -> MessageIndex:
        """Return where one channel's messages lie in a chunk.

        Args:
            chunk: Which one; its own records are walked if it has no message index.
            channel_id: Of the channel.
            span: Bytes of the file that cover the chunk and its indexes, if they have been read already.
            at: Where in the file `span` starts, in bytes.
        """
        if not chunk.indexed:
            found = chunks.scan(self.unpack(chunk), chunk, self.source.name).indexes.get(channel_id)
            return found if found is not None else chunks.no_messages(channel_id)
        offset = chunk.message_index_offsets.get(channel_id)
        if offset is None:
            return chunks.no_messages(channel_id)
        room = chunk.end + chunk.message_index_length - offset
        if span is None:
            span, at = self._read_record(offset, room), offset
        opcode, length = records.prefix(span, offset - at)
        if opcode != Opcode.MESSAGE_INDEX or length > room - records.PREFIX_BYTES:
            raise DamagedFileError(
                self.source.name, offset, "the index says that a message index starts here, but none does"
            )
        start = offset - at + records.PREFIX_BYTES
        read = records.message_index(Fields(span, self.source.name, at, start, start + length))
        if read.channel_id != channel_id:
            raise DamagedFileError(
                self.source.name, offset, f"a message index of channel {read.channel_id}, not {channel_id}"
            )
        return read

    def close(self) -> None:
        """Close the file. May be called twice."""
        self.source.close()

    def _read_record(self, offset: int, room: int) -> bytes:
        """Read the record that starts at `offset`; `room` bytes are the most that it can have."""
        head = self.source.read(offset, min(room, _HEAD_BYTES))
        if len(head) < records.PREFIX_BYTES:
            raise DamagedFileError(self.source.name, offset, "the file ends where a record should start")
        total = records.PREFIX_BYTES + records.prefix(head, 0)[1]
        if total <= len(head) or total > room:
            return head
        return head + self.source.read(offset + len(head), total - len(head))

    def _read_metadata(self, entry: records.MetadataEntry) -> records.Metadata:
        known = self._metadata.get(entry.offset)
        if known is not None:
            return known
        name = self.source.name
        if entry.length > self.limits.record_bytes:
            raise DamagedFileError(name, entry.offset, f"a metadata record of {entry.length} bytes")
        data = self.source.read(entry.offset, entry.length)
        if len(data) < records.PREFIX_BYTES or records.prefix(data, 0) != (
            Opcode.METADATA,
            len(data) - records.PREFIX_BYTES,
        ):
            raise DamagedFileError(
                name, entry.offset, "the index says that a metadata record starts here, but none does"
            )
        found = records.metadata(Fields(data, name, entry.offset, records.PREFIX_BYTES))
        self._metadata[entry.offset] = found
        return found


def load(
    source: Source, limits_: limits.Limits, *, is_new: bool = False, previous: FileIndex | None = None
) -> FileIndex:
    """Index a file: by its summary if it is finished, else by walking over its records.

    Args:
        source: The file.
        limits_: For what is read.
        is_new: Whether the file may still be without its magic and header, because a recorder is just creating it.
        previous: What an earlier call found, to go on from if the file is still not finished.

    Raises:
        DamagedFileError: It is no MCAP file, or a finished one that is broken.
    """
    size = source.size()
    started = _start(source, size, is_new)
    if started is None:
        return index.empty(source.name)
    header, first = started
    found = summary.footer(source, size)
    if found is None:
        resumable = previous if previous is not None and first <= previous.end <= size else None
        return walk.walk(source, size, header, first, limits_, resumable)
    try:
        by_summary = summary.read(source, size, header, found, limits_)
    except DamagedFileError:
        by_summary = None
    return by_summary or walk.walk_finished(source, size, header, first, limits_)


def _start(source: Source, size: int, is_new: bool) -> tuple[Header, int] | None:
    """Return a file's header and where the record behind it starts; None while it has none."""
    head = source.read(0, min(size, _HEAD_BYTES))
    magic = head[: len(records.MAGIC)]
    if is_new and records.MAGIC.startswith(magic) and len(head) < len(records.MAGIC) + records.PREFIX_BYTES:
        return None
    if not head:
        raise DamagedFileError(source.name, 0, "the file is empty")
    if magic != records.MAGIC:
        raise DamagedFileError(source.name, 0, f"this is no MCAP file: it starts with {magic!r}")
    at = len(records.MAGIC)
    opcode, length = records.prefix(head, at) if len(head) >= at + records.PREFIX_BYTES else (0, 0)
    end = at + records.PREFIX_BYTES + length
    if opcode != Opcode.HEADER or end > len(head):
        if is_new and end > size:
            return None
        raise DamagedFileError(source.name, at, "an MCAP file without a header")
    return records.header(Fields(head, source.name, 0, at + records.PREFIX_BYTES, end)), end
