"""Reads the messages of one MCAP file: by the indexes of its chunks, or by a scan where those are wrong."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import numpy as np

from ..errors import DamagedFileError
from ..store.byte_source import ByteSource
from . import chunk_messages, chunk_table, limits, records
from .chunk_bytes import NoChunkError
from .chunk_messages import ChunkContents, Messages
from .file_chunks import FileChunks
from .file_index import FileIndex, ReindexedError
from .indexed_file import IndexedFile
from .message_records import MessageIndex
from .record_layout import Bytes
from .records import Chunk


class McapFile(IndexedFile):
    """An MCAP file that is finished, was cut, or is still being recorded.

    Any thread may read; one at a time refreshes.
    """

    def __init__(
        self,
        path: Path,
        limits_: limits.Limits = limits.DEFAULT,
        *,
        source: ByteSource | None = None,
        salvages: bool = False,
    ) -> None:
        """Open a file and index it; the arguments and errors are those of `IndexedFile`."""
        super().__init__(path, limits_, source=source, salvages=salvages)
        self._chunks = FileChunks(self.source, self.limits, self._losses, self._topic_of if salvages else None)

    # -- chunks --------------------------------------------------------------------------------------------------------

    def read_span(self, offset: int, length: int) -> bytes:
        """Read chunks that lie together; no bytes come if one cannot be read, which unpacking that one will say."""
        try:
            return self._chunks.read(offset, length)
        except DamagedFileError:
            if not self.salvages:
                raise
            return b""

    def unpack(self, chunk: Chunk, record: Bytes | None = None) -> bytes:
        """Return a chunk's records, uncompressed and checked; the last few are kept.

        Args:
            chunk: Which one.
            record: Its bytes, if they have been read already.

        Raises:
            DamagedFileError: They are damaged, whether the file is to be salvaged or not.
            ReindexedError: The index was wrong about where chunks lie, and is right now.
        """
        try:
            return self._chunks.records(chunk, record)
        except NoChunkError as error:
            if self.reindex(error):
                raise ReindexedError from error
            raise

    def is_partial(self, chunk: Chunk) -> bool:
        """Whether messages that are over the limits were left out of a chunk that was unpacked."""
        return self._chunks.is_partial(chunk)

    def _topic_of(self, channel_id: int) -> str:
        channel = self.index.channels.get(channel_id)
        return f"channel {channel_id}" if channel is None else channel.topic

    def message_index(self, chunk: Chunk, channel_id: int) -> MessageIndex:
        """Return where one channel's messages lie in a chunk; its own records are scanned if that is not stored.

        Raises:
            DamagedFileError: The chunk is damaged, and the file not to be salvaged.
        """
        if chunk.indexed and not self._chunks.is_over(chunk):
            try:
                index = self._chunks.index(chunk, channel_id)
                if not chunk_messages.are_within(index, chunk):
                    self.correct_once(chunk)
                return index
            except DamagedFileError as error:
                self.note(error.offset, error.what, "index")
        scanned = self.message_indexes(chunk, stored=False).get(channel_id)
        return scanned if scanned is not None else chunk_messages.no_messages(channel_id)

    def message_indexes(self, chunk: Chunk, *, stored: bool = True) -> dict[int, MessageIndex]:
        """Return where each channel's messages lie in a chunk.

        Args:
            chunk: Which one.
            stored: Whether its stored indexes will do; if not, its own records are scanned.

        Raises:
            DamagedFileError: The chunk is damaged, and the file not to be salvaged.
        """
        if stored and chunk.indexed:
            return {channel_id: self.message_index(chunk, channel_id) for channel_id in chunk.message_index_offsets}
        try:
            return dict(self._chunks.scan(chunk))
        except DamagedFileError as error:
            self.lose_chunk(chunk, error)
            return {}

    def only_message(self, chunk: Chunk, channel_id: int, start_ns: int, end_ns: int) -> tuple[int, bytes] | None:
        """Return the log time and the payload of the only message of a channel in a chunk and in [start_ns, end_ns].

        None if there is not exactly one, or if anything about it is odd: `cut` says what, and reads around it.
        """
        if not chunk.indexed or self.is_partial(chunk):
            return None
        try:
            index = self._chunks.index(chunk, channel_id)
            if not chunk_messages.are_within(index, chunk):
                return None
            return chunk_messages.only_message(self.unpack(chunk), index, start_ns, end_ns)
        except DamagedFileError:
            return None

    def cut(
        self, chunk: Chunk, channel_ids: Iterable[int], start_ns: int, end_ns: int, span: Bytes | None = None
    ) -> list[Messages]:
        """Cut the messages of some channels and of a time range out of a chunk.

        Args:
            chunk: Which one.
            channel_ids: The ids of the channels. Channels without messages get nothing.
            start_ns: First log time, in ns.
            end_ns: Last log time, included, in ns.
            span: The chunk's bytes and those of its message indexes, if they have been read already.

        Raises:
            DamagedFileError: Something is damaged, and the file not to be salvaged.
        """
        if span is not None and len(span) < chunk.length + chunk.message_index_length:
            span = None
        try:
            data = self.unpack(chunk, None if span is None else span[: chunk.length])
        except DamagedFileError as error:
            self.lose_chunk(chunk, error)
            return []
        ids = list(channel_ids)
        if chunk.indexed and not self.is_partial(chunk):
            try:
                stored = [self._chunks.index(chunk, channel_id, span, chunk.offset) for channel_id in ids]
                if not all(chunk_messages.are_within(index, chunk) for index in stored):
                    self.correct_once(chunk)
                return chunk_messages.gather_each(data, stored, chunk, self.source.name, start_ns, end_ns)
            except DamagedFileError as error:
                self.note(error.offset, error.what, "index")
                self.correct_once(chunk)
        scanned = self.message_indexes(chunk, stored=False)
        indexes = [scanned[channel_id] for channel_id in ids if channel_id in scanned]
        if not all(chunk_messages.are_within(index, chunk) for index in indexes):
            self.correct_once(chunk)
        return chunk_messages.gather_each(data, indexes, chunk, self.source.name, start_ns, end_ns)

    def contents(self, chunk: Chunk) -> ChunkContents:
        """Return all that a chunk holds, by its own records, and whether its message indexes say the same.

        Raises:
            DamagedFileError: It is damaged, whether the file is to be salvaged or not.
        """
        span = self.read_span(chunk.offset, chunk.length + chunk.message_index_length)
        is_whole = len(span) == chunk.length + chunk.message_index_length
        data = self.unpack(chunk, span[: chunk.length] if is_whole else None)
        indexes: list[MessageIndex] | None = None
        if chunk.indexed and not self.is_partial(chunk):
            with suppress(DamagedFileError):
                bytes_of_chunk = span if is_whole else None
                indexes = [
                    self._chunks.index(chunk, channel_id, bytes_of_chunk, chunk.offset)
                    for channel_id in chunk.message_index_offsets
                ]
        return chunk_messages.contents(data, indexes, chunk, self.source.name)

    # -- what indexes say wrongly --------------------------------------------------------------------------------------

    @property
    def state(self) -> tuple[FileIndex, int]:
        """The index, and how many chunks it was corrected for: a plan holds as long as both stay what they are."""
        return self.index, len(self._corrected)

    @property
    def is_corrected(self) -> bool:
        """Whether the index was wrong about a chunk."""
        return bool(self._corrected)

    def correct(self, chunk: Chunk, contents: ChunkContents) -> Chunk:
        """Correct a chunk's index entry by its own records, and note the faults.

        Returns:
            The corrected entry.
        """
        if self.is_partial(chunk):
            return chunk
        true = contents.corrected(chunk)
        for key, what in contents.differences(chunk):
            self.note(chunk.offset, what, key)
        with self._loading_lock:
            self._corrected.add(chunk.offset)
            if self._index is not None and true != chunk:
                chunk_table.correct(self._index.chunks, true)
        return true

    def correct_once(self, chunk: Chunk) -> None:
        """Correct a chunk's entry as `correct` does, once for each chunk, if the chunk can be read."""
        if chunk.offset not in self._corrected and chunk.compression != records.LOOSE:
            with suppress(DamagedFileError):
                self.correct(chunk, self.contents(chunk))

    def lose_chunk(self, chunk: Chunk, error: DamagedFileError) -> None:
        """Lose a chunk's messages: how many its indexes know.

        Raises:
            DamagedFileError: The file is not to be salvaged.
        """
        count = None if chunk.counts is None else sum(chunk.counts.values())
        if self.salvages and count is None and chunk.indexed:
            try:
                stored = [self._chunks.index(chunk, channel_id) for channel_id in chunk.message_index_offsets]
                count = int(np.sum([len(index.offsets) for index in stored]))
            except DamagedFileError:
                count = None
        self.lose(DamagedFileError(error.path, chunk.offset, error.what), count, "chunk")

    def _forget(self) -> None:
        super()._forget()
        self._chunks.forget()
