"""The index of a file without a usable summary, by walking from record to record."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from ..errors import DamagedFileError
from . import chunk as chunks
from . import records
from .fields import Fields
from .index import FileIndex
from .limits import Limits
from .records import Chunk, Header, Opcode
from .source import Source

_WINDOW_BYTES = 16 * 1024
_LOOSE_BYTES = 4 * 1024 * 1024
"""Messages outside chunks are taken together up to this many bytes."""


def walk(
    source: Source, size: int, header: Header, first: int, limits: Limits, previous: FileIndex | None
) -> FileIndex:
    """Index what lies whole in an unfinished file: everything up to where it was cut, or to where it grows.

    Chunks are stepped over by their length. The checksum of the last one is verified, because a file that a crash
    or a power cut ended may have its length and not its bytes.

    Args:
        source: The file.
        size: Its size, in bytes; what is appended meanwhile is left for the next walk.
        header: Its Header record.
        first: Where the first record behind the header starts.
        limits: For what is read.
        previous: An earlier walk's result, to go on from.
    """
    walker = _Walker(source, size, limits)
    at = first
    if previous is not None:
        at = walker.resume(previous)
    walker.run(at)
    return walker.result(header, previous)


def walk_finished(source: Source, size: int, header: Header, first: int, limits: Limits) -> FileIndex:
    """Index a finished file whose summary does not help.

    Raises:
        DamagedFileError: The data section itself is damaged.
    """
    walker = _Walker(source, size, limits)
    walker.run(first)
    if walker.damage is not None or not walker.at_data_end:
        raise DamagedFileError(source.name, walker.end, walker.damage or "a data section without an end")
    walker.read_inside_chunks(strict=True)
    return replace(walker.index(header), finished=True)


@dataclass
class _Walker:
    source: Source
    size: int
    limits: Limits
    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    chunks: list[Chunk] = field(default_factory=list)
    metadata: list[records.MetadataEntry] = field(default_factory=list)
    attachments: list[records.AttachmentEntry] = field(default_factory=list)
    end: int = 0
    damage: str | None = None
    at_data_end: bool = False
    _window: bytes = b""
    _window_at: int = 0

    def resume(self, previous: FileIndex) -> int:
        """Take over what an earlier walk found; returns where it stopped."""
        self.schemas.update(previous.schemas)
        self.channels.update(previous.channels)
        self.chunks.extend(previous.chunks)
        self.metadata.extend(previous.metadata)
        self.attachments.extend(previous.attachments)
        return previous.end

    def run(self, at: int) -> None:
        """Take whole records from `at` on until the data section, the file or its soundness ends."""
        self.end = at
        while at < self.size:
            if self.size - at < records.PREFIX_BYTES:
                self.damage = f"cut off in the middle of a record at byte {at}"
                return
            opcode, length = records.prefix(self._bytes(at, records.PREFIX_BYTES), 0)
            end = at + records.PREFIX_BYTES + length
            if opcode == 0:
                self.damage = f"no record at byte {at}"
                return
            if end > self.size:
                self.damage = f"cut off in the middle of a record at byte {at}"
                return
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                self.at_data_end = True
                return
            try:
                self._take(opcode, at, length)
            except DamagedFileError as error:
                self.damage = str(error)
                return
            at = self.end = end

    def read_inside_chunks(self, *, strict: bool) -> None:
        """Open the chunks whose messages nobody has indexed, or that hold the records of channels we need.

        Args:
            strict: Whether a damaged one is an error here, rather than when somebody reads it.
        """
        for position, chunk in enumerate(self.chunks):
            unknown = chunk.counts is None or not set(chunk.counts) <= set(self.channels)
            if chunk.compression == records.LOOSE or not unknown:
                continue
            try:
                self.chunks[position] = self._look_into(chunk)
            except DamagedFileError as error:
                if strict:
                    raise
                self.damage = str(error)
                self.chunks[position] = replace(chunk, counts=chunk.counts or {})

    def verify_last_chunk(self, verified: int) -> None:
        """Check the last chunk's content; if it is broken, the file ends before it.

        Args:
            verified: Where the last chunk that was already verified ends.
        """
        if not self.chunks or self.chunks[-1].compression == records.LOOSE:
            return
        last = self.chunks[-1]
        try:
            if last.end > verified:
                self.chunks[-1] = self._look_into(last)
            else:
                self.chunks[-1] = replace(last, indexed=_covers(last))
        except DamagedFileError as error:
            self.damage = str(error)
            self.end = last.offset
            self.at_data_end = False
            self.chunks.pop()
            self.metadata = [entry for entry in self.metadata if entry.offset < self.end]
            self.attachments = [entry for entry in self.attachments if entry.offset < self.end]

    def index(self, header: Header) -> FileIndex:
        """Return what was found."""
        counts: dict[int, int] = {}
        for chunk in self.chunks:
            for channel_id, count in (chunk.counts or {}).items():
                counts[channel_id] = counts.get(channel_id, 0) + count
        return FileIndex(
            path=self.source.name,
            header=header,
            schemas=self.schemas,
            channels=self.channels,
            chunks=tuple(self.chunks),
            message_counts=counts,
            metadata=tuple(self.metadata),
            attachments=tuple(self.attachments),
            finished=False,
            end=self.end,
            damage=self.damage,
        )

    def result(self, header: Header, previous: FileIndex | None) -> FileIndex:
        """Verify, look where looking is needed, and return what an unfinished file holds."""
        verified = previous.chunks[-1].end if previous is not None and previous.chunks else 0
        self.verify_last_chunk(verified)
        self.read_inside_chunks(strict=False)
        return self.index(header)

    def _look_into(self, chunk: Chunk) -> Chunk:
        record = self.source.read(chunk.offset, chunk.length)
        found = chunks.scan(chunks.unpack(record, chunk, self.source.name, self.limits), chunk, self.source.name)
        for schema_id, schema in found.schemas.items():
            self.schemas.setdefault(schema_id, schema)
        for channel_id, channel in found.channels.items():
            self.channels.setdefault(channel_id, channel)
        complete = replace(chunk, counts=found.counts)
        return replace(complete, indexed=_covers(complete))

    def _take(self, opcode: int, at: int, length: int) -> None:
        if opcode == Opcode.CHUNK:
            self._take_chunk(at, length)
        elif opcode == Opcode.MESSAGE_INDEX:
            self._take_message_index(at, length)
        elif opcode == Opcode.MESSAGE:
            self._take_loose_message(at, length)
        elif opcode == Opcode.SCHEMA:
            schema = records.schema(self._content(at, length))
            self.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = records.channel(self._content(at, length))
            self.channels[channel.id] = channel
        elif opcode == Opcode.METADATA:
            name = records.metadata(self._content(at, length)).name
            self.metadata.append(records.MetadataEntry(name, at, records.PREFIX_BYTES + length))
        elif opcode == Opcode.ATTACHMENT:
            start = self._content(at, length, at_most=_WINDOW_BYTES)
            self.attachments.append(records.attachment(start, at, records.PREFIX_BYTES + length))

    def _take_chunk(self, at: int, length: int) -> None:
        head = records.chunk_head(self._content(at, length, at_most=records.CHUNK_HEAD_BYTES))
        if head.records_at + head.records_length != length:
            raise DamagedFileError(self.source.name, at, "a chunk whose record and content have different lengths")
        self.chunks.append(
            Chunk(
                offset=at,
                length=records.PREFIX_BYTES + length,
                start_ns=head.start_ns,
                end_ns=head.end_ns,
                compression=head.compression,
                compressed_size=head.records_length,
                uncompressed_size=head.uncompressed_size,
                indexed=False,
            )
        )

    def _take_message_index(self, at: int, length: int) -> None:
        fields = self._content(at, length, at_most=6)
        channel_id, entries_length = fields.u16(), fields.u32()
        if entries_length > length - 6 or entries_length % 16:
            raise DamagedFileError(self.source.name, at, "a message index whose length contradicts itself")
        if not self.chunks or self.chunks[-1].compression == records.LOOSE:
            return
        chunk = self.chunks[-1]
        grown = replace(
            chunk,
            message_index_offsets={**chunk.message_index_offsets, channel_id: at},
            message_index_length=at + records.PREFIX_BYTES + length - chunk.end,
            counts={**(chunk.counts or {}), channel_id: entries_length // 16},
        )
        self.chunks[-1] = replace(grown, indexed=_covers(grown))

    def _take_loose_message(self, at: int, length: int) -> None:
        fields = self._content(at, length, at_most=22)
        channel_id, _sequence, time_ns = fields.u16(), fields.u32(), fields.u64()
        fields.u64()
        total = records.PREFIX_BYTES + length
        last = self.chunks[-1] if self.chunks else None
        if (
            last is None
            or last.compression != records.LOOSE
            or last.end != at
            or last.length + total > _LOOSE_BYTES
            or last.counts is None
        ):
            self.chunks.append(
                Chunk(at, total, time_ns, time_ns, records.LOOSE, total, total, indexed=False, counts={channel_id: 1})
            )
            return
        self.chunks[-1] = replace(
            last,
            length=last.length + total,
            start_ns=min(last.start_ns, time_ns),
            end_ns=max(last.end_ns, time_ns),
            compressed_size=last.length + total,
            uncompressed_size=last.length + total,
            counts={**last.counts, channel_id: last.counts.get(channel_id, 0) + 1},
        )

    def _content(self, at: int, length: int, at_most: int | None = None) -> Fields:
        """Return a record's content, or only its first bytes."""
        if at_most is not None:
            length = min(length, at_most)
        if length > self.limits.record_bytes:
            raise DamagedFileError(
                self.source.name, at, f"a record of {length} bytes; the limit is {self.limits.record_bytes}"
            )
        start = at + records.PREFIX_BYTES
        return Fields(self._bytes(start, length), self.source.name, start)

    def _bytes(self, at: int, length: int) -> bytes:
        offset = at - self._window_at
        if offset < 0 or offset + length > len(self._window):
            wanted = min(max(length, _WINDOW_BYTES), self.size - at)
            self._window = self.source.read(at, wanted)
            self._window_at = at
            offset = 0
            if len(self._window) < length:
                raise DamagedFileError(self.source.name, at, "the file was cut while it was read")
        return self._window[offset : offset + length]


def _covers(chunk: Chunk) -> bool:
    """Whether the message indexes found behind a chunk are of all channels in it."""
    return chunk.counts is not None and set(chunk.counts) <= set(chunk.message_index_offsets)
