"""One MCAP file: its bytes, its index, its metadata."""

from __future__ import annotations

import threading
from collections.abc import Hashable, Iterable
from pathlib import Path

import numpy as np

from ..errors import DamagedFileError
from ..layout import ACTIVE_SUFFIX
from ..ros.distros import Likely
from . import chunk as chunks
from . import decoding, distribution, limits, records
from .chunk import Messages
from .decoding import Decoding
from .fields import Bytes, Fields
from .index import FileIndex, Glance
from .load import glance, load
from .losses import Loss, Losses
from .records import Chunk, MessageIndex, Opcode
from .source import LocalFile, Source
from .unpacking import Unpacking


class File:
    """An MCAP file that is finished, was cut, or is still being recorded.

    Any thread may read; one at a time refreshes.
    """

    def __init__(
        self,
        path: Path,
        limits_: limits.Limits = limits.DEFAULT,
        *,
        salvages: bool = False,
        decoding_: Decoding = decoding.DEFAULT,
    ) -> None:
        """Open a file and index it.

        Args:
            path: Where it is.
            limits_: For what is read of it.
            salvages: Whether to leave out what is damaged, and note it in `losses`, rather than to raise. What is no
                MCAP file is an error all the same.
            decoding_: How its messages become rows.

        Raises:
            MissingRecordingError: There is no such file.
            DamagedFileError: It is no MCAP file, or a finished one that is broken.
        """
        self.path = path
        is_new = path.name.endswith(ACTIVE_SUFFIX)
        self.source: Source = LocalFile(path, stays_open=is_new)
        self.limits = limits_
        self.salvages = salvages
        self.decoding = decoding_
        self._losses = Losses()
        self._metadata: dict[int, records.Metadata | None] = {}
        self._unpacking = Unpacking(self.source, limits_)
        self._size = self.source.size()
        self._loading_lock = threading.Lock()
        """Guards the loading of `_index`."""
        self._index: FileIndex | None = None
        self._failure: DamagedFileError | None = None
        """Why the index of a long file could not be loaded."""
        self._glance: Glance | None = None
        try:
            self._glance = glance(self.source, limits_, is_new=is_new)
            if self._glance is None:
                self._index = load(self.source, limits_, is_new=is_new, salvages=salvages)
        except BaseException:
            self.source.close()
            raise

    @property
    def index(self) -> FileIndex:
        """What the file holds, and where; of a long file, read when it is first asked for.

        Raises:
            DamagedFileError: Its summary and its data section are broken.
        """
        with self._loading_lock:
            if self._failure is not None:
                raise DamagedFileError(self._failure.path, self._failure.offset, self._failure.what)
            if self._index is None:
                try:
                    self._index = load(self.source, self.limits, salvages=self.salvages)
                except DamagedFileError as error:
                    self._failure = error
                    raise
            return self._index

    @property
    def glance(self) -> Glance:
        """What is known of it without looking up its chunks."""
        return self._glance if self._index is None and self._glance is not None else self.index.glance()

    def verify(self) -> bool:
        """Read the index, whose checksum verifies what is known at a glance; returns whether that was still to be done.

        Raises:
            DamagedFileError: Its summary and its data section are broken.
        """
        return self._index is None and self.index is not None

    @property
    def losses(self) -> list[Loss]:
        """What was found damaged so far, and left out."""
        return [*(self._index.losses if self._index is not None else ()), *self._losses.all()]

    def refresh(self, path: Path | None = None) -> bool:
        """Take in what was written since.

        Args:
            path: The file's new name, if it was renamed.

        Returns:
            Whether anything changed.
        """
        if path is not None:
            self.path = path
            if isinstance(self.source, LocalFile) and not path.name.endswith(ACTIVE_SUFFIX):
                self.source.settle(path)
        before = self._index
        if before is None or before.finished:
            return False
        size = self.source.size()
        if size == self._size:
            return False
        is_new = self.path.name.endswith(ACTIVE_SUFFIX)
        fresh = load(self.source, self.limits, is_new=is_new, salvages=self.salvages, previous=before)
        if fresh.end < before.end or fresh.finished:
            self._metadata.clear()  # a recovery may have rewritten the file
            self._unpacking.forget()
            self._losses.clear()
        self._size = size
        self._index = fresh
        return fresh.end != before.end or fresh.finished

    def is_at(self, path: Path) -> bool:
        """Whether a path leads to this very file, which may have been renamed since it was opened."""
        return isinstance(self.source, LocalFile) and self.source.is_at(path)

    def metadata(self) -> list[records.Metadata]:
        """Return all metadata records, in the order of the file. Each is read once."""
        found = [self._read_metadata(entry) for entry in self.glance.metadata]
        return [record for record in found if record is not None]

    def lose(self, error: DamagedFileError, messages: int | None, key: Hashable = None) -> None:
        """Note that something could not be read, and go on; or raise, if the file is not to be salvaged.

        Args:
            error: What is wrong.
            messages: How many messages are lost by it; None if nobody knows.
            key: Tells it from whatever else is wrong at the same place.

        Raises:
            DamagedFileError: That one.
        """
        if not self.salvages:
            raise error
        self._losses.add((error.offset, key), Loss(self.path, error.offset, error.what, messages))

    def lose_message(self, error: DamagedFileError, channel_id: int, message: int) -> None:
        """Note that one message could not be decoded, and go on; or raise, if the file is not to be salvaged.

        Args:
            error: What is wrong; its place is the message's chunk.
            channel_id: Of the message.
            message: Tells it from other messages of the channel in that chunk.

        Raises:
            DamagedFileError: That one.
        """
        if not self.salvages:
            raise error
        loss = Loss(self.path, error.offset, error.what, 1)
        self._losses.add_message((error.offset, "message", channel_id), message, loss)

    def likely_distribution(self, channel: records.Channel) -> Likely:
        """Return the distributions of ROS 2 that a channel may come from."""
        named = (self._read_metadata(entry) for entry in self.glance.metadata if entry.name == distribution.RECORD)
        return distribution.likely(channel, [record for record in named if record is not None], self.path)

    def close(self) -> None:
        """Close the file. May be called twice."""
        self.source.close()

    # -- chunks --------------------------------------------------------------------------------------------------------

    def read_span(self, offset: int, length: int) -> bytes:
        """Read chunks that lie together; no bytes come if one cannot be read, which unpacking that one will say."""
        try:
            return self._unpacking.read(offset, length)
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
            DamagedFileError: They are not what they should be, whether the file is to be salvaged or not.
        """
        return self._unpacking.records(chunk, record)

    def message_index(self, chunk: Chunk, channel_id: int) -> MessageIndex:
        """Return where one channel's messages lie in a chunk; its own records are walked if that is not stored.

        Raises:
            DamagedFileError: The chunk is damaged, and the file not to be salvaged.
        """
        if chunk.indexed:
            try:
                return self._unpacking.index(chunk, channel_id)
            except DamagedFileError as error:
                self.lose(error, 0, "index")
        found = self.message_indexes(chunk, stored=False).get(channel_id)
        return found if found is not None else chunks.no_messages(channel_id)

    def message_indexes(self, chunk: Chunk, *, stored: bool = True) -> dict[int, MessageIndex]:
        """Return where each channel's messages lie in a chunk.

        Args:
            chunk: Which one.
            stored: Whether its stored indexes will do; if not, its own records are walked.

        Raises:
            DamagedFileError: The chunk is damaged, and the file not to be salvaged.
        """
        if stored and chunk.indexed:
            return {channel_id: self.message_index(chunk, channel_id) for channel_id in chunk.message_index_offsets}
        try:
            return dict(self._unpacking.scan(chunk))
        except DamagedFileError as error:
            self._lose_chunk(chunk, error)
            return {}

    def cut(
        self, chunk: Chunk, channel_ids: Iterable[int], start_ns: int, end_ns: int, span: Bytes | None = None
    ) -> list[Messages]:
        """Cut the messages of some channels and of a time range out of a chunk.

        Args:
            chunk: Which one.
            channel_ids: Of the channels; those without messages get nothing.
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
            self._lose_chunk(chunk, error)
            return []
        ids = list(channel_ids)
        if chunk.indexed:
            try:
                stored = [self._unpacking.index(chunk, one, span, chunk.offset) for one in ids]
                for index in stored:
                    chunks.check_times(index, chunk, self.source.name)
                return self._gather(chunk, data, stored, start_ns, end_ns)
            except DamagedFileError as error:
                self.lose(error, 0, "index")
        scanned = self.message_indexes(chunk, stored=False)
        found = [self._in_time(chunk, scanned[one]) for one in ids if one in scanned]
        return self._gather(chunk, data, found, start_ns, end_ns)

    def _gather(
        self, chunk: Chunk, data: bytes, found: list[MessageIndex], start_ns: int, end_ns: int
    ) -> list[Messages]:
        gathered: list[Messages] = []
        room = len(data)
        for index in found:
            wanted = chunks.within(index, start_ns, end_ns)
            if not len(wanted.offsets):
                continue
            messages = chunks.gather(data, wanted, chunk, self.source.name)
            room -= int((messages.ends - messages.offsets).sum())
            if room < 0:
                raise DamagedFileError(self.source.name, chunk.offset, "a chunk whose messages lie in each other")
            gathered.append(messages)
        return gathered

    def _in_time(self, chunk: Chunk, found: MessageIndex) -> MessageIndex:
        """Lose the messages that do not lie in the time that their chunk says: what is read when depends on it."""
        try:
            chunks.check_times(found, chunk, self.source.name)
        except DamagedFileError as error:
            inside = chunks.within(found, chunk.start_ns, chunk.end_ns)
            self.lose(error, len(found.offsets) - len(inside.offsets), ("times", found.channel_id))
            return inside
        return found

    def _lose_chunk(self, chunk: Chunk, error: DamagedFileError) -> None:
        """Lose a chunk's messages: how many its indexes know."""
        count = None if chunk.counts is None else sum(chunk.counts.values())
        if self.salvages and count is None and chunk.indexed:
            try:
                stored = [self._unpacking.index(chunk, channel_id) for channel_id in chunk.message_index_offsets]
                count = int(np.sum([len(one.offsets) for one in stored]))
            except DamagedFileError:
                count = None
        self.lose(DamagedFileError(error.path, chunk.offset, error.what), count, "chunk")

    # -- metadata ------------------------------------------------------------------------------------------------------

    def _read_metadata(self, entry: records.MetadataEntry) -> records.Metadata | None:
        if entry.offset not in self._metadata:
            try:
                self._metadata[entry.offset] = self._metadata_at(entry)
            except DamagedFileError as error:
                self.lose(error, 0, "metadata")
                self._metadata[entry.offset] = None
        return self._metadata[entry.offset]

    def _metadata_at(self, entry: records.MetadataEntry) -> records.Metadata:
        name = self.source.name
        if entry.length > self.limits.record_bytes:
            raise DamagedFileError(name, entry.offset, f"a metadata record of {entry.length} bytes")
        data = self.source.read(entry.offset, entry.length)
        length = len(data) - records.PREFIX_BYTES
        if length < 0 or records.prefix(data, 0) != (Opcode.METADATA, length):
            what = "the index says that a metadata record starts here, but none does"
            raise DamagedFileError(name, entry.offset, what)
        return records.metadata(Fields(data, name, entry.offset, records.PREFIX_BYTES))
