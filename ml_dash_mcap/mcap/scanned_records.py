"""Collects what the records of a data section say, one record at a time."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from ..errors import DamagedFileError
from ..file_names import BLOCK_OPCODE, WIDER_SCHEMA_OPCODE
from ..store.byte_source import ByteSource
from . import records
from .chunk_messages import ChunkScan
from .file_index import FileIndex
from .limits import Limits, too_long
from .message_records import ENTRY_BYTES, MESSAGE_FIELDS, MESSAGE_FIXED_BYTES, MESSAGE_INDEX_HEAD
from .record_layout import PREFIX_BYTES, Fields, read_prefix
from .records import AttachmentEntry, Channel, Chunk, MetadataEntry, Opcode, Schema

# The heads of several small records come with one read, and little is read in vain before a large chunk.
_WINDOW_BYTES = 16 * 1024

_LOOSE_BYTES = 4 * 1024 * 1024
"""Messages outside chunks are taken together up to this many bytes."""

_ATTACHMENT_HEAD_BYTES = 16 * 1024

_KNOWN = frozenset(Opcode)

_IN_DATA = {
    *(Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.MESSAGE_INDEX),
    *(Opcode.ATTACHMENT, Opcode.METADATA),
}


class FileWindow:
    """Gives a file's bytes, reading some more than it is asked for. One thread uses it."""

    def __init__(self, source: ByteSource, size: int, limits: Limits) -> None:
        """Begin anywhere.

        Args:
            source: The file.
            size: Where it ends, in bytes; bytes that are appended meanwhile are left alone.
            limits: Limits for a single read.
        """
        self.source = source
        self.size = size
        self._limits = limits
        self._data = b""
        self._at = 0

    def bytes(self, at: int, length: int) -> bytes:
        """Return the bytes of [at, at + length).

        Raises:
            DamagedFileError: They are not there any more.
        """
        offset = at - self._at
        if offset < 0 or offset + length > len(self._data):
            self._data = self.source.read(at, min(max(length, _WINDOW_BYTES), self.size - at))
            self._at = at
            offset = 0
            if len(self._data) < length:
                raise DamagedFileError(self.source.name, at, "the file was cut while it was read")
        return self._data[offset : offset + length]

    def content(self, at: int, length: int, *, at_most: int | None = None) -> Fields:
        """Return the content of a record, or only its first bytes.

        Args:
            at: Where the record starts.
            length: Of its content.
            at_most: How many bytes of it are wanted; None for all.

        Raises:
            DamagedFileError: It is beyond the limits.
        """
        if at_most is not None:
            length = min(length, at_most)
        if length > self._limits.record_bytes:
            raise DamagedFileError(self.source.name, at, too_long("a record", length, self._limits))
        start = at + PREFIX_BYTES
        return Fields(self.bytes(start, length), self.source.name, start)


class ScannedRecords:
    """The chunks and all other records of a data section so far.

    The last chunk's maps grow in place. The maps of earlier chunks do not change.
    """

    def __init__(self, window: FileWindow) -> None:
        """Begin with nothing."""
        self._window = window
        self.places: Sequence[int] = ()
        """Where records are known to start, in bytes, sorted: none lies inside another one."""
        self.schemas: dict[int, Schema] = {}
        self.schema_places: dict[int, tuple[int, int]] = {}
        """Where the Schema records lie: where each starts, and how long its content is."""
        self.channels: dict[int, Channel] = {}
        self.chunks: list[Chunk] = []
        self.metadata: list[MetadataEntry] = []
        self.attachments: list[AttachmentEntry] = []
        self._offsets: dict[int, int] = {}
        """Where the message indexes of the last chunk lie, by channel."""
        self._counts: dict[int, int] = {}
        """How many messages the last chunk has, by channel."""

    def resume(self, previous: FileIndex) -> None:
        """Take over the records of an earlier scan."""
        self.schemas.update(previous.schemas)
        self.schema_places.update(previous.schema_places)
        self.channels.update(previous.channels)
        self.chunks.extend(previous.chunks)
        self.metadata.extend(previous.metadata)
        self.attachments.extend(previous.attachments)
        if self.chunks:
            last = self.chunks[-1]
            self._offsets, self._counts = dict(last.message_index_offsets), dict(last.counts or {})
            counts = None if last.counts is None else self._counts
            # The same dict, not a copy: message indexes that follow are put into it.
            self.chunks[-1] = replace(last, message_index_offsets=self._offsets, counts=counts)

    def read_schemas_again(self) -> None:
        """Read the Schema records of an earlier scan again: a recorder in progress widens them where they lie.

        It does so before it writes the rows that need it, so whoever has found these rows finds the schema. A record
        that is changed meanwhile stays as it was read before; so does one of which a wider copy was read.
        """
        for schema_id, (at, length) in self.schema_places.items():
            source = self._window.source
            data = source.read(at, PREFIX_BYTES + length)
            is_there = len(data) == PREFIX_BYTES + length and read_prefix(data, 0) == (Opcode.SCHEMA, length)
            if not is_there or source.read(at, len(data)) != data:
                continue
            with suppress(DamagedFileError):
                schema = records.SCHEMA.read(Fields(data, source.name, at, PREFIX_BYTES))
                if schema.id == schema_id:
                    self.schemas[schema_id] = schema

    def take(self, opcode: int, at: int, length: int) -> None:
        """Take in a record that lies whole in the file.

        Args:
            opcode: The kind of the record.
            at: Where it starts.
            length: Of its content.

        Raises:
            DamagedFileError: It contradicts itself.
        """
        if opcode == Opcode.CHUNK:
            self._take_chunk(at, length)
        elif opcode == Opcode.MESSAGE_INDEX:
            self._take_message_index(at, length)
        elif opcode == Opcode.MESSAGE:
            self._take_loose_message(at, length)
        elif opcode == Opcode.SCHEMA:
            schema = records.SCHEMA.read(self._window.content(at, length))
            self.schemas[schema.id] = schema
            self.schema_places[schema.id] = (at, length)
        elif opcode == WIDER_SCHEMA_OPCODE:
            self._take_wider_schema(at, length)
        elif opcode == Opcode.CHANNEL:
            channel = records.CHANNEL.read(self._window.content(at, length))
            self.channels[channel.id] = channel
        elif opcode == Opcode.METADATA:
            name = records.METADATA.read(self._window.content(at, length)).name
            self.metadata.append(MetadataEntry(name, at, PREFIX_BYTES + length))
        elif opcode == Opcode.ATTACHMENT:
            start = self._window.content(at, length, at_most=_ATTACHMENT_HEAD_BYTES)
            first = start.at
            entry = records.ATTACHMENT_HEAD.read(start, offset=at, length=PREFIX_BYTES + length)
            if start.at - first + entry.data_size + records.CRC_BYTES > length:
                raise DamagedFileError(self._window.source.name, at, "an attachment that is longer than its record")
            self.attachments.append(entry)
        is_known = opcode in _IN_DATA or opcode == WIDER_SCHEMA_OPCODE or (opcode, length) == (BLOCK_OPCODE, 8)
        if not is_known and self.chunks and at == self.chunks[-1].indexes_end:
            self.doubt()  # the record may have been a message index

    def _take_wider_schema(self, at: int, length: int) -> None:
        with suppress(DamagedFileError):  # the private records of others may hold anything
            schema = records.WIDER_SCHEMA.read(self._window.content(at, length))
            present = self.schemas.get(schema.id)
            if present is not None and (present.name, present.encoding) == (schema.name, schema.encoding):
                self.schemas[schema.id] = schema
                self.schema_places[schema.id] = (at, length)

    def doubt(self) -> None:
        """Rely no more on the message indexes behind the last chunk: its own records will be scanned."""
        if self.chunks and self.chunks[-1].compression != records.LOOSE:
            last = self.chunks[-1]
            self.chunks[-1] = replace(
                last, message_index_offsets={}, message_index_length=0, indexed=False, counts=None
            )

    def learn(self, position: int, scan: ChunkScan) -> None:
        """Take in the contents of a chunk that was scanned.

        Args:
            position: Of the chunk among `chunks`.
            scan: The contents that the scan found.
        """
        for schema_id, schema in scan.schemas.items():
            self.schemas.setdefault(schema_id, schema)
        for channel_id, channel in scan.channels.items():
            self.channels.setdefault(channel_id, channel)
        chunk = self.chunks[position]
        is_agreed = (
            chunk.counts is None
            or {channel_id: count for channel_id, count in chunk.counts.items() if count} == scan.counts
        )
        settled = _settled(replace(chunk, counts=scan.counts))
        self.chunks[position] = replace(settled, indexed=settled.indexed and is_agreed)

    def settle(self) -> None:
        """Say of the last chunk whether its message indexes cover it, as nothing will be added to them for now."""
        if self.chunks:
            self.chunks[-1] = _settled(self.chunks[-1])

    def drop_last(self) -> None:
        """Take out the last chunk and everything behind it."""
        end = self.chunks.pop().offset
        self.metadata = [entry for entry in self.metadata if entry.offset < end]
        self.attachments = [entry for entry in self.attachments if entry.offset < end]

    def _take_chunk(self, at: int, length: int) -> None:
        self.settle()
        head = records.CHUNK_HEAD.read(self._window.content(at, length, at_most=records.CHUNK_HEAD_BYTES))
        self._check_end("a chunk", at, length, head.records_at + head.records_length)
        self._offsets, self._counts = {}, {}
        self.chunks.append(
            Chunk(
                offset=at,
                length=PREFIX_BYTES + length,
                start_ns=head.start_ns,
                end_ns=head.end_ns,
                compression=head.compression,
                compressed_size=head.records_length,
                uncompressed_size=head.uncompressed_size,
                message_index_offsets=self._offsets,
                indexed=False,
            )
        )

    def _check_end(self, what: str, at: int, length: int, used: int) -> None:
        """Check that a record is as long as its fields, or was extended and ends where the next record starts.

        Args:
            what: Which record, for the error.
            at: Where it starts.
            length: Of its content.
            used: How many bytes of that its fields take.

        Raises:
            DamagedFileError: One of the lengths is wrong.
        """
        if used == length:
            return
        fields_end, end = at + PREFIX_BYTES + used, at + PREFIX_BYTES + length
        if used > length or self._hides(fields_end, end) or not self._is_extended(fields_end, end):
            raise DamagedFileError(
                self._window.source.name, at, f"{what} whose record and content have different lengths"
            )

    def _hides(self, fields_end: int, end: int) -> bool:
        """Whether another record is known to start between the fields of a record and its end."""
        first = bisect_left(self.places, fields_end)
        return first < len(self.places) and self.places[first] < end

    def _is_extended(self, fields_end: int, end: int) -> bool:
        """Whether a record goes on behind its fields, rather than to have a wrong length."""
        if self._fits(end):
            return True
        return self._is_opcode(end) and not self._fits(fields_end)  # the next one is where the file was cut

    def _fits(self, at: int) -> bool:
        """Whether a record that lies in the file starts somewhere, or the file ends there."""
        room = self._window.size - at
        if room < PREFIX_BYTES:
            return room == 0
        length = read_prefix(self._window.bytes(at, PREFIX_BYTES), 0)[1]
        return self._is_opcode(at) and length <= room - PREFIX_BYTES

    def _is_opcode(self, at: int) -> bool:
        if at >= self._window.size:
            return False
        opcode = self._window.bytes(at, 1)[0]
        return opcode in _KNOWN or opcode >= records.FIRST_PRIVATE

    def _take_message_index(self, at: int, length: int) -> None:
        head = self._window.content(at, length, at_most=MESSAGE_INDEX_HEAD.size)
        channel_id, entries_length = head.numbers(MESSAGE_INDEX_HEAD)
        if entries_length % ENTRY_BYTES:
            what = "a message index whose length contradicts itself"
            raise DamagedFileError(self._window.source.name, at, what)
        self._check_end("a message index", at, length, MESSAGE_INDEX_HEAD.size + entries_length)
        last = self.chunks[-1] if self.chunks else None
        if last is None or last.compression == records.LOOSE:
            return
        is_doubted = last.message_index_offsets is not self._offsets
        if is_doubted or at != last.indexes_end or channel_id in self._offsets:
            self.doubt()
            return
        self._offsets[channel_id] = at
        self._counts.setdefault(channel_id, entries_length // ENTRY_BYTES)
        end = at + PREFIX_BYTES + length
        self.chunks[-1] = replace(last, message_index_length=end - last.end, counts=self._counts)

    def _take_loose_message(self, at: int, length: int) -> None:
        head = self._window.content(at, length, at_most=MESSAGE_FIXED_BYTES)
        channel_id, _sequence, time_ns, _published_ns = head.numbers(MESSAGE_FIELDS)
        total = PREFIX_BYTES + length
        last = self.chunks[-1] if self.chunks else None
        goes_on = last is not None and last.compression == records.LOOSE and last.end == at
        if last is None or not goes_on or last.length + total > _LOOSE_BYTES:
            self.settle()
            self._offsets, self._counts = {}, {channel_id: 1}
            self.chunks.append(
                Chunk(at, total, time_ns, time_ns, records.LOOSE, total, total, indexed=False, counts=self._counts)
            )
            return
        self._counts[channel_id] = self._counts.get(channel_id, 0) + 1
        self.chunks[-1] = replace(
            last,
            length=last.length + total,
            start_ns=min(last.start_ns, time_ns),
            end_ns=max(last.end_ns, time_ns),
            compressed_size=last.length + total,
            uncompressed_size=last.length + total,
        )


def _settled(chunk: Chunk) -> Chunk:
    """Say whether the message indexes found behind a chunk are of all channels in it."""
    if chunk.compression == records.LOOSE:
        return chunk
    return replace(chunk, indexed=chunk.counts is not None and set(chunk.counts) <= set(chunk.message_index_offsets))
