"""Runs the sinks beside the file: each on a thread of its own, behind a queue of limited size."""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Iterable

from ..errors import UsageError
from .prepared_block import PreparedBlock
from .sink import SessionInfo, Sink
from .stats import SinkStats

_CLOSE_PATIENCE_S = 2.0
"""How long `close` waits for all sinks together, in seconds."""

_log = logging.getLogger("ml_dash_mcap")


class SinkThread:
    """Hands blocks to one sink. The writer thread calls `has_room`, `offer` and `miss`; any thread calls the rest."""

    def __init__(self, sink: Sink, session: SessionInfo, most_bytes: int) -> None:
        """Prepare; `start` opens the sink.

        Args:
            sink: The object that takes the blocks.
            session: Passed to the sink when it is opened.
            most_bytes: How much may wait for it, in bytes; a single block may have more.
        """
        self.name = type(sink).__name__
        self._sink = sink
        self._session = session
        self._most_bytes = most_bytes
        self._blocks: queue.SimpleQueue[PreparedBlock | None] = queue.SimpleQueue()
        self._figures_lock = threading.Lock()
        """Guards the figures below."""
        self._waiting_bytes = self._waiting_rows = 0
        self._rows = self._missed = self._errors = 0
        self._failure: BaseException | None = None
        self._is_over = False
        """Whether the sink gets no more blocks: it could not be opened, or the recorder no longer waits for it."""
        self._is_given_up = False
        """Whether the recorder no longer waits for the sink, and has counted its waiting rows as missed."""
        # A daemon, so that a sink that never returns cannot keep the process from ending.
        self._thread = threading.Thread(target=self._run, name=f"ml_dash_mcap sink {self.name}", daemon=True)

    def start(self) -> None:
        """Open the sink, on its thread."""
        self._thread.start()

    def has_room(self, block: PreparedBlock) -> bool:
        """Return whether a block may wait for the sink; if not, its rows are counted as missed."""
        with self._figures_lock:
            is_full = self._waiting_bytes and self._waiting_bytes + block.size > self._most_bytes
            if self._is_over or is_full:
                self._missed += len(block)
                return False
            return True

    def offer(self, block: PreparedBlock) -> None:
        """Let a block wait for the sink."""
        with self._figures_lock:
            self._waiting_bytes += block.size
            self._waiting_rows += len(block)
        self._blocks.put(block)

    def miss(self, block: PreparedBlock, error: Exception) -> None:
        """Count a block that could not be offered."""
        self._note(error)
        with self._figures_lock:
            self._missed += len(block)

    def stats(self) -> SinkStats:
        """Return the figures of the sink."""
        with self._figures_lock:
            failure = None if self._failure is None else repr(self._failure)
            return SinkStats(self.name, self._rows, self._waiting_rows, self._missed, self._errors, failure)

    def end(self) -> None:
        """Have the sink closed behind the last block that waits for it."""
        self._blocks.put(None)

    def wait(self, deadline_s: float) -> None:
        """Wait until the sink is closed, but not beyond a moment of the monotonic clock, in seconds."""
        if self._thread is threading.current_thread():
            return  # the sink closes the recorder itself, and goes on behind this
        self._thread.join(max(deadline_s - time.monotonic(), 0.0))
        if self._thread.is_alive():
            with self._figures_lock:
                self._is_over = self._is_given_up = True
                self._missed += self._waiting_rows
                self._waiting_rows = 0

    # -- the thread ------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._sink.open(self._session)
        except BaseException as error:  # whatever it raises stays on this thread
            self._note(error)
            with self._figures_lock:
                self._is_over = True
            is_open = False
        else:
            is_open = True
        while (block := self._blocks.get()) is not None:
            self._write(block)
            del block  # its memory goes before the next one comes
        if is_open:
            try:
                self._sink.close()
            except BaseException as error:
                self._note(error)

    def _write(self, block: PreparedBlock) -> None:
        is_taken = False
        if not self._is_over:
            try:
                self._sink.write(block)
                is_taken = True
            except BaseException as error:
                self._note(error)
        with self._figures_lock:
            self._waiting_bytes -= block.size
            if not self._is_given_up:
                self._waiting_rows -= len(block)
                self._rows += len(block) if is_taken else 0
                self._missed += 0 if is_taken else len(block)

    def _note(self, error: BaseException) -> None:
        with self._figures_lock:
            self._errors += 1
            self._failure = self._failure or error


class SinkThreads:
    """All sinks of a recorder beside the file."""

    def __init__(self, sinks: Iterable[Sink], session: SessionInfo, most_bytes: int) -> None:
        """Open all sinks, each on its thread.

        Args:
            sinks: The objects that take the blocks.
            session: Passed to each when it is opened.
            most_bytes: How much may wait for each of them, in bytes.

        Raises:
            UsageError: One of them is no sink.
        """
        self._threads: list[SinkThread] = []
        try:
            for sink in _checked(sinks):
                thread = SinkThread(sink, session, most_bytes)
                thread.start()
                self._threads.append(thread)
        except BaseException:
            self.close()
            raise

    def offer(self, block: PreparedBlock) -> None:
        """Offer a block of the writer thread to each sink that has room for it; nothing here waits or raises."""
        if not (len(block) or block.metadata):
            return
        takers = [thread for thread in self._threads if thread.has_room(block)]
        if not takers:
            return
        try:
            # One copy for all sinks, 0.3 to 0.6 ms for 1.5 MB (docs/decisions, 0029). With references to the buffer, a
            # slow sink would keep it from the control loop.
            copy = block.detached()
        except Exception as error:  # there is no memory for it
            for thread in takers:
                thread.miss(block, error)
            return
        for thread in takers:
            thread.offer(copy)

    def stats(self) -> tuple[SinkStats, ...]:
        """Return the figures of each sink."""
        return tuple(thread.stats() for thread in self._threads)

    def close(self) -> None:
        """Have all sinks finish and close, wait for a moment, and log what they missed. May be called twice."""
        deadline_s = time.monotonic() + _CLOSE_PATIENCE_S
        for thread in self._threads:
            # All are told to end before the first one is waited for, so that they finish side by side.
            thread.end()
        for thread in self._threads:
            thread.wait(deadline_s)
            stats = thread.stats()
            if stats.missed or stats.errors:
                _log.warning(
                    "the sink %s missed %d rows, which are in the file; it raised %d errors, the first: %s",
                    *(stats.name, stats.missed, stats.errors, stats.failure),
                )


def _checked(sinks: Iterable[Sink]) -> list[Sink]:
    if not isinstance(sinks, Iterable):
        raise UsageError(f"sinks={sinks!r} is of type {type(sinks).__name__}; pass a list of sinks")
    listed = list(sinks)
    for sink in listed:
        missing = [name for name in ("open", "write", "close") if not callable(getattr(sink, name, None))]
        if missing or isinstance(sink, type):
            fault = f"has no method {missing[0]}()" if missing else "is a class; pass an object"
            raise UsageError(f"sinks={listed!r}: {sink!r} {fault}")
    return listed
