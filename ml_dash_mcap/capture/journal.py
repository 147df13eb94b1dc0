"""The journal: where rows wait until they are in the file, safe from a crash of their process.

The rule of `buffer_ring` about calls and signal handlers holds here, too: "no call between".
"""

from __future__ import annotations

import os
import weakref
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from ..errors import BacklogFullError, FieldError, StorageError, TopicError
from ..options import RecorderOptions
from .buffer import Buffer
from .buffer_ring import BufferRing
from .journal_files import JournalFiles
from .room import Room
from .tracks_clock import TracksClock

_ROOM_BESIDES = 512
"""Bytes of a buffer that the prologue takes besides the topics."""


class _TooLargeError(Exception):
    """A record fits into no buffer, because the topics take more of each than when its length was looked at."""


class Journal(BufferRing):
    """The buffers of one recorder with the ways to put records into them.

    Appending threads call `add`, `add_many` and `add_metadata`. The fast path of `add` is written out in
    `Topic.append`.
    """

    def __init__(self, session: JournalFiles, options: RecorderOptions) -> None:
        """Begin the first buffer of a session."""
        super().__init__(session)
        self.options = options
        self.last_s: float | None = None
        """The latest time stamp that a track was given, in seconds."""
        self.tracks_clock = TracksClock()
        """Tells events the time."""
        self.eager: Callable[[], object] | None = None
        """Called after each `append` if the options ask for writing before a buffer is full."""
        self.room = Room(self, options)
        self._large_taken = self._large_given_back = 0
        self._definitions: dict[int, tuple[bytes, bytes]] = {}
        """The Schema and the Channel record of each topic."""
        self._changes = 0
        """How often these changed."""
        _LIVE.add(self)

    def add(self, record: bytes, topic: str, last_s: float | None) -> bool:
        """Put one Message record where the fast path found no room.

        Args:
            record: The whole record, opcode included.
            topic: The topic of the row, for messages and counts.
            last_s: Its time stamp, in seconds, if it is a track's.

        Returns:
            Whether it was taken; False only with `on_full="drop"`.

        Raises:
            StateError: The recorder is closed, or this is a forked child.
            BacklogFullError: The backlog is full and `on_full="raise"`.
            StorageError: The backlog is full and nothing can be written.
            FieldError: The row is larger than the whole backlog.
        """
        if self._fits_no_buffer(len(record)):
            return self._add_large(record, topic, last_s)
        # The opcode is put apart from the rest and last, so that a recovery never sees half a record.
        tail = record[1:]
        try:
            taken = self.room.until(lambda: self._put_row(tail, last_s), topic, 1)
        except _TooLargeError:
            return self._add_large(record, topic, last_s)
        self.room.give_way()
        return taken

    def _put_row(self, tail: bytes, last_s: float | None) -> bool:
        size = len(tail) + 1
        while True:
            active = self.active
            start = active.end
            end = start + size
            if end <= active.limit:  # no call between
                memory = active.map
                memory[start + 1 : end] = tail
                # Opcode 5, Message.
                memory[start] = 5
                active.end = end
                if last_s is not None:
                    self.last_s = last_s
                active.starts.append(start)
                return True
            if not self._rotate_for(active, size):
                return False

    def _rotate_for(self, active: Buffer, size: int) -> bool:
        """Hand over a buffer without room for a record; returns whether to look at the active buffer again.

        Raises:
            _TooLargeError: An empty buffer would have no room either.
        """
        if 0 <= active.limit < active.prologue + size:
            raise _TooLargeError
        return self.rotate(active)

    def _put_gap(self, record: bytes, is_extra: bool) -> bool:
        """Put a record that is not a Message."""
        opcode, tail, size = record[0], record[1:], len(record)
        while True:
            active = self.active
            start = active.end
            end = start + size
            if end <= active.limit:  # no call between
                memory = active.map
                memory[start + 1 : end] = tail
                memory[start] = opcode
                active.end = end
                if is_extra:
                    active.has_extras = True
                active.gaps.append((start, end, is_extra))
                return True
            if not self._rotate_for(active, size):
                return False

    def add_many(
        self, block: bytes, starts: npt.NDArray[np.int64], topic: str, last_s: float, *, is_uniform: bool
    ) -> int:
        """Put many Message records that lie one after the other.

        Args:
            block: The records.
            starts: Where in it each record starts, [N].
            topic: The topic of the rows, for messages and counts.
            last_s: The time stamp of the last row, in seconds.
            is_uniform: Whether all rows are of one form.

        Returns:
            How many were taken; fewer only with `on_full="drop"`.

        Raises:
            As `add`. The rows before the row that found no room are taken.
        """
        ends = np.append(starts[1:], len(block))
        done = refused = 0

        def put() -> bool:
            nonlocal done
            while True:
                active = self.active
                at = active.end
                offset = int(starts[done])
                fitting = int(np.searchsorted(ends, active.limit - at + offset, side="right"))
                if fitting <= done:
                    if not self._rotate_for(active, int(ends[done]) - offset):
                        return False
                    continue
                piece = block[offset : int(ends[fitting - 1])]
                tail, end = piece[1:], at + len(piece)
                row_starts = (starts[done:fitting] + (at - offset)).tolist()
                run = (len(active.starts), len(active.starts) + len(row_starts))
                if self.active is active and active.end == at:  # no call between
                    memory = active.map
                    memory[at + 1 : end] = tail
                    memory[at] = 5
                    active.end = end
                    self.last_s = last_s
                    done = fitting
                    active.starts += row_starts
                    if is_uniform:
                        active.uniform += (run,)
                    return True

        while done < len(starts):
            size = int(ends[done] - starts[done])
            is_large = self._fits_no_buffer(size)
            try:
                if not is_large and not self.room.until(put, topic, len(starts) - done):
                    break
            except _TooLargeError:
                is_large = True
            if is_large:
                refused += not self._add_large(block[int(starts[done]) : int(ends[done])], topic, last_s)
                done += 1
            self.room.give_way()
        return done - refused

    def register(self, number: int, schema: bytes, channel: bytes) -> None:
        """Take a new topic's Schema and Channel records into this buffer and all later ones.

        Args:
            number: Of the topic.
            schema: The Schema record.
            channel: The Channel record.

        Raises:
            TopicError: There are too many topics for the size of a chunk.
        """
        if not self._define(number, schema, channel, self.options.chunk_bytes // 2 - _ROOM_BESIDES):
            raise TopicError(
                f"the topics of this recording take more than half of a chunk of {self.options.chunk_bytes} bytes;"
                " set chunk_bytes= higher, or log to fewer topics"
            )
        self.room.until(lambda: self._put_gap(schema + channel, is_extra=False), "the journal", None)

    def redefine(self, number: int, schema: bytes) -> bool:
        """Take another Schema record of a topic into this buffer and all later ones.

        Returns:
            Whether it was taken; False where the topics would take more than a quarter of a chunk: the next quarter is
            for further topics.

        Raises:
            BacklogFullError: There is no room now, and the recorder does not wait.
            StateError: The recorder is closed, or this is a forked child.
            StorageError: The backlog is full and nothing can be written.
        """
        if not self._define(number, schema, self._definitions[number][1], self.options.chunk_bytes // 4):
            return False
        if not self.room.until(lambda: self._put_gap(schema, is_extra=False), "the journal", 0):
            raise BacklogFullError("the backlog has no room for a wider schema")
        return True

    def _define(self, number: int, schema: bytes, channel: bytes, most: int) -> bool:
        """Let all later buffers begin with a topic's records, unless those of all topics would take too many bytes.

        It is called before the records are put into the active buffer, because another buffer may begin meanwhile.
        """
        with self.lock:
            old = self._definitions.get(number, (b"", b""))
            growth = len(schema) + len(channel) - sum(map(len, old))
            if len(self.registry) + growth > most:
                return False
            self._definitions[number] = (schema, channel)
            self._changes += 1
            while True:
                changes = self._changes
                # Copied first: a signal handler may open a topic meanwhile.
                registry = b"".join([record for pair in list(self._definitions.values()) for record in pair])
                if self._changes == changes:  # no call between
                    self.registry = registry
                    return True

    def add_metadata(self, record: bytes) -> None:
        """Put a Metadata record; it waits for room with every value of `on_full`.

        Raises:
            FieldError: It is larger than a chunk.
        """
        if self._fits_no_buffer(len(record)):
            raise FieldError(self._metadata_size(record))
        try:
            self.room.until(lambda: self._put_gap(record, is_extra=True), "metadata", None)
        except _TooLargeError as error:
            raise FieldError(self._metadata_size(record)) from error

    def _metadata_size(self, record: bytes) -> str:
        return f"{len(record)} bytes of metadata do not fit into a chunk of {self.options.chunk_bytes}"

    def _fits_no_buffer(self, size: int) -> bool:
        return len(self.registry) + size + _ROOM_BESIDES > self.options.chunk_bytes

    def _add_large(self, record: bytes, topic: str, last_s: float | None) -> bool:
        """Put a row that is larger than a buffer into a large buffer of its own, which is sealed at once."""
        size = len(record) + len(self.registry) + 2 * _ROOM_BESIDES
        if size > self.options.backlog_bytes:
            raise FieldError(
                f"append() on topic {topic!r}: the row has {len(record)} bytes, more than the whole backlog of"
                f" {self.options.backlog_bytes} bytes; set backlog_bytes= higher"
            )
        # Two counters, each changed by one side only: appending threads take, the writer gives back.
        has_room = lambda: self._large_taken - self._large_given_back + size <= self.options.backlog_bytes  # noqa: E731
        if not self.room.until(has_room, topic, 1):
            return False
        try:
            own = self.session.make_large(size)
        except OSError as error:
            message = f"append() on topic {topic!r}: no room for a row of {size} bytes: {error.strerror}"
            raise StorageError(error.errno, message) from error
        self._large_taken += size
        try:
            taken = self.room.until(lambda: self.rotate(self.active, own, record), topic, 1)
            if taken and last_s is not None:
                self.last_s = last_s
            return taken
        finally:
            if not own.is_sealed:
                self._give_back(own)

    def _give_back(self, large: Buffer) -> None:
        self._large_given_back += large.size
        large.discard()

    def recycle(self, buffer: Buffer) -> None:
        """Take back a buffer whose rows are in the file."""
        if buffer.is_large:
            self._give_back(buffer)
        else:
            super().recycle(buffer)

    # -- the end -------------------------------------------------------------------------------------------------------

    def remove(self) -> None:
        """Delete the buffers and the session file: everything is in finished segments."""
        _LIVE.discard(self)
        self.session.remove()

    def leave_behind(self) -> None:
        """Let go of the session and keep the buffers for recovery: not everything could be written."""
        _LIVE.discard(self)
        self.session.leave_behind()


_LIVE: weakref.WeakSet[Journal] = weakref.WeakSet()


def _abandon_all() -> None:
    for journal in list(_LIVE):
        journal.abandon(
            "this recorder belongs to the parent process, which goes on recording; open one in the forked child"
        )


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_abandon_all)
