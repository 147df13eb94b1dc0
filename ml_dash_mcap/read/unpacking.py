"""What lies in the chunks of one file: their records, and where the messages of a channel are among them."""

from __future__ import annotations

import threading
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Mapping

from ..errors import DamagedFileError
from . import chunk as chunks
from . import records
from .fields import Bytes, Fields
from .limits import Limits
from .losses import Losses
from .records import Chunk, MessageIndex, Opcode
from .source import Source

_KEPT_CHUNKS = 4
_KEPT_BYTES = 32 * 1024 * 1024
"""Unpacked chunks that are kept for the next reader: so many at most, and no more bytes than this."""

_HEAD_BYTES = 4096


_Key = tuple[int, int]


class Unpacking:
    """Unpacks chunks and finds messages in them. Any thread may call it."""

    def __init__(self, source: Source, limits: Limits, losses: Losses) -> None:
        """Begin with nothing unpacked.

        Args:
            source: The file.
            limits: For what is unpacked.
            losses: Gets what a chunk's index says wrongly.
        """
        self._losses = losses
        self._source = source
        self._limits = limits
        self._kept_lock = threading.Lock()
        """Guards `_kept` and `_scanned`."""
        self._kept: OrderedDict[_Key, bytes] = OrderedDict()
        self._scanned: dict[_Key, Mapping[int, MessageIndex]] = {}
        """What walking the records of those that are kept brought to light."""
        self._edges: tuple[Chunk | None, list[int]] = (None, [])
        """Of the chunk that was asked for last, where its message indexes start, sorted."""

    def read(self, offset: int, length: int) -> bytes:
        """Read the bytes of chunks that lie together; none if one is longer than any that would be unpacked."""
        return self._source.read(offset, length) if length <= self._longest else b""

    @property
    def _longest(self) -> int:
        return self._limits.chunk_bytes + self._limits.record_bytes

    def records(self, chunk: Chunk, record: Bytes | None = None) -> bytes:
        """Return a chunk's records, uncompressed and checked; the last few are kept.

        Args:
            chunk: Which one.
            record: Its bytes, if they have been read already.

        Raises:
            DamagedFileError: They are not what they should be.
        """
        with self._kept_lock:
            kept = self._kept.get(_key(chunk))
        if kept is not None:
            return kept
        name = self._source.name
        if record is None:
            chunks.check_size(chunk, name, self._limits)
            record = self._source.read(chunk.offset, chunk.length)
        data = chunks.unpack(
            record, chunk, name, self._limits, lambda what: self._losses.note(name, chunk.offset, what)
        )
        with self._kept_lock:
            self._kept[_key(chunk)] = data
            while len(self._kept) > _KEPT_CHUNKS or sum(map(len, self._kept.values())) > _KEPT_BYTES:
                self._scanned.pop(self._kept.popitem(last=False)[0], None)
        return data

    def scan(self, chunk: Chunk) -> Mapping[int, MessageIndex]:
        """Return where each channel's messages lie in a chunk by walking its own records.

        Raises:
            DamagedFileError: They are not what they should be.
        """
        with self._kept_lock:
            found = self._scanned.get(_key(chunk))
        if found is None:
            found = chunks.scan(self.records(chunk), chunk, self._source.name).indexes
            with self._kept_lock:
                if _key(chunk) in self._kept:
                    self._scanned[_key(chunk)] = found
        return found

    def forget(self) -> None:
        """Let go of what was unpacked: the file was rewritten."""
        with self._kept_lock:
            self._kept.clear()
            self._scanned.clear()

    def index(self, chunk: Chunk, channel_id: int, span: Bytes | None = None, at: int = 0) -> MessageIndex:
        """Read the index of one channel's messages that is stored behind a chunk.

        Args:
            chunk: Which one; it has indexes of all its channels.
            channel_id: Of the channel.
            span: Bytes of the file that cover the chunk and its indexes, if they have been read already.
            at: Where in the file `span` starts, in bytes.

        Raises:
            DamagedFileError: There is none where it should be.
        """
        offset = chunk.message_index_offsets.get(channel_id)
        if offset is None:
            return chunks.no_messages(channel_id)
        room = self._room(chunk, offset)
        name = self._source.name
        if span is None:
            span, at = self._read_record(offset, room), offset
        start = offset - at + records.PREFIX_BYTES
        opcode, length = records.prefix(span, offset - at) if start <= len(span) else (0, 0)
        if opcode != Opcode.MESSAGE_INDEX or length > room - records.PREFIX_BYTES:
            raise DamagedFileError(name, offset, "the index says that a message index starts here, but none does")
        fields = Fields(span, name, at, start, min(start + length, len(span)))
        found = records.message_index(fields)
        if found.channel_id != channel_id:
            raise DamagedFileError(name, offset, f"a message index of channel {found.channel_id}, not {channel_id}")
        if start + length - fields.at >= records.ENTRY_BYTES:  # fields of a later version, or entries that are hidden
            true = self.scan(chunk).get(channel_id)
            if true is None or len(true.offsets) != len(found.offsets):
                raise DamagedFileError(name, offset, "a message index whose length contradicts itself")
        return found

    def _room(self, chunk: Chunk, offset: int) -> int:
        """Return how long a message index can be at most: none reaches into the next one."""
        known, edges = self._edges
        if known is not chunk:
            edges = sorted(chunk.message_index_offsets.values())
            self._edges = (chunk, edges)
        after = bisect_right(edges, offset)
        return (edges[after] if after < len(edges) else chunk.end + chunk.message_index_length) - offset

    def _read_record(self, offset: int, room: int) -> bytes:
        """Read the record that starts at `offset`; `room` bytes are the most that it can have."""
        head = self._source.read(offset, min(room, _HEAD_BYTES))
        if len(head) < records.PREFIX_BYTES:
            raise DamagedFileError(self._source.name, offset, "the file ends where a record should start")
        total = records.PREFIX_BYTES + records.prefix(head, 0)[1]
        if total <= len(head) or total > min(room, self._limits.record_bytes):
            return head
        return head + self._source.read(offset + len(head), total - len(head))


def _key(chunk: Chunk) -> _Key:
    """Return what tells a chunk from others; messages outside of chunks are taken together, and grow."""
    return chunk.offset, chunk.length
