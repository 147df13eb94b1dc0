"""Indexes a file that has no usable summary, by going from record to record."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ..errors import DamagedFileError
from ..store.byte_source import ByteSource
from . import chunk_bytes, chunk_messages, records
from .file_index import FileIndex
from .limits import Limits
from .losses import Loss
from .record_layout import PREFIX_BYTES, read_prefix
from .records import Chunk, Header, Opcode
from .scanned_records import FileWindow, ScannedRecords
from .summary import Clues

_NOT_BEHIND_DATA = {Opcode.HEADER, Opcode.MESSAGE, Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.DATA_END}
"""Records that no file has behind its DataEnd."""

_DATA_END_BYTES = PREFIX_BYTES + 4


class FileScan:
    """One scan of a file. One thread uses it, once.

    Chunks are stepped over by their length, and looked into where nothing else tells their contents.
    """

    def __init__(
        self,
        source: ByteSource,
        size: int,
        header: Header,
        limits: Limits,
        *,
        is_new: bool = False,
        salvages: bool = False,
    ) -> None:
        """Get ready.

        Args:
            source: The file.
            size: Its size, in bytes; bytes that are appended meanwhile are left for the next scan.
            header: Its Header record.
            limits: Limits for reading.
            is_new: Whether it is in progress, so that it may end anywhere without a loss.
            salvages: Whether to step over damage and note it, rather than to stop at it.
        """
        self.source = source
        self.size = size
        self.header = header
        self.limits = limits
        self._is_new = is_new
        self.salvages = salvages
        self._window = FileWindow(source, size, limits)
        self._scanned = ScannedRecords(self._window)
        self._end = 0
        self._has_data_end = False
        self._losses: list[Loss] = []
        self.end: int | None = None
        """Where the file ends, behind its closing magic, once it was scanned; None where it does not."""

    def unfinished(self, first: int, previous: FileIndex | None = None) -> FileIndex:
        """Index the whole records of an unfinished file, up to the place where it was cut, or where it grows.

        The checksum of the last chunk is verified, because a file that a crash or a power cut ended may have its
        length and not its bytes.

        Args:
            first: Where the first record behind the header starts.
            previous: The result of an earlier scan, to go on from.
        """
        at, verified = first, 0
        if previous is not None:
            self._scanned.resume(previous)
            if previous.is_ours:
                self._scanned.read_schemas_again()
            self._losses = [loss for loss in previous.losses if first <= loss.offset < previous.end]
            at, verified = previous.end, previous.chunks[-1].end if previous.chunks else 0
        self._run(at)
        self.end = self._find_end()
        self._scanned.settle()
        self._verify_last_chunk(verified)
        self._look_inside()
        if not self._is_new and not any(loss.offset >= self._end for loss in self._losses):
            self._note_missing_end()
        return self._index(finished=False)

    def finished(self, first: int, clues: Clues | None) -> FileIndex:
        """Index a finished file whose summary does not help.

        Args:
            first: Where the first record behind the header starts.
            clues: The places and statistics of the summary; None if nothing may be lost.

        Raises:
            DamagedFileError: The data section itself is damaged, and nothing may be lost.
        """
        self._run(first, () if clues is None else clues.places)
        self.end = self._find_end()
        if not self._has_data_end and not self._losses:
            self._lose(self._end, "a data section without an end", None)
        if self._losses and clues is None:
            loss = self._losses[0]
            raise DamagedFileError(loss.path, loss.offset, loss.what)
        self._scanned.settle()
        self._look_inside(strict=clues is None)
        index = self._index(finished=True)
        if clues is not None and clues.statistics is not None:
            index = replace(index, losses=_counted(index, clues.statistics.message_count))
        return index

    def _find_end(self) -> int | None:
        """Return where the file ends, behind its closing magic; None where it does not, or the scan stopped before."""
        at = self._end
        while self._has_data_end and at + PREFIX_BYTES <= self.size:
            opcode, length = read_prefix(self._window.bytes(at, PREFIX_BYTES), 0)
            at += PREFIX_BYTES + length
            if opcode == Opcode.FOOTER:
                end = at + len(records.MAGIC)
                is_whole = end <= self.size and length == records.FOOTER_BYTES - PREFIX_BYTES
                return end if is_whole and self._window.bytes(at, len(records.MAGIC)) == records.MAGIC else None
            if not opcode:
                return None
        return None

    def _run(self, at: int, places: Sequence[int] = ()) -> None:
        """Take in whole records from `at` on until the data section or the file ends, or its soundness.

        Args:
            at: Where to start.
            places: Where else records start, sorted: the scan goes on there behind bytes that are no records.
        """
        self._scanned.places = places
        while True:
            try:
                what = self._go(at)
            except DamagedFileError as error:  # the disk cannot read it, or it was cut meanwhile
                what = error.what
            if what is None:
                return
            self._lose(self._end, what, None)
            after = bisect_right(places, self._end)
            if not self.salvages or after == len(places):
                return
            self._scanned.doubt()
            at = places[after]

    def _go(self, at: int) -> str | None:
        """Take in records; returns the fault of the record at which it stopped, or None."""
        self._end = at
        while at < self.size:
            is_short = self.size - at < PREFIX_BYTES
            opcode, length = (0, 0) if is_short else read_prefix(self._window.bytes(at, PREFIX_BYTES), 0)
            end = at + PREFIX_BYTES + length
            if is_short or (opcode and end > self.size):
                return None if self._is_new else "cut off in the middle of a record"
            if not opcode:
                return None if self._is_new else "no record starts here"
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                self._has_data_end = self._is_data_end(opcode, at, end)
                return None if self._has_data_end else "a record that ends the data section in its middle"
            try:
                self._scanned.take(opcode, at, length)
            except DamagedFileError as error:
                if not self.salvages or opcode in (Opcode.CHUNK, Opcode.MESSAGE_INDEX):
                    return error.what  # their length is wrong, so the place of the next record is unknown
                self._lose(at, error.what, 0 if opcode in (Opcode.METADATA, Opcode.ATTACHMENT) else None)
            at = self._end = end
        return None

    def _is_data_end(self, opcode: int, at: int, end: int) -> bool:
        """Whether a record that looks like the end of the data section is followed by bytes that may follow it."""
        if opcode == Opcode.FOOTER:
            is_whole = end - at == records.FOOTER_BYTES and end + len(records.MAGIC) <= self.size
            return is_whole and self._window.bytes(end, len(records.MAGIC)) == records.MAGIC
        if end - at < _DATA_END_BYTES:
            return False
        return end == self.size or self._window.bytes(end, 1)[0] not in _NOT_BEHIND_DATA

    def _verify_last_chunk(self, verified: int) -> None:
        """Check the last chunk's content; if it is broken, the file ends before it.

        Args:
            verified: Where the last chunk that was already verified ends.
        """
        chunks = self._scanned.chunks
        if not chunks or chunks[-1].compression == records.LOOSE or chunks[-1].end <= verified:
            return
        last = chunks[-1]
        try:
            self._look_into(len(chunks) - 1)
        except DamagedFileError as error:
            self._end = last.offset
            self._has_data_end = False
            self._losses = [loss for loss in self._losses if loss.offset < last.offset]
            self._lose(last.offset, error.what, _message_count(last))
            self._scanned.drop_last()

    def _look_inside(self, *, strict: bool = False) -> None:
        """Open the chunks without message indexes, and those that hold the only records of channels.

        Args:
            strict: Whether a damaged chunk is an error here, rather than when it is read.
        """
        scanned = self._scanned
        for position, chunk in enumerate(scanned.chunks):
            unknown = chunk.counts is None or not chunk.counts.keys() <= scanned.channels.keys()
            if chunk.compression == records.LOOSE or not unknown:
                continue
            try:
                self._look_into(position)
            except DamagedFileError as error:
                if strict:
                    raise
                self._lose(chunk.offset, error.what, _message_count(chunk))
                if self.salvages:
                    chunk = replace(chunk, counts={}, message_index_offsets={}, indexed=False)
                scanned.chunks[position] = replace(chunk, counts=chunk.counts or {})

    def _look_into(self, position: int) -> None:
        chunk, name = self._scanned.chunks[position], self.source.name
        try:
            chunk_bytes.check_size(chunk, name, self.limits)
            data = chunk_bytes.unpack(self.source.read(chunk.offset, chunk.length), chunk, name, self.limits)
        except chunk_bytes.LimitError:
            if not self.salvages:
                raise
            # The loss is noted when the chunk is read.
            data = chunk_bytes.read_fitting(self.source, chunk, self.limits).data
        self._scanned.learn(position, chunk_messages.scan(data, chunk, name))

    def _note_missing_end(self) -> None:
        if self._has_data_end:
            self._lose(self._end, "the file's end is damaged; all its data is there", 0)
        else:
            self._lose(self._end, "the file has no end; what lay behind this is lost", None)

    def _lose(self, offset: int, what: str, messages: int | None) -> None:
        self._losses.append(Loss(Path(self.source.name), offset, what, messages))

    def _index(self, *, finished: bool) -> FileIndex:
        scanned = self._scanned
        counts: dict[int, int] = {}
        for chunk in scanned.chunks:
            for channel_id, count in (chunk.counts or {}).items():
                counts[channel_id] = counts.get(channel_id, 0) + count
        for channel_id in counts.keys() - scanned.channels.keys():
            what = f"messages of channel {channel_id}, which no record describes"
            self._lose(self._end, what, counts.pop(channel_id))
        return FileIndex(
            path=self.source.name,
            header=self.header,
            schemas=scanned.schemas,
            schema_places=scanned.schema_places,
            channels=scanned.channels,
            chunks=scanned.chunks,
            message_counts=counts,
            metadata=tuple(scanned.metadata),
            attachments=tuple(scanned.attachments),
            finished=finished,
            size=self.size if finished else 0,
            end=self._end,
            losses=tuple(self._losses),
        )


def _message_count(chunk: Chunk) -> int | None:
    """Return how many messages a chunk has, if they were counted."""
    return None if chunk.counts is None else sum(chunk.counts.values())


def _counted(index: FileIndex, message_count: int) -> tuple[Loss, ...]:
    """Say of the one loss of unknown size how many messages it is, by how many the file once had."""
    uncounted = [loss for loss in index.losses if loss.messages is None]
    if len(uncounted) != 1:
        return index.losses
    counted = sum(loss.messages or 0 for loss in index.losses) + sum(index.message_counts.values())
    missing = message_count - counted
    return tuple(
        replace(loss, messages=missing) if loss is uncounted[0] and missing >= 0 else loss for loss in index.losses
    )
