"""Unpacks the chunks of one file, and finds the messages of a channel in them."""

from __future__ import annotations

import threading
from array import array
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable, Mapping
from pathlib import Path

from ..errors import DamagedFileError
from ..store.byte_source import ByteSource
from . import chunk_bytes, chunk_messages, records
from .limits import Limits
from .losses import Loss, Losses
from .message_records import ENTRY_BYTES, MessageIndex, read_message_index
from .record_layout import PREFIX_BYTES, Bytes, Fields, read_prefix
from .records import Chunk, Opcode

_KEPT_CHUNKS = 4
_KEPT_BYTES = 32 * 1024 * 1024
"""Unpacked chunks that are kept for the next reader: so many at most, and no more bytes than this."""

_KEPT_EDGES = 1 << 20
"""So many places of message indexes are kept sorted: whoever lists all topics asks for those of each chunk again."""

_HEAD_BYTES = 4096


_Key = tuple[int, int]


class FileChunks:
    """Unpacks chunks and finds messages in them. Any thread may call it."""

    def __init__(
        self, source: ByteSource, limits: Limits, losses: Losses, topic_of: Callable[[int], str] | None = None
    ) -> None:
        """Begin with nothing unpacked.

        Args:
            source: The file.
            limits: Limits for unpacking.
            losses: Gets the faults of chunk indexes, and the messages that are left out.
            topic_of: Names the topic of a channel, where messages that are over the limits are to be left out of their
                chunk; None refuses the chunk.
        """
        self._topic_of = topic_of
        self._partial: set[_Key] = set()
        """The chunks of which messages were left out."""
        self._losses = losses
        self._source = source
        self._limits = limits
        self._kept_lock = threading.Lock()
        """Guards `_kept` and `_scanned`."""
        self._kept: OrderedDict[_Key, bytes] = OrderedDict()
        self._scanned: dict[_Key, Mapping[int, MessageIndex]] = {}
        """The message indexes of kept chunks, made by scanning their records."""
        self._edges: dict[int, tuple[Chunk, array[int]]] = {}
        """By identity, the chunks that were asked for last, and where the message indexes of each start, sorted."""
        self._edge_count = 0
        """How many places `_edges` has."""
        # One tuple, replaced as a whole: a thread that reads it needs no lock.
        self._latest: tuple[Chunk, MessageIndex] | None = None
        """The message index that was read last, with its chunk: a reader that looks up a time often reads it next."""

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
            DamagedFileError: They are damaged.
        """
        with self._kept_lock:
            kept = self._kept.get(_key(chunk))
        if kept is not None:
            return kept
        try:
            data = self._unpacked(chunk, record)
        except chunk_bytes.LimitError as error:
            if self._topic_of is None or chunk.compression == records.LOOSE:
                raise
            data = self._fitting(chunk, error, self._topic_of)
        with self._kept_lock:
            self._kept[_key(chunk)] = data
            while len(self._kept) > _KEPT_CHUNKS or sum(map(len, self._kept.values())) > _KEPT_BYTES:
                self._scanned.pop(self._kept.popitem(last=False)[0], None)
        return data

    def _unpacked(self, chunk: Chunk, record: Bytes | None) -> bytes:
        name = self._source.name
        if record is None:
            chunk_bytes.check_size(chunk, name, self._limits)
            record = self._source.read(chunk.offset, chunk.length)
        return chunk_bytes.unpack(
            record, chunk, name, self._limits, lambda what: self._losses.note(name, chunk.offset, what)
        )

    def _fitting(self, chunk: Chunk, error: chunk_bytes.LimitError, topic_of: Callable[[int], str]) -> bytes:
        """Return the records of a chunk that is over the limits, but for the messages that do not fit."""
        name = self._source.name
        rest = chunk_bytes.read_fitting(self._source, chunk, self._limits)
        scanned = chunk_messages.scan(rest.data, chunk, name)
        count: int | None = sum(rest.lost.values())
        if not rest.is_whole:
            announced = self._announced(chunk)
            count = None if announced is None else max(announced - sum(scanned.counts.values()), count or 0)
        if rest.is_whole and not count:
            self._losses.note(name, chunk.offset, f"the chunk's index says {error.what}, but it is not that large")
            return rest.data
        own = {number: channel.topic for number, channel in scanned.channels.items()}
        topics = {own.get(number) or topic_of(number): lost for number, lost in rest.lost.items()}
        parts = [f"{lost} of {topic!r}" for topic, lost in topics.items()]
        parts += [] if rest.is_whole else ["all that lies behind what may be unpacked of it"]
        what = f"messages that do not fit into the limits: {', '.join(parts)}; {error.what}"
        with self._kept_lock:
            self._partial.add(_key(chunk))
        self._losses.add((chunk.offset, "limits"), Loss(Path(name), chunk.offset, what, count))
        return rest.data

    def _announced(self, chunk: Chunk) -> int | None:
        """Return how many messages a chunk has by the indexes behind it; None where they do not say."""
        if not chunk.indexed or not chunk.message_index_offsets:
            return None
        try:
            return sum(len(self.index(chunk, channel_id).offsets) for channel_id in chunk.message_index_offsets)
        except DamagedFileError:
            return None

    def is_partial(self, chunk: Chunk) -> bool:
        """Whether messages were left out of a chunk when it was unpacked, so that its stored indexes do not fit."""
        return bool(self._partial) and _key(chunk) in self._partial

    def is_over(self, chunk: Chunk) -> bool:
        """Whether messages may have to be left out of a chunk, as far as is known before it is unpacked."""
        if self._topic_of is None or chunk.compression == records.LOOSE:
            return False
        try:
            chunk_bytes.check_size(chunk, self._source.name, self._limits)
        except chunk_bytes.LimitError:
            return True
        return self.is_partial(chunk)

    def scan(self, chunk: Chunk) -> Mapping[int, MessageIndex]:
        """Return where each channel's messages lie in a chunk by scanning its records.

        Raises:
            DamagedFileError: They are damaged.
        """
        with self._kept_lock:
            indexes = self._scanned.get(_key(chunk))
        if indexes is None:
            indexes = chunk_messages.scan(self.records(chunk), chunk, self._source.name).indexes
            with self._kept_lock:
                if _key(chunk) in self._kept:
                    self._scanned[_key(chunk)] = indexes
        return indexes

    def forget(self) -> None:
        """Forget all unpacked chunks, because the file was rewritten."""
        with self._kept_lock:
            self._kept.clear()
            self._latest = None
            self._edges.clear()
            self._partial.clear()
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
            return chunk_messages.no_messages(channel_id)
        latest = self._latest
        if latest is not None and latest[0] is chunk and latest[1].channel_id == channel_id:
            return latest[1]
        room = self._room(chunk, offset)
        name = self._source.name
        if span is None:
            span, at = self._read_record(offset, room), offset
        start = offset - at + PREFIX_BYTES
        opcode, length = read_prefix(span, offset - at) if start <= len(span) else (0, 0)
        if opcode != Opcode.MESSAGE_INDEX or length > room - PREFIX_BYTES:
            raise DamagedFileError(name, offset, "the index says that a message index starts here, but none does")
        fields = Fields(span, name, at, start, min(start + length, len(span)))
        index = read_message_index(fields)
        if index.channel_id != channel_id:
            raise DamagedFileError(name, offset, f"a message index of channel {index.channel_id}, not {channel_id}")
        if start + length - fields.at >= ENTRY_BYTES:  # fields of a later version, or entries that are hidden
            true = self.scan(chunk).get(channel_id)
            if true is None or len(true.offsets) != len(index.offsets):
                raise DamagedFileError(name, offset, "a message index whose length contradicts itself")
        self._latest = (chunk, index)
        return index

    def _room(self, chunk: Chunk, offset: int) -> int:
        """Return how long a message index can be at most: none reaches into the next one."""
        # The chunk is kept beside its places, so that no other chunk can get its id.
        kept = self._edges.get(id(chunk))
        if kept is None:
            self._edge_count += len(chunk.message_index_offsets)
            if self._edge_count > _KEPT_EDGES:
                self._edges.clear()
                self._edge_count = len(chunk.message_index_offsets)
            kept = self._edges[id(chunk)] = chunk, array("Q", sorted(chunk.message_index_offsets.values()))
        edges = kept[1]
        after = bisect_right(edges, offset)
        return (edges[after] if after < len(edges) else chunk.indexes_end) - offset

    def _read_record(self, offset: int, room: int) -> bytes:
        """Read the record that starts at `offset`; `room` bytes are the most that it can have."""
        head = self._source.read(offset, min(room, _HEAD_BYTES))
        if len(head) < PREFIX_BYTES:
            raise DamagedFileError(self._source.name, offset, "the file ends where a record should start")
        total = PREFIX_BYTES + read_prefix(head, 0)[1]
        if total <= len(head) or total > min(room, self._limits.record_bytes):
            return head
        return head + self._source.read(offset + len(head), total - len(head))


def _key(chunk: Chunk) -> _Key:
    """Return a key for a chunk. The length is part of it, because a group of messages outside of chunks may grow."""
    return chunk.offset, chunk.length
