"""The journal: where rows wait until they are in the file, safe from a crash of their process.

Anything may come between two calls that a thread makes: another thread, a signal handler that appends, Ctrl-C, a
finalizer that appends. So whatever must happen together stands together without a call in it ("no call between"
below), and what was read before a call is read again after it. The lock keeps other threads out; it is one that a
handler of the same thread passes.
"""

from __future__ import annotations

import collections
import os
import queue
import threading
import time
import weakref
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from ..errors import BacklogFullError, FieldError, StateError, StorageError, TopicError
from ..file_names import JOURNAL_RECORD
from ..mcap import record_bytes
from ..options import RecorderOptions
from .buffer import Buffer
from .journal_files import SessionFiles
from .tracks_clock import TracksClock
from .turn_taking import State, Turns

_POLL_S = 0.0005
_LONGEST_WAIT_S = 3600.0

_ROOM_BESIDES = 512
"""Bytes of a buffer that the prologue takes besides the topics."""


class Journal:
    """The buffers of one recorder: one active, some sealed, some free.

    Appending threads call `add`, `add_many` and `add_metadata`; any thread `seal`; the writer thread `take` and
    `recycle`. The fast path of `add` is written out in `Topic.append`.
    """

    def __init__(self, session: SessionFiles, options: RecorderOptions) -> None:
        """Begin the first buffer of a session."""
        self.options = options
        self.session = session
        self.lock = threading.RLock()
        """Guards `active`, what is put into it, and the counters. Held for microseconds, never over I/O; the writer
        thread never waits for it."""
        self.last_s: float | None = None
        """The latest time stamp that a track was given, in seconds."""
        self.tracks_clock = TracksClock()
        """Tells events the time."""
        self.dropped: dict[str, int] = {}
        """Rows refused, by topic."""
        self.failure: Callable[[], BaseException | None] = lambda: None
        """What keeps the writer from writing at the moment, if anything; appends that cannot wait for it raise it."""
        self.eager: Callable[[], object] | None = None
        """Called after each `append`, where the options ask for writing sooner than a buffer is full."""
        self.turns = Turns()
        self.writer_ident: int | None = None
        """Which thread recycles the buffers, and so must not wait for one."""
        self._registry = b""
        self._blocks = 0
        self._sealed_rows = 0
        self._large_taken = self._large_given_back = 0
        self._sealed: queue.SimpleQueue[tuple[Buffer, ...] | int] = queue.SimpleQueue()
        self._free: collections.deque[Buffer] = collections.deque(session.buffers[1:])
        self._rotating = False
        """Whether a rotation is under way. Who holds the lock and finds it set has interrupted that rotation, and must
        not wait for what it will bring about."""
        self._shut: str | None = None
        self._nothing = Buffer(None, 0)
        self.active = session.buffers[0]
        self.active.begin(self._prologue(0, self._registry))
        _LIVE.add(self)

    def _prologue(self, block: int, registry: bytes) -> bytes:
        whose = record_bytes.metadata(JOURNAL_RECORD, {"session": self.session.name, "block": str(block)})
        return record_bytes.header("ml_dash_mcap journal") + whose + registry

    # -- appending threads -------------------------------------------------------------------------------------------

    def add(self, record: bytes, topic: str, last_s: float | None) -> bool:
        """Put one Message record where the fast path found no room.

        Args:
            record: The whole record, opcode included.
            topic: Whose row it is.
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
        tail = record[1:]
        taken = self._until(lambda: self._put_row(tail, last_s), topic, 1)
        self._give_way()
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
                memory[start] = 5
                active.end = end
                if last_s is not None:
                    self.last_s = last_s
                active.starts.append(start)
                return True
            if not self._rotate(active):
                return False

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
            if not self._rotate(active):
                return False

    def add_many(
        self, block: bytes, starts: npt.NDArray[np.int64], topic: str, last_s: float, *, is_uniform: bool
    ) -> int:
        """Put many Message records that lie one after the other.

        Args:
            block: The records.
            starts: Where in it each one starts, [N].
            topic: Whose rows they are.
            last_s: The last one's time stamp, in seconds.
            is_uniform: Whether the rows are known to be of one form.

        Returns:
            How many were taken; fewer only with `on_full="drop"`.

        Raises:
            As `add`; the rows before the one that found no room are taken.
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
                    if not self._rotate(active):
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
            if self._fits_no_buffer(size):
                refused += not self._add_large(block[int(starts[done]) : int(ends[done])], topic, last_s)
                done += 1
            elif not self._until(put, topic, len(starts) - done):
                break
            self._give_way()
        return done - refused

    def register(self, definition: bytes) -> None:
        """Take a new topic's Schema and Channel records into this buffer and all later ones.

        Raises:
            TopicError: There are too many topics for the size of a chunk.
        """
        if len(self._registry) + len(definition) > self.options.chunk_bytes // 2:
            raise TopicError(
                f"the topics of this recording take more than half of a chunk of {self.options.chunk_bytes} bytes;"
                " set chunk_bytes= higher, or log to fewer topics"
            )

        with self.lock:
            self._registry += definition  # first: a buffer that begins meanwhile must have it
        self._until(lambda: self._put_gap(definition, is_extra=False), "the journal", None)

    def add_metadata(self, record: bytes) -> None:
        """Put a Metadata record; it waits for room, whatever `on_full` says.

        Raises:
            FieldError: It is larger than a chunk.
        """
        if self._fits_no_buffer(len(record)):
            raise FieldError(f"{len(record)} bytes of metadata do not fit into a chunk of {self.options.chunk_bytes}")
        self._until(lambda: self._put_gap(record, is_extra=True), "metadata", None)

    def _fits_no_buffer(self, size: int) -> bool:
        return len(self._registry) + size + _ROOM_BESIDES > self.options.chunk_bytes

    def _add_large(self, record: bytes, topic: str, last_s: float | None) -> bool:
        """Give a row that is larger than a buffer one of its own, sealed at once."""
        size = len(record) + len(self._registry) + 2 * _ROOM_BESIDES
        if size > self.options.backlog_bytes:
            raise FieldError(
                f"append() on topic {topic!r}: the row has {len(record)} bytes, more than the whole backlog of"
                f" {self.options.backlog_bytes} bytes; set backlog_bytes= higher"
            )
        has_room = lambda: self._large_taken - self._large_given_back + size <= self.options.backlog_bytes  # noqa: E731
        if not self._until(has_room, topic, 1):
            return False
        try:
            own = self.session.make_large(size)
        except OSError as error:
            what = f"append() on topic {topic!r}: no room for a row of {size} bytes: {error.strerror}"
            raise StorageError(error.errno, what) from error
        self._large_taken += size
        try:
            taken = self._until(lambda: self._rotate(self.active, own, record), topic, 1)
            if taken and last_s is not None:
                self.last_s = last_s
            return taken
        finally:
            if not own.is_sealed:
                self._give_back(own)

    def _give_back(self, large: Buffer) -> None:
        self._large_given_back += large.size
        large.discard()

    # -- room ----------------------------------------------------------------------------------------------------------

    def _until(self, put: Callable[[], bool], topic: str, rows: int | None) -> bool:
        """Try to put something, and do what `on_full` says while there is no room.

        Args:
            put: Called with the lock held; says whether there was room.
            topic: For the error messages and counts.
            rows: How many rows are refused if it comes to that; None always waits.
        """
        while True:
            with self.lock:
                if self._shut is not None:
                    raise StateError(self._shut)
                if put():
                    return True
                failure = self.failure()
                is_refused = self._cannot_wait() or (rows is not None and self._may_refuse(failure))
                if rows is not None and is_refused:
                    self.dropped[topic] = self.dropped.get(topic, 0) + rows
            if is_refused:
                return self._refuse(topic, failure)
            self.turns.hurry()
            time.sleep(_POLL_S)  # what else can be waited on has a lock that a signal handler would wait for, too

    def _cannot_wait(self) -> bool:
        """Whether waiting would be for ever: in a signal handler or finalizer that interrupted who makes room."""
        return self._rotating or threading.get_ident() == self.writer_ident

    def _may_refuse(self, failure: BaseException | None) -> bool:
        return self.options.on_full != "block" or failure is not None

    def _refuse(self, topic: str, failure: BaseException | None) -> bool:
        what = f"append() on topic {topic!r}: the backlog of {self.options.backlog_bytes} bytes is full"
        if self.options.on_full == "drop":
            return False
        if failure is not None and self.options.on_full == "block":
            raise StorageError(f"{what} and the recording cannot be written ({failure}); not taken") from failure
        raise BacklogFullError(f"{what}; not taken")

    def _give_way(self) -> None:
        """Let the writer have the interpreter for a moment."""
        if self.options.on_full == "block" and not self._cannot_wait():
            self.turns.stand_back(self._sealed_rows, self._sealed.qsize)

    # -- sealing -------------------------------------------------------------------------------------------------------

    def seal(self) -> bool:
        """Hand what is in the active buffer to the writer; returns whether there is nothing left in it."""
        with self.lock:
            active = self.active
            if active.limit < 0 or not (active.starts or active.has_extras):
                return True
            return self._rotate(active)

    def seal_within(self, timeout_s: float) -> None:
        """Do the same if the lock can be had in time and a buffer is free. For the writer thread, which no Ctrl-C hits.

        Args:
            timeout_s: How long to wait for the lock, in seconds.
        """
        if self.lock.acquire(timeout=timeout_s):
            try:
                self.seal()
            finally:
                self.lock.release()

    def seal_at(self, rows: int) -> Callable[[], object]:
        """Return what seals the active buffer once so many rows are in it."""
        return lambda: len(self.active.starts) >= rows and self.seal()

    def _rotate(self, full: Buffer, own: Buffer | None = None, record: bytes = b"") -> bool:
        """Hand the active buffer over and begin a free one, if there is one. Called with the lock held.

        Args:
            full: The active buffer, as the caller saw it. If it is that no more, somebody else has done this.
            own: A buffer to hand over right behind it, for a row of its own.
            record: That row's Message record.

        Returns:
            Whether it is worth while to look at the active buffer again; with `own`, whether that is handed over.
        """
        free, is_nested, is_used = self._free, self._rotating, False
        if not free:
            return False
        self._rotating = True
        fresh = free[0]
        del free[0]
        try:  # no call since `free` was looked at
            end, registry, put = full.end, self._registry, self._sealed.put
            rows, blocks = self._sealed_rows + len(full.starts), self._blocks + bool(full.starts)
            sealed: tuple[Buffer, ...] = (full,)
            if own is not None:
                _fill_large(own, self._prologue(blocks, registry), record)
                sealed, rows, blocks = (full, own), rows + 1, blocks + 1
            fresh.begin(self._prologue(blocks, registry))
            if self.active is full and full.end == end and self._registry is registry:  # no call between
                self._blocks = blocks
                self._sealed_rows = rows
                self.active = fresh
                is_used = True
                if own is not None:
                    own.is_sealed = True
                put(sealed)
        finally:
            self._rotating = is_nested
            if not is_used:
                fresh.map[0] = 0
                free += (fresh,)
        return is_used or own is None

    def rows(self) -> int:
        """Return how many rows were taken so far."""
        with self.lock:
            return self._sealed_rows + len(self.active.starts)

    # -- the writer thread ---------------------------------------------------------------------------------------------

    def take(self, timeout_s: float) -> tuple[Buffer, ...] | int | None:
        """Return the next sealed buffers or mark, or None after a while without one."""
        if self._sealed.empty():
            self.turns.is_hurried = False
        self.turns.writer = State.RESTING
        try:
            return self._sealed.get(timeout=min(max(timeout_s, 0.0), _LONGEST_WAIT_S))
        except queue.Empty:
            return None
        finally:
            self.turns.writer = State.RUNNING

    def mark(self, number: int, *, is_awaited: bool = True) -> None:
        """Put a mark behind all that is sealed; `take` returns it when it comes to it.

        Args:
            number: The mark.
            is_awaited: Whether somebody waits until it is reached.
        """
        self._sealed.put(number)
        if is_awaited:
            self.turns.hurry()

    def recycle(self, buffer: Buffer) -> None:
        """Take back a buffer whose rows are in the file."""
        if buffer.is_large:
            self._give_back(buffer)
        else:
            buffer.clear()
            self._free.append(buffer)

    # -- the end -------------------------------------------------------------------------------------------------------

    @property
    def is_shut(self) -> bool:
        """Whether it takes no more rows."""
        return self._shut is not None

    def check_open(self) -> None:
        """Raise StateError if it takes no more rows."""
        if self._shut is not None:
            raise StateError(self._shut)

    def shut(self, why: str) -> None:
        """Take no more rows; every later append raises `why`. What is in the active buffer is handed over."""
        put = self._sealed.put
        with self.lock:
            if self._shut is None:
                self._shut = why
                last = self.active
                rows = self._sealed_rows + len(last.starts)
                self._sealed_rows = rows
                self.active = self._nothing
                put((last,))

    def remove(self) -> None:
        """Delete the buffers and the session file: everything is in finished segments."""
        _LIVE.discard(self)
        self.session.remove()

    def leave_behind(self) -> None:
        """Let go of the session and keep the buffers for recovery: not everything could be written."""
        _LIVE.discard(self)
        self.session.leave_behind()

    def abandon_in_child(self) -> None:
        """Forget the parent's recording in a forked child, touching none of it."""
        self.lock = threading.RLock()
        self._shut = (
            "this recorder belongs to the parent process, which goes on recording; open one in the forked child"
        )
        self.active = self._nothing
        self.session.leave_behind()


def _fill_large(own: Buffer, prologue: bytes, record: bytes) -> None:
    """Put the one row of a large buffer into it, again if that was interrupted."""
    own.starts.clear()
    own.begin(prologue)
    start, own.end = own.end, own.end + len(record)
    own.map[start + 1 : own.end] = record[1:]
    own.map[start] = record[0]
    own.starts.append(start)


_LIVE: weakref.WeakSet[Journal] = weakref.WeakSet()


def _abandon_all() -> None:
    for journal in list(_LIVE):
        journal.abandon_in_child()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_abandon_all)
