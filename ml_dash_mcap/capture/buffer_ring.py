"""The buffers of one recorder and how they change hands: active, sealed, free again.

Anything may come between two calls that a thread makes: another thread, a signal handler that appends, Ctrl-C, a
finalizer that appends. So statements that must happen together have no call between them ("no call between" below),
and values that were read before a call are read again after it. The lock keeps other threads out; a handler of the
same thread passes it.
"""

from __future__ import annotations

import collections
import queue
import threading
from collections.abc import Callable

from ..errors import StateError
from ..file_names import JOURNAL_RECORD
from ..mcap.records import METADATA, Metadata, file_start
from .buffer import Buffer
from .journal_files import JournalFiles
from .turn_taking import State, Turns

# A queue raises OverflowError for a timeout beyond what the system's clock holds, and intervals may be that long.
_LONGEST_WAIT_S = 3600.0


class BufferRing:
    """One active buffer, some sealed, some free.

    Any thread calls `seal` and `rows`, the writer thread `take` and `recycle`.
    """

    def __init__(self, session: JournalFiles) -> None:
        """Begin the first buffer of a session."""
        self.session = session
        self.lock = threading.RLock()
        """Guards `active`, the records in it, and the counters. Held for microseconds, never over I/O; the writer
        thread waits for it for milliseconds at most."""
        self.turns = Turns()
        self.writer_ident: int | None = None
        """The id of the thread that recycles the buffers. It must not wait for a free buffer."""
        self.registry = b""
        """The Schema and Channel records of all topics, with which every buffer begins."""
        self._blocks = 0
        self._sealed_rows = 0
        # SimpleQueue, because its put() may be interrupted by a signal handler that puts, too. Queue has a lock: the
        # handler would wait for ever for the thread that it interrupted.
        self._sealed: queue.SimpleQueue[tuple[Buffer, ...] | int] = queue.SimpleQueue()
        self._free: collections.deque[Buffer] = collections.deque(session.buffers[1:])
        self._rotating = False
        """Whether a rotation is under way. Code that holds the lock and sees this has interrupted the rotation, and
        must not wait for its result."""
        self._shut: str | None = None
        self._nothing = Buffer(None, 0)
        self.active = session.buffers[0]
        self.active.begin(self._prologue(0, self.registry))

    def _prologue(self, block: int, registry: bytes) -> bytes:
        owner = METADATA.pack(Metadata(JOURNAL_RECORD, {"session": self.session.name, "block": str(block)}))
        return file_start("ml_dash_mcap journal") + owner + registry

    # -- sealing -------------------------------------------------------------------------------------------------------

    def seal(self) -> bool:
        """Hand the rows in the active buffer to the writer; returns whether nothing is left in it."""
        with self.lock:
            active = self.active
            if active.limit < 0 or not (active.starts or active.has_extras):
                return True
            return self.rotate(active)

    def seal_within(self, timeout_s: float) -> None:
        """Seal the active buffer if the lock is free in time and a free buffer is there. For the writer thread only.

        Args:
            timeout_s: How long to wait for the lock, in seconds.
        """
        if self.lock.acquire(timeout=timeout_s):
            try:
                self.seal()
            finally:
                self.lock.release()

    def seal_at(self, rows: int) -> Callable[[], object]:
        """Return a function that seals the active buffer once it has so many rows."""
        return lambda: len(self.active.starts) >= rows and self.seal()

    def rotate(self, full: Buffer, own: Buffer | None = None, record: bytes = b"") -> bool:
        """Hand the active buffer over and begin a free one, if there is one. Called with the lock held.

        Args:
            full: The active buffer, as the caller saw it. If another buffer is active, somebody else has rotated.
            own: A large buffer for a single row, which is handed over right behind the active one.
            record: That row's Message record.

        Returns:
            Whether the caller should look at the active buffer again; with `own`, whether `own` is handed over.
        """
        free, is_nested, is_used = self._free, self._rotating, False
        if not free:
            return False
        self._rotating = True
        fresh = free[0]
        # `del` and `+=` here rather than popleft() and append(): a signal handler can come in at a call.
        del free[0]
        try:  # no call since `free` was looked at
            end, registry, put = full.end, self.registry, self._sealed.put
            rows, blocks = self._sealed_rows + len(full.starts), self._blocks + bool(full.starts)
            sealed: tuple[Buffer, ...] = (full,)
            if own is not None:
                own.fill(self._prologue(blocks, registry), record)
                sealed, rows, blocks = (full, own), rows + 1, blocks + 1
            fresh.begin(self._prologue(blocks, registry))
            # The calls above may have let a signal handler append or rotate. If so, nothing changes and the caller
            # looks again.
            if self.active is full and full.end == end and self.registry is registry:  # no call between
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
                # Invalid again: two buffers with one block number would be the same rows twice for a recovery.
                fresh.map[0] = 0
                free += (fresh,)
        return is_used or own is None

    def rows(self) -> int:
        """Return the number of rows taken so far."""
        with self.lock:
            return self._sealed_rows + len(self.active.starts)

    # -- waiting for the writer ----------------------------------------------------------------------------------------

    @property
    def cannot_wait(self) -> bool:
        """Whether waiting would never end, because the caller has interrupted the thread that makes room."""
        return self._rotating or threading.get_ident() == self.writer_ident

    def stand_back(self) -> None:
        """Let the writer have the interpreter for a moment, if the caller appends at full speed."""
        self.turns.stand_back(self._sealed_rows, self._sealed.qsize)

    # -- the writer thread ---------------------------------------------------------------------------------------------

    def take(self, timeout_s: float) -> tuple[Buffer, ...] | int | None:
        """Return the next sealed buffers or mark; None if there is neither within the timeout, in seconds."""
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
        """Put a mark behind all sealed buffers; `take` returns it in its turn.

        Args:
            number: The mark.
            is_awaited: Whether somebody waits until it is reached.
        """
        self._sealed.put(number)
        if is_awaited:
            self.turns.hurry()

    def recycle(self, buffer: Buffer) -> None:
        """Take back a buffer whose rows are in the file."""
        buffer.clear()
        self._free.append(buffer)

    # -- the end -------------------------------------------------------------------------------------------------------

    @property
    def is_shut(self) -> bool:
        """Whether the recorder takes no more rows."""
        return self._shut is not None

    def check_open(self) -> None:
        """Raise StateError if the recorder takes no more rows."""
        if self._shut is not None:
            raise StateError(self._shut)

    def shut(self, why: str) -> None:
        """Take no more rows; every later append raises `why`. The active buffer is handed over."""
        put = self._sealed.put
        with self.lock:
            if self._shut is None:
                self._shut = why
                last = self.active
                rows = self._sealed_rows + len(last.starts)
                self._sealed_rows = rows
                self.active = self._nothing
                put((last,))

    def abandon(self, why: str) -> None:
        """Forget all buffers in a forked child, and change none of them: they belong to the parent."""
        self.lock = threading.RLock()
        self._shut = why
        self.active = self._nothing
        self.session.leave_behind()
