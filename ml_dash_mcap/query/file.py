"""One MCAP file: its bytes, its index, its metadata."""

from __future__ import annotations

import threading
from collections.abc import Hashable, Iterable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..codecs import decoding
from ..codecs.decoding import Decoding
from ..codecs.ros import distribution, distros
from ..codecs.ros.distros import Likely
from ..errors import DamagedFileError
from ..file_names import ACTIVE_SUFFIX
from ..mcap import chunk_reader as chunks
from ..mcap import chunk_table, limits, load_index, records
from ..mcap.chunk_contents import Unpacking
from ..mcap.chunk_reader import Messages
from ..mcap.file_index import FileIndex, Glance, ReindexedError
from ..mcap.losses import Loss, Losses
from ..mcap.message_records import MessageIndex
from ..mcap.record_layout import PREFIX_BYTES, Bytes, Fields, read_prefix
from ..mcap.records import Chunk, Opcode
from ..store.file_source import LocalFile, Source
from . import true_records

_FEW_CHUNKS = 256
"""The message indexes of so many are read in some milliseconds."""


class File:
    """An MCAP file that is finished, was cut, or is still being recorded.

    Any thread may read; one at a time refreshes.
    """

    def __init__(
        self,
        path: Path,
        limits_: limits.Limits = limits.DEFAULT,
        *,
        source: Source | None = None,
        salvages: bool = False,
        decoding_: Decoding = decoding.DEFAULT,
    ) -> None:
        """Open a file and index it.

        Args:
            path: Where it is.
            limits_: For what is read of it.
            source: Its bytes, which are closed with it; None for those of the local file at `path`.
            salvages: Whether to leave out what is damaged, and note it in `losses`, rather than to raise. What is no
                MCAP file is an error all the same.
            decoding_: How its messages become rows.

        Raises:
            MissingRecordingError: There is no such file.
            DamagedFileError: It is no MCAP file, or a finished one that is broken.
        """
        self.path = path
        is_new = path.name.endswith(ACTIVE_SUFFIX)
        self.source: Source = LocalFile(path, stays_open=is_new) if source is None else source
        self.limits = limits_ = limits.of_file(limits_, self.source.stored_bytes())
        self.salvages = salvages
        self.decoding = decoding_
        self._losses = Losses()
        self._metadata: dict[int, records.Metadata | None] = {}
        self._unpacking = Unpacking(self.source, limits_, self._losses, self._topic_of if salvages else None)
        self._corrected: set[int] = set()
        """Where those chunks lie whose indexes were wrong."""
        self._surveyed = False
        self._size = self.source.size()
        self._loading_lock = threading.Lock()
        """Guards the loading of `_index`."""
        self._index: FileIndex | None = None
        self._failure: DamagedFileError | None = None
        """Why the index of a long file could not be loaded."""
        self._glance: Glance | None = None
        try:
            self._glance = load_index.glance(self.source, limits_, is_new=is_new)
            if self._glance is None:
                self._index = load_index.load(self.source, limits_, is_new=is_new, salvages=salvages)
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
                    self._index = load_index.load(self.source, self.limits, salvages=self.salvages)
                except DamagedFileError as error:
                    self._failure = error
                    raise
            return self._index

    @property
    def state(self) -> tuple[FileIndex, int]:
        """The index, and how many chunks it was corrected for: a plan holds as long as both stay what they are."""
        return self.index, len(self._corrected)

    @property
    def glance(self) -> Glance:
        """What is known of it without looking up its chunks."""
        return self._glance if self._index is None and self._glance is not None else self.index.glance()

    def span(self) -> tuple[int, int] | None:
        """Return the first and the last log time of its messages, in ns; None without any.

        As the statistics say it, until the index is asked for: then as far as that tells, without reading messages.
        """
        if self._index is not None:
            self.survey_few()
        said = self.glance.statistics
        if said is not None and not self._corrected:
            return (said.start_ns, said.end_ns) if said.message_count else None
        full = [chunk for chunk in self.index.chunks if chunk.counts != {} and chunk.uncompressed_size]
        return (min(one.start_ns for one in full), max(one.end_ns for one in full)) if full else None

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
        fresh = load_index.load(self.source, self.limits, is_new=is_new, salvages=self.salvages, previous=before)
        if fresh.end < before.end or fresh.finished:
            self._metadata.clear()  # a recovery may have rewritten the file
            self._unpacking.forget()
            self._losses.clear()
        self._size = size
        self._index = fresh
        return fresh.end != before.end or fresh.finished

    def metadata(self) -> list[records.Metadata]:
        """Return all metadata records, in the order of the file. Each is read once."""
        try:
            found = [self._read_metadata(entry) for entry in self.glance.metadata]
        except ReindexedError:
            found = [self._read_metadata(entry) for entry in self.glance.metadata]
        return [record for record in found if record is not None]

    def note(self, offset: int, what: str, key: Hashable = None) -> None:
        """Note that an index or the statistics say what is not so: the data are right, and nothing is lost.

        Args:
            offset: Where it lies, or what it is about.
            what: Is wrong.
            key: Tells it from whatever else is wrong at the same place; `what` by default.
        """
        self._losses.note(self.path, offset, what, key)

    def add(self, loss: Loss) -> None:
        """Take in a loss that was found by others."""
        self._losses.add((loss.offset, loss.what), loss)

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
        named = (self._read_metadata(entry) for entry in self.glance.metadata if entry.name == distros.RECORD)
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
            ReindexedError: The index was wrong about where chunks lie, and is right now.
        """
        try:
            return self._unpacking.records(chunk, record)
        except chunks.NoChunkError as error:
            if self.reindex(error):
                raise ReindexedError from error
            raise

    def is_partial(self, chunk: Chunk) -> bool:
        """Whether messages that are over the limits were left out of a chunk that was unpacked."""
        return self._unpacking.is_partial(chunk)

    def _topic_of(self, channel_id: int) -> str:
        channel = self.index.channels.get(channel_id)
        return f"channel {channel_id}" if channel is None else channel.topic

    def message_index(self, chunk: Chunk, channel_id: int) -> MessageIndex:
        """Return where one channel's messages lie in a chunk; its own records are walked if that is not stored.

        Raises:
            DamagedFileError: The chunk is damaged, and the file not to be salvaged.
        """
        if chunk.indexed and not self._unpacking.is_over(chunk):
            try:
                found = self._unpacking.index(chunk, channel_id)
                if not chunks.are_within(found, chunk):
                    self._correct(chunk)
                return found
            except DamagedFileError as error:
                self.note(error.offset, error.what, "index")
        scanned = self.message_indexes(chunk, stored=False).get(channel_id)
        return scanned if scanned is not None else chunks.no_messages(channel_id)

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
            self.lose_chunk(chunk, error)
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
            self.lose_chunk(chunk, error)
            return []
        ids = list(channel_ids)
        if chunk.indexed and not self.is_partial(chunk):
            try:
                stored = [self._unpacking.index(chunk, one, span, chunk.offset) for one in ids]
                if not all(chunks.are_within(one, chunk) for one in stored):
                    self._correct(chunk)
                return self._gather(chunk, data, stored, start_ns, end_ns)
            except DamagedFileError as error:
                self.note(error.offset, error.what, "index")
                self._correct(chunk)
        scanned = self.message_indexes(chunk, stored=False)
        found = [scanned[one] for one in ids if one in scanned]
        if not all(chunks.are_within(one, chunk) for one in found):
            self._correct(chunk)
        return self._gather(chunk, data, found, start_ns, end_ns)

    def contents(self, chunk: Chunk) -> chunks.Contents:
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
                ids = chunk.message_index_offsets
                indexes = [self._unpacking.index(chunk, one, span if is_whole else None, chunk.offset) for one in ids]
        return chunks.contents(data, indexes, chunk, self.source.name)

    # -- what indexes say wrongly --------------------------------------------------------------------------------------

    def settle(self) -> None:
        """Make the index true if its summary says how many messages there are, or when, in two ways that differ.

        That reads the whole file, once; every file whose summary agrees with itself is left alone.
        """
        if self.index.doubtful:
            true_records.audit(self, lambda chunk, contents: None)

    def survey_few(self) -> None:
        """Do what `survey` does, if the file has so few chunks that it takes hardly any time."""
        if len(self.index.chunks) <= _FEW_CHUNKS:
            self.survey()
        else:
            self.settle()

    def reindex(self, error: DamagedFileError) -> bool:
        """Index the file by its records, because its summary points to where nothing is.

        Args:
            error: What was met.

        Returns:
            Whether everything that the summary knows of is there, elsewhere. If not, something is damaged.
        """
        index = self.index
        if not index.by_summary:
            return False
        walked = load_index.by_walking(self.source, self.limits, index)
        if any(not loss.corrected for loss in walked.losses) or not _has_as_much(walked, index):
            return False
        self.note(error.offset, error.what)
        self.adopt(replace(walked, losses=index.losses))
        self._corrected.clear()
        return True

    def survey(self) -> None:
        """Make the times true that the index says of its chunks, by their message indexes; once.

        Whoever reads everything in the order of time needs that. Our own recorder's files are left alone.
        """
        self.settle()
        with self._loading_lock:
            is_done, self._surveyed = self._surveyed, True
        if is_done or not self.index.by_summary or self.index.is_ours:
            return
        for chunk in list(self.index.chunks):
            if chunk.indexed and not true_records.are_times_right(self.source, chunk, self.limits):
                self._correct(chunk)

    def adopt(self, index: FileIndex) -> None:
        """Replace the index by one that is true."""
        with self._loading_lock:
            self._index = index
            self._metadata.clear()
            self._surveyed = True

    def correct(self, chunk: Chunk, contents: chunks.Contents) -> Chunk:
        """Put what a chunk's own records say in the place of what was said about it, and note what was wrong.

        Returns:
            What is true of it.
        """
        if self.is_partial(chunk):
            return chunk
        true = true_records.of(chunk, contents)
        for key, what in true_records.differences(chunk, contents):
            self.note(chunk.offset, what, key)
        with self._loading_lock:
            self._corrected.add(chunk.offset)
            if self._index is not None and true != chunk:
                chunk_table.correct(self._index.chunks, true)
        return true

    def _correct(self, chunk: Chunk) -> None:
        """Do what `correct` does, once, if the chunk can be read."""
        if chunk.offset not in self._corrected and chunk.compression != records.LOOSE:
            with suppress(DamagedFileError):
                self.correct(chunk, self.contents(chunk))

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

    def lose_chunk(self, chunk: Chunk, error: DamagedFileError) -> None:
        """Lose a chunk's messages: how many its indexes know.

        Raises:
            DamagedFileError: The file is not to be salvaged.
        """
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
                if self.reindex(error):
                    raise ReindexedError from error
                self.lose(error, 0, "metadata")
                self._metadata[entry.offset] = None
        return self._metadata[entry.offset]

    def _metadata_at(self, entry: records.MetadataEntry) -> records.Metadata:
        name = self.source.name
        if entry.length > self.limits.record_bytes:
            raise DamagedFileError(name, entry.offset, limits.too_long("a metadata record", entry.length, self.limits))
        data = self.source.read(entry.offset, entry.length)
        length = len(data) - PREFIX_BYTES
        if length < 0 or read_prefix(data, 0) != (Opcode.METADATA, length):
            what = "the index says that a metadata record starts here, but none does"
            raise DamagedFileError(name, entry.offset, what)
        found = records.METADATA.read(Fields(data, name, entry.offset, PREFIX_BYTES))
        if found.name != entry.name:
            self.note(entry.offset, f"the metadata index says that {entry.name!r} is here, but {found.name!r} is")
        return found


def _has_as_much(walked: FileIndex, said: FileIndex) -> bool:
    """Whether a walk found as many chunks, metadata records and attachments as a summary has."""
    pairs = ((walked.chunks, said.chunks), (walked.metadata, said.metadata), (walked.attachments, said.attachments))
    return all(len(found) >= len(known) for found, known in pairs)
