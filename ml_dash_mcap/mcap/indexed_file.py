"""One opened MCAP file: its bytes, its index, its metadata, and the faults that were found in it."""

from __future__ import annotations

import threading
from collections.abc import Hashable
from dataclasses import replace
from pathlib import Path

from ..errors import DamagedFileError
from ..file_names import ABOUT_RECORD, ACTIVE_SUFFIX
from ..store.byte_source import ByteSource
from ..store.local_file import LocalFile
from . import limits, load_index, records
from .file_index import FileIndex, Glance, ReindexedError
from .losses import Loss, Losses
from .record_layout import PREFIX_BYTES, Fields, read_prefix
from .records import Opcode


class IndexedFile:
    """An MCAP file that is finished, was cut, or is still being recorded; `McapFile` reads its messages.

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
        """Open a file and index it.

        Args:
            path: Where it is.
            limits_: Limits for reading it.
            source: Its bytes, which are closed with it; None for those of the local file at `path`.
            salvages: Whether to leave out damaged parts, and note them in `losses`, rather than to raise. What is no
                MCAP file is an error all the same.

        Raises:
            MissingRecordingError: There is no such file.
            DamagedFileError: It is no MCAP file, or a finished one that is broken.
        """
        self.path = path
        is_new = path.name.endswith(ACTIVE_SUFFIX)
        self.source: ByteSource = LocalFile(path, stays_open=is_new) if source is None else source
        self.limits = limits_ = limits.of_file(limits_, self.source.stored_bytes())
        self.salvages = salvages
        self._losses = Losses()
        self._metadata: dict[int, records.Metadata | None] = {}
        self._corrected: set[int] = set()
        """The offsets of the chunks about which the index was wrong."""
        self._are_times_true = False
        """Whether the times that the index says of chunks were checked already."""
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
        """The index of the file. The index of a long file is read when it is first asked for.

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
    def glance(self) -> Glance:
        """The contents of the file without its chunks."""
        return self._glance if self._index is None and self._glance is not None else self.index.glance

    @property
    def is_loaded(self) -> bool:
        """Whether the index was asked for already."""
        return self._index is not None

    def verify(self) -> bool:
        """Read the index, whose checksum also verifies the glance; returns whether the index was still to be read.

        Raises:
            DamagedFileError: Its summary and its data section are broken.
        """
        return self._index is None and self.index is not None

    @property
    def losses(self) -> list[Loss]:
        """The damage that was found so far and left out."""
        losses = [*(self._index.losses if self._index is not None else ()), *self._losses.all()]
        # The parts that read the bytes know only the name of their source; the caller knows the file by its path.
        return [replace(loss, path=self.path) for loss in losses]

    def refresh(self, path: Path | None = None) -> bool:
        """Read the records that were written since the last look.

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
            self._forget()  # a recovery may have rewritten the file
        self._size = size
        self._index = fresh
        return fresh.end != before.end or fresh.finished

    def close(self) -> None:
        """Close the file. May be called twice."""
        self.source.close()

    def metadata(self) -> list[records.Metadata]:
        """Return all metadata records, in the order of the file. Each is read once."""
        try:
            read = [self._read_metadata(entry) for entry in self.glance.metadata]
        # The index was wrong and was replaced. That happens once at most, so the second try is the last.
        except ReindexedError:
            read = [self._read_metadata(entry) for entry in self.glance.metadata]
        return [record for record in read if record is not None]

    def metadata_named(self, name: str) -> list[records.Metadata]:
        """Return the metadata records of a name, in the order of the file."""
        read = (self._read_metadata(entry) for entry in self.glance.metadata if entry.name == name)
        return [record for record in read if record is not None]

    def about(self) -> dict[str, str]:
        """Return the values of the first `ml_dash` metadata record, which says who recorded a segment; else nothing."""
        return next((dict(record.values) for record in self.metadata() if record.name == ABOUT_RECORD), {})

    def note(self, offset: int, what: str, key: Hashable = None) -> None:
        """Note a fault of an index or of the statistics: the data are right, and nothing is lost.

        Args:
            offset: The place of the fault, or of the record that it is about.
            what: The fault, in words.
            key: A key that no other fault at the same place has; `what` by default.
        """
        self._losses.note(self.path, offset, what, key)

    def add(self, loss: Loss) -> None:
        """Take in a loss that was found by others."""
        self._losses.add((loss.offset, loss.what), loss)

    def lose(self, error: DamagedFileError, messages: int | None, key: Hashable = None) -> None:
        """Note that something could not be read, and go on; or raise, if the file is not to be salvaged.

        Args:
            error: The damage.
            messages: How many messages are lost by it; None if that is not known.
            key: A key that no other damage at the same place has.

        Raises:
            DamagedFileError: The error itself.
        """
        if not self.salvages:
            raise error
        self._losses.add((error.offset, key), Loss(self.path, error.offset, error.what, messages))

    def lose_message(self, error: DamagedFileError, channel_id: int, message: int) -> None:
        """Note that one message could not be decoded, and go on; or raise, if the file is not to be salvaged.

        Args:
            error: The damage; its place is the message's chunk.
            channel_id: Of the message.
            message: Tells it from other messages of the channel in that chunk.

        Raises:
            DamagedFileError: The error itself.
        """
        if not self.salvages:
            raise error
        loss = Loss(self.path, error.offset, error.what, 1)
        self._losses.add_message((error.offset, "message", channel_id), message, loss)

    def reindex(self, error: DamagedFileError) -> bool:
        """Index the file by its records, because its summary points to where nothing is.

        Args:
            error: The fault of the summary that was met.

        Returns:
            Whether everything that the summary knows of is there, elsewhere. If not, something is damaged.
        """
        index = self.index
        if not index.by_summary:
            return False
        scanned = load_index.by_scanning(self.source, self.limits, index)
        if any(not loss.corrected for loss in scanned.losses) or not _has_as_much(scanned, index):
            return False
        self.note(error.offset, error.what)
        self.adopt(replace(scanned, losses=index.losses))
        self._corrected.clear()
        return True

    def adopt(self, index: FileIndex) -> None:
        """Replace the index by a corrected index."""
        with self._loading_lock:
            self._index = index
            self._metadata.clear()
            self._are_times_true = True

    def begin_survey(self) -> bool:
        """Whether the times that the index says of chunks are to be checked now; each file is checked once."""
        with self._loading_lock:
            is_done, self._are_times_true = self._are_times_true, True
        return not is_done

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
        metadata = records.METADATA.read(Fields(data, name, entry.offset, PREFIX_BYTES))
        if metadata.name != entry.name:
            self.note(entry.offset, f"the metadata index says that {entry.name!r} is here, but {metadata.name!r} is")
        return metadata

    def _forget(self) -> None:
        """Forget all that was read, because the file was rewritten."""
        self._metadata.clear()
        self._losses.clear()


def _has_as_much(scanned: FileIndex, stated: FileIndex) -> bool:
    """Whether a scan found as many chunks, metadata records and attachments as a summary has."""
    pairs = (
        (scanned.chunks, stated.chunks),
        (scanned.metadata, stated.metadata),
        (scanned.attachments, stated.attachments),
    )
    return all(len(there) >= len(named) for there, named in pairs)
