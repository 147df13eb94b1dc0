"""The writer thread: takes sealed buffers, prepares them, and hands them to the sinks."""

from __future__ import annotations

import contextlib
import errno
import logging
import threading
import time
from collections.abc import Callable
from typing import TypeVar

from ..errors import StorageError
from ..mcap.chunk_writer import Compressed, Compressor
from .buffer import Buffer
from .journal import Journal
from .prepare_block import BlockPreparer
from .rehearsal import rehearse, touch_memory
from .segment_sink import SegmentSink
from .sink_threads import SinkThreads
from .turn_taking import State, Turns

_FIRST_RETRY_S, _LAST_RETRY_S = 0.05, 1.0
_CLOSE_PATIENCE_S = 5.0
"""How long `close` goes on trying to write to a disk that refuses, in seconds."""

_THE_END, _SYNC = -1, -2
"""Marks that are not the number of a flush."""

_POLL_S = 0.1
_BRIEFLY_S = 0.002
_LOCK_PATIENCE_S = 0.01
"""The writer thread never waits longer for an appending thread, which may be waiting for it."""

_DISK_IS_FULL = {errno.ENOSPC, errno.EDQUOT}

T = TypeVar("T")

_log = logging.getLogger("ml_dash_mcap")


class _Alongside:
    """A compressor that tells when it is at work, for then the writer needs no interpreter."""

    def __init__(self, compress: Compressor, turns: Turns) -> None:
        self.name = compress.name
        self._compress = compress
        self._turns = turns

    def __call__(self, block: memoryview) -> Compressed:
        self._turns.writer = State.AWAY
        try:
            return self._compress(block)
        finally:
            self._turns.compressed()


class Writer:
    """The writer thread of one recorder.

    `flush`, `stop` and the figures are for any thread; everything else runs on the writer thread.
    """

    def __init__(self, journal: Journal, preparer: BlockPreparer, segments: SegmentSink, sinks: SinkThreads) -> None:
        self.failure: BaseException | None = None
        """The error that keeps the writer from writing now, or None."""
        self.rows_written = 0
        """Rows whose block is in the file, as they were appended."""
        self._journal = journal
        self._preparer = preparer
        self._segments = segments
        self._sinks = sinks
        self._progress = threading.Condition()
        """Guards `_requested` and `_done`, the numbers of the flushes asked for and done."""
        self._requested = 0
        self._done = 0
        self._stopping = threading.Event()
        self._give_up_at = float("inf")
        self._last_sync = self._last_seal = time.monotonic()
        segments.compress = _Alongside(segments.compress, journal.turns)
        # On this thread: beside a loop that never rests, imports would wait for the interpreter a hundred times.
        with contextlib.suppress(Exception):
            rehearse(journal.options.encoding)
        # A daemon: at exit Python first waits for all other threads, and only then closes a recorder that is still
        # open. This thread would wait for that close.
        self._thread = threading.Thread(target=self._run, name="ml_dash_mcap writer", daemon=True)
        self._thread.start()

    # -- any thread --------------------------------------------------------------------------------------------------

    def flush(self) -> None:
        """Wait until every row taken so far is in the file.

        Raises:
            StorageError: It cannot be written.
        """
        while not self._journal.seal():
            self._raise_failure()
            time.sleep(_BRIEFLY_S)
        with self._progress:
            self._requested += 1
            ticket = self._requested
            self._journal.mark(ticket)
            while self._done < ticket:
                # With a timeout, because a writer that fails or dies wakes nobody.
                self._progress.wait(_POLL_S)
                if self._done < ticket:
                    self._raise_failure()
                    if not self._thread.is_alive():
                        return

    def _raise_failure(self) -> None:
        failure = self.failure
        if failure is not None:
            raise StorageError(
                getattr(failure, "errno", None) or errno.EIO,
                f"the recording in {self._segments.folder} cannot be written: {failure}; its rows wait in the journal",
            ) from failure

    def stop(self) -> None:
        """Write the rest, finish the segments, end the thread, and close the sinks beside the file.

        Raises:
            StorageError: Not everything could be written; the journal stays, for a recovery.
        """
        self._give_up_at = time.monotonic() + _CLOSE_PATIENCE_S
        self._stopping.set()
        self._journal.mark(_THE_END)
        self._thread.join()
        self._sinks.close()
        self._raise_failure()

    @property
    def is_here(self) -> bool:
        """Whether the caller is the writer thread, which cannot wait for its own end."""
        return threading.current_thread() is self._thread

    # -- the thread --------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        self._journal.writer_ident = threading.get_ident()
        touch_memory()
        try:
            while self._step():
                pass
            self._persist(self._segments.close)
        except BaseException as error:
            self.failure = error
            _log.exception("the writer of %s stopped; its rows wait in the journal", self._segments.folder)
        finally:
            with self._progress:
                self._progress.notify_all()

    def _step(self) -> bool:
        """Handle a sealed buffer, a mark or a tick of the clock; returns whether to go on."""
        taken = self._journal.take(self._tick_at() - time.monotonic())
        if isinstance(taken, tuple):
            for buffer in taken:
                self._write(buffer)
        elif taken == _THE_END:
            return False
        elif taken == _SYNC:
            self._sync()
        elif taken is not None:
            with self._progress:
                self._done = max(self._done, taken)
                self._progress.notify_all()
        if time.monotonic() >= self._tick_at():
            self._tick()
        return True

    def _tick(self) -> None:
        """Seal the active buffer so that its rows are written, and sync the file when its interval is over."""
        now = time.monotonic()
        self._journal.tracks_clock.look(self._journal.last_s)
        begun_s = self._journal.active.begun_s
        if begun_s > self._last_seal:
            # The buffer before was full, so that this one has younger rows only. A second block right behind the full
            # one would have a thread that appends at full speed wait for both.
            self._last_seal = begun_s
        else:
            self._journal.seal_within(_LOCK_PATIENCE_S)
            self._last_seal = time.monotonic()
        interval = self._journal.options.sync_interval_s
        # Up to half a tick early, rather than nearly a whole tick late.
        if interval and now - self._last_sync >= interval - self._tick_s() / 2:
            self._last_sync = now
            self._journal.mark(_SYNC, is_awaited=False)

    def _tick_s(self) -> float:
        options = self._journal.options
        return min(options.flush_interval_s, options.sync_interval_s or float("inf"))

    def _tick_at(self) -> float:
        sync_at = self._last_sync + (self._journal.options.sync_interval_s or float("inf"))
        return min(self._last_seal + self._tick_s(), sync_at)

    def _write(self, buffer: Buffer) -> None:
        self._write_block(buffer)
        # Counted before recycling, which empties `starts`.
        self.rows_written += len(buffer.starts)
        self._journal.recycle(buffer)

    def _write_block(self, buffer: Buffer) -> None:
        block = buffer.block()
        prepared = self._persist(lambda: self._preparer.prepare(block))
        self._persist(lambda: self._segments.write(prepared))
        # Only now: a block that could not be written is prepared again, and its counts with it.
        self._preparer.steps.commit()
        self._sinks.offer(prepared)

    def _sync(self) -> None:
        self._journal.turns.writer = State.AWAY
        try:
            self._segments.sync()
        except OSError as error:  # a failed sync may have lost data, and a second one could falsely succeed
            _log.error("syncing %s failed: %s; the recording goes on in a new segment", self._segments.folder, error)
            self._segments.set_aside()
        finally:
            self._journal.turns.writer = State.RUNNING

    def _persist(self, write: Callable[[], T]) -> T:
        """Repeat a write while the disk refuses it or memory is short. The backlog grows meanwhile."""
        pause = _FIRST_RETRY_S
        while True:
            try:
                result = write()
                self.failure = None
                return result
            except (OSError, MemoryError) as error:
                if self.failure is None:
                    _log.error("cannot write the recording in %s: %r", self._segments.folder, error)
                self.failure = error
                # A full disk leaves the segment good. After any other error its state is unknown: a new one begins.
                if isinstance(error, OSError) and error.errno not in _DISK_IS_FULL:
                    self._segments.set_aside()
                if time.monotonic() + pause > self._give_up_at:
                    raise
                # Closing ends a pause early, once; an event that is set no longer waits at all.
                time.sleep(pause) if self._stopping.is_set() else self._stopping.wait(pause)
                pause = min(2 * pause, _LAST_RETRY_S)
