"""The journal: buffers in shared memory that hold rows until they are in the file, and that a crash leaves behind.

A buffer is laid out as an MCAP file without an end: magic, header, a metadata record that says whose it is, schemas,
channels, messages. A record becomes valid with its first byte, which is written last; the byte after the last record
is 0, which no MCAP record begins with, so neither a half-written record nor one of an earlier use is ever read.
"""

from __future__ import annotations

import contextlib
import json
import mmap
import os
import queue
import socket
import threading
import time
import weakref
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..errors import BacklogFullError, FieldError, StateError, StorageError, TopicError
from ..options import RecorderOptions
from . import records
from .lock import SessionLock
from .rows import Block

SESSION_FILE = ".ml_dash-{session}.json"
SESSION_GLOB = ".ml_dash-*.json"
JOURNAL_METADATA = "ml_dash.journal"

_SHARED_MEMORY = Path("/dev/shm")
_WAIT_S = 0.05
_FAR_AHEAD = 2
"""Sealed buffers that wait for the writer when an appending thread begins to make room for it."""


class Buffer:
    """One journal buffer. Appending threads fill it under the journal's lock; sealed, it is the writer's alone."""

    __slots__ = ("end", "extras", "gaps", "is_large", "limit", "map", "path", "prologue", "size", "starts", "uniform")

    def __init__(self, path: Path | None, size: int, is_large: bool = False) -> None:
        self.path = path
        self.size = size
        self.is_large = is_large
        """Whether it was made for one row, and goes with it."""
        self.limit = size - 1 if path is not None else -1
        """The last offset that a record may end at; the byte there stays 0. Below 0: nothing is taken any more."""
        self.end = 0
        """Where the next record goes."""
        self.prologue = 0
        """Where the first record after the prologue went."""
        self.starts: list[int] = []
        """Where each Message record starts."""
        self.extras: list[tuple[int, int]] = []
        """Start and end of each Metadata record, in order."""
        self.gaps: list[tuple[int, int]] = []
        """Start and end of every record that is not a Message."""
        self.uniform: list[tuple[int, int]] = []
        """Runs of `starts`, by first index and the one after the last, whose rows are known to be of one form."""
        self.map = mmap.mmap(-1, mmap.PAGESIZE) if path is None else _reserve(path, size)

    def begin(self, prologue: bytes) -> None:
        """Make an empty buffer the start of an MCAP file."""
        self.map[1 : len(prologue)] = prologue[1:]
        self.map[0] = prologue[0]
        self.end = self.prologue = len(prologue)

    def put(self, record: bytes) -> None:
        """Write one record (or several) that was checked to fit."""
        start, end = self.end, self.end + len(record)
        self.end = end  # first: a signal handler may append before this is through
        self.map[start + 1 : end] = record[1:]
        self.map[start] = record[0]

    def put_row(self, record: bytes) -> None:
        """Write a Message record."""
        start = self.end
        self.put(record)
        self.starts.append(start)

    def put_gap(self, record: bytes) -> tuple[int, int]:
        """Write a record that is not a Message; returns its start and end."""
        gap = (self.end, self.end + len(record))
        self.put(record)
        self.gaps.append(gap)
        return gap

    def clear(self) -> None:
        """Make it as good as new: invalid first, then all zeros."""
        self.map[0] = 0
        np.frombuffer(self.map, np.uint8)[: self.end] = 0  # lets other threads run, unlike a slice of the map
        self.end = self.prologue = 0
        self.starts = []
        self.extras = []
        self.gaps = []
        self.uniform = []

    def block(self) -> Block:
        """Return what it holds; its memory must not be given back before that is forgotten."""
        data = np.frombuffer(self.map, np.uint8)
        return Block(data, self.prologue, self.end, self.starts, self.gaps, self.extras, self.uniform)

    def discard(self) -> None:
        """Delete its file and give its memory back."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)
        with contextlib.suppress(BufferError):  # a view is still about; the memory goes with it
            self.map.close()


def _reserve(path: Path, size: int) -> mmap.mmap:
    """Make a file whose every byte has its place in memory or on disk, so that writing to it cannot fail later."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_CLOEXEC", 0), 0o600)
    try:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(descriptor, 0, size)
        else:
            os.write(descriptor, bytes(size))
        flags = getattr(mmap, "MAP_SHARED", 0) | getattr(mmap, "MAP_POPULATE", 0)
        return mmap.mmap(descriptor, size, flags=flags) if flags else mmap.mmap(descriptor, size)
    except BaseException:
        path.unlink(missing_ok=True)
        raise
    finally:
        os.close(descriptor)


class Journal:
    """The buffers of one recorder: one active, some sealed, some free.

    Appending threads call `add` and `add_metadata`; any thread `seal`; the writer thread `take` and `recycle`.
    """

    def __init__(self, folder: Path, session: str, options: RecorderOptions, about: Mapping[str, str]) -> None:
        """Reserve the buffers and begin the first one.

        Args:
            folder: The run's folder.
            session: Names this opening of the recording.
            options: The recorder's.
            about: The constant part of the `ml_dash` metadata record, for a recovery to repeat.

        Raises:
            StorageError: The folder cannot be written, or there is no room for the backlog.
        """
        self.options = options
        self.session = session
        self.lock = threading.RLock()
        """Guards `active`, what is put into it, and the counters. Held for about a microsecond, never over I/O."""
        self.last_s: float | None = None
        """The latest time stamp that a track was given, in seconds."""
        self.dropped: dict[str, int] = {}
        """Rows refused, by topic."""
        self.failure: Callable[[], BaseException | None] = lambda: None
        """What keeps the writer from writing at the moment, if anything; appends that cannot wait for it raise it."""
        self.eager: Callable[[], object] | None = None
        """Called after each `append`, where the options ask for writing sooner than a buffer is full."""
        self.turn = threading.Event()
        """Set while the writer does what needs no interpreter. An appending thread that is far ahead of it waits for
        that once a buffer, so that both get on: the writer would have to wait 5 ms for every turn otherwise."""
        self._registry = b""
        self._chunks = 0
        self._sealed_rows = 0
        self._large_bytes = 0
        self._sealed: queue.SimpleQueue[Buffer | int] = queue.SimpleQueue()
        self._free: queue.SimpleQueue[Buffer] = queue.SimpleQueue()
        self._closed: str | None = None
        self._folder = folder
        self._session_lock = _create_session(folder, session)
        try:
            self._buffers = self._make_buffers()
        except BaseException:
            self._session_lock.remove()
            raise
        self._note_session(about)
        for buffer in self._buffers[1:]:
            self._free.put(buffer)
        self.active = self._buffers[0]
        self.active.begin(self._prologue())
        _LIVE.add(self)

    # -- making ------------------------------------------------------------------------------------------------------

    def _places(self) -> Iterator[Path]:
        if self.options.journal_dir is not None:
            yield Path(self.options.journal_dir)
            return
        if _SHARED_MEMORY.is_dir() and os.access(_SHARED_MEMORY, os.W_OK):
            yield _SHARED_MEMORY
        yield self._folder

    def _make_buffers(self) -> list[Buffer]:
        count = self.options.backlog_bytes // self.options.chunk_bytes
        failures: list[OSError] = []
        for place in self._places():
            made: list[Buffer] = []
            try:
                while len(made) < count:
                    made.append(Buffer(place / self._buffer_name(str(len(made))), self.options.chunk_bytes))
            except OSError as error:
                for buffer in made:
                    buffer.discard()
                failures.append(error)
                continue
            self._place = place
            return made
        raise StorageError(
            f"no room for a backlog of {self.options.backlog_bytes} bytes: "
            + "; ".join(f"{error.filename or 'journal'}: {error.strerror or error}" for error in failures)
            + " (make room, or set backlog_bytes= or journal_dir=)"
        ) from failures[-1]

    def _buffer_name(self, number: str) -> str:
        return f".ml_dash-{self.session}-{number}.journal"

    def _note_session(self, about: Mapping[str, str]) -> None:
        """Say in the session file where the buffers are, for whoever comes after a crash."""
        said = {
            "session": self.session,
            "pid": os.getpid(),
            "host": socket.gethostname(),
            "journals": str(self._place.absolute() / self._buffer_name("*")),
            "about": dict(about),
        }
        self._session_lock.write(json.dumps(said).encode())

    def _prologue(self, after: Buffer | None = None) -> bytes:
        chunk = self._chunks + (after is not None and bool(after.starts))
        whose = records.metadata(JOURNAL_METADATA, {"session": self.session, "chunk": str(chunk)})
        return records.header("ml_dash_mcap journal") + whose + self._registry

    # -- appending threads -------------------------------------------------------------------------------------------

    def register(self, records_bytes: bytes) -> None:
        """Take a new topic's Schema and Channel records into this buffer and all later ones.

        Raises:
            TopicError: There are too many topics for the size of a chunk.
        """

        def put() -> bool:
            if len(self._registry) + len(records_bytes) > self.options.chunk_bytes // 2:
                raise TopicError(
                    f"the topics of this recording take more than half of a chunk of {self.options.chunk_bytes}"
                    " bytes; set chunk_bytes= higher, or log to fewer topics"
                )
            if self.active.end + len(records_bytes) > self.active.limit and not self._rotate():
                return False
            self._registry += records_bytes
            self.active.put_gap(records_bytes)
            return True

        self._until(put, "the journal", count=None)

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
        """
        if self._fits_no_buffer(record):
            return self._add_large(record, topic, last_s)

        def put() -> bool:
            active = self.active
            if active.end + len(record) > active.limit:
                if not self._rotate():
                    return False
                active = self.active
            active.put_row(record)
            if last_s is not None:
                self.last_s = last_s
            return True

        taken = self._until(put, topic)
        self._give_way()
        return taken

    def _give_way(self) -> None:
        """Let a writer that is behind have the interpreter for a moment."""
        if self._sealed.qsize() >= _FAR_AHEAD and self.options.on_full == "block":
            self.turn.wait(_WAIT_S)

    def add_many(self, block: bytes, starts: npt.NDArray[np.int64], topic: str, last_s: float, is_uniform: bool) -> int:
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
        done, dropped = 0, 0

        def put() -> bool:
            nonlocal done
            active = self.active
            offset = int(starts[done])
            fitting = int(np.searchsorted(ends, active.limit - active.end + offset, side="right"))
            if fitting <= done:
                return self._rotate() and put()
            at = active.end
            active.put(block[offset : int(ends[fitting - 1])])
            if is_uniform:
                active.uniform.append((len(active.starts), len(active.starts) + fitting - done))
            active.starts.extend((starts[done:fitting] + (at - offset)).tolist())
            self.last_s = last_s
            done = fitting
            return True

        while done < len(starts):
            record = block[int(starts[done]) : int(ends[done])]
            if self._fits_no_buffer(record):
                taken = self._add_large(record, topic, last_s)
                done += 1
                dropped += not taken
            elif not self._until(put, topic, count=len(starts) - done):
                return done - dropped
            self._give_way()
        return done - dropped

    def _fits_no_buffer(self, record: bytes) -> bool:
        return len(self._registry) + len(record) + 512 > self.options.chunk_bytes

    def _add_large(self, record: bytes, topic: str, last_s: float | None) -> bool:
        """Give a row that is larger than a buffer one of its own, sealed at once."""
        size = len(record) + len(self._registry) + 1024
        if size > self.options.backlog_bytes:
            raise FieldError(
                f"append() on topic {topic!r}: the row has {len(record)} bytes, more than the whole backlog of"
                f" {self.options.backlog_bytes} bytes; set backlog_bytes= higher"
            )

        def put() -> bool:
            if self._large_bytes + size > self.options.backlog_bytes:
                return False
            if (self.active.starts or self.active.extras) and not self._rotate():
                return False
            own = self._make_large(size, topic)
            own.begin(self._prologue())
            own.put_row(record)
            self._large_bytes += size
            self._hand_over(own)
            self.active.clear()  # the number of its chunk has changed
            self.active.begin(self._prologue())
            if last_s is not None:
                self.last_s = last_s
            return True

        return self._until(put, topic)

    def _make_large(self, size: int, topic: str) -> Buffer:
        name = self._buffer_name(f"large{self._chunks}-{time.monotonic_ns()}")
        try:
            return Buffer(self._place / name, size, is_large=True)
        except OSError as error:
            raise StorageError(
                error.errno, f"append() on topic {topic!r}: no room for a row of {size} bytes: {error.strerror}"
            ) from error

    def add_metadata(self, record: bytes) -> None:
        """Put a Metadata record; it waits for room, whatever `on_full` says."""

        def put() -> bool:
            active = self.active
            if active.end + len(record) > active.limit:
                if not self._rotate():
                    return False
                active = self.active
            active.extras.append(active.put_gap(record))
            return True

        if len(self._registry) + len(record) + 512 > self.options.chunk_bytes:
            raise FieldError(f"{len(record)} bytes of metadata do not fit into a chunk of {self.options.chunk_bytes}")
        self._until(put, "metadata", count=None)

    def _until(self, put: Callable[[], bool], topic: str, count: int | None = 1) -> bool:
        """Try to put something, and do what `on_full` says while there is no room; count=None always waits."""
        while True:
            with self.lock:
                if self._closed is not None:
                    raise StateError(self._closed)
                if put():
                    return True
                policy = self.options.on_full if count is not None else "block"
                failure = self.failure()
                if policy != "block" or failure is not None:
                    if count is not None:
                        self.dropped[topic] = self.dropped.get(topic, 0) + count
                    if policy == "drop":
                        return False
            if policy == "raise":
                raise BacklogFullError(
                    f"append() on topic {topic!r}: the backlog of {self.options.backlog_bytes} bytes is full; the row"
                    " was not taken"
                )
            if failure is not None:
                raise StorageError(
                    f"append() on topic {topic!r}: the backlog of {self.options.backlog_bytes} bytes is full and the"
                    f" recording cannot be written ({failure}); the row was not taken"
                ) from failure
            self._await_free()

    def _await_free(self) -> None:
        """Sleep until the writer has freed a buffer, or a moment has passed."""
        with contextlib.suppress(queue.Empty):
            self._free.put(self._free.get(timeout=_WAIT_S))

    # -- sealing -----------------------------------------------------------------------------------------------------

    def seal(self) -> bool:
        """Hand what is in the active buffer to the writer; returns whether there is nothing left in it."""
        with self.lock:
            active = self.active
            if active.limit < 0 or not (active.starts or active.extras):
                return True
            return self._rotate()

    def _rotate(self) -> bool:
        """Seal the active buffer and begin a free one, if there is one. Called with the lock held."""
        if self._closed is not None:
            raise StateError(self._closed)
        try:
            fresh = self._free.get_nowait()
        except queue.Empty:
            return False
        full = self.active
        fresh.begin(self._prologue(after=full))
        self.active = fresh  # before the full one is handed over: a signal handler may append in between
        self._hand_over(full)
        return True

    def _hand_over(self, buffer: Buffer) -> None:
        if buffer.starts:
            self._chunks += 1
            self._sealed_rows += len(buffer.starts)
        self._sealed.put(buffer)

    def seal_at(self, rows: int) -> Callable[[], object]:
        """Return what seals the active buffer once so many rows are in it."""
        return lambda: len(self.active.starts) >= rows and self.seal()

    def rows(self) -> int:
        """Return how many rows were taken so far; call it with the lock held for a figure that fits the others."""
        return self._sealed_rows + len(self.active.starts)

    # -- the writer thread -------------------------------------------------------------------------------------------

    def take(self, timeout_s: float) -> Buffer | int | None:
        """Return the next sealed buffer or mark, or None after a while without one."""
        try:
            return self._sealed.get(timeout=max(timeout_s, 0.0))
        except queue.Empty:
            return None

    def mark(self, number: int) -> None:
        """Put a mark behind all that is sealed; `take` returns it when it comes to it."""
        self._sealed.put(number)

    def recycle(self, buffer: Buffer) -> None:
        """Take back a buffer whose rows are in the file."""
        if buffer.is_large:
            with self.lock:
                self._large_bytes -= buffer.size
            buffer.discard()
            return
        buffer.clear()
        self._free.put(buffer)

    # -- the end -----------------------------------------------------------------------------------------------------

    @property
    def is_shut(self) -> bool:
        """Whether it takes no more rows."""
        return self._closed is not None

    def check_open(self) -> None:
        """Raise StateError if it takes no more rows."""
        if self._closed is not None:
            raise StateError(self._closed)

    def shut(self, why: str) -> None:
        """Take no more rows; every later append raises `why`. What is in the active buffer is handed over."""
        with self.lock:
            if self._closed is not None:
                return
            self._closed = why
            last, self.active = self.active, _closed_buffer()
            if last.starts or last.extras:
                self._hand_over(last)

    def remove(self) -> None:
        """Delete the buffers and the session file: everything is in finished segments."""
        _LIVE.discard(self)
        for buffer in self._buffers:
            buffer.discard()
        self._session_lock.remove()

    def leave_behind(self) -> None:
        """Let go of the session and keep the buffers for recovery: not everything could be written."""
        _LIVE.discard(self)
        self._session_lock.release()

    def abandon_in_child(self) -> None:
        """Forget the parent's recording in a forked child, touching none of it."""
        self.lock = threading.RLock()
        self._closed = (
            "this recorder belongs to the parent process, which goes on recording; open one in the forked child"
        )
        self.active = _closed_buffer()
        self._session_lock.release()


def _create_session(folder: Path, session: str) -> SessionLock:
    try:
        return SessionLock.create(folder / SESSION_FILE.format(session=session))
    except OSError as error:
        what = f"cannot write to the recording's folder: {error.strerror}"
        raise StorageError(error.errno, what, str(folder)) from error


def _closed_buffer() -> Buffer:
    return Buffer(None, 0)


_LIVE: weakref.WeakSet[Journal] = weakref.WeakSet()


def _abandon_all() -> None:
    for journal in list(_LIVE):
        journal.abandon_in_child()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_abandon_all)
