"""Finds room for an append when the backlog is full: waits, or refuses the row and counts it, or raises."""

from __future__ import annotations

import time
from collections.abc import Callable

from ..errors import BacklogFullError, StorageError
from ..options import RecorderOptions
from .buffer_ring import BufferRing

_POLL_S = 0.0005


class Room:
    """Finds room for the records of appending threads, by the rule of the option `on_full`."""

    def __init__(self, ring: BufferRing, options: RecorderOptions) -> None:
        self.dropped: dict[str, int] = {}
        """Rows refused, by topic; guarded by the lock of the ring."""
        self.failure: Callable[[], BaseException | None] = lambda: None
        """Returns the error that keeps the writer from writing now, or None. Appends that cannot wait raise it."""
        self._ring = ring
        self._options = options

    def until(self, put: Callable[[], bool], topic: str, rows: int | None) -> bool:
        """Try to put a record, and follow the option `on_full` while there is no room.

        Args:
            put: Called with the lock held; returns whether there was room.
            topic: For the error messages and counts.
            rows: How many rows are refused if there is no room, to be counted; None always waits.

        Returns:
            Whether it was put; False only with `on_full="drop"`.
        """
        while True:
            with self._ring.lock:
                self._ring.check_open()
                if put():
                    return True
                # Asked under the lock, so that it is the failure that kept this attempt from finding room.
                failure = self.failure()
                is_refused = self._ring.cannot_wait or (rows is not None and self._may_refuse(failure))
                if rows and is_refused:
                    self.dropped[topic] = self.dropped.get(topic, 0) + rows
            if is_refused:
                return self._refuse(topic, failure)
            self._ring.turns.hurry()
            time.sleep(_POLL_S)  # events and conditions have a lock, for which a signal handler would wait for ever

    def _may_refuse(self, failure: BaseException | None) -> bool:
        return self._options.on_full != "block" or failure is not None

    def _refuse(self, topic: str, failure: BaseException | None) -> bool:
        message = f"append() on topic {topic!r}: the backlog of {self._options.backlog_bytes} bytes is full"
        if self._options.on_full == "drop":
            return False
        if failure is not None and self._options.on_full == "block":
            raise StorageError(f"{message} and the recording cannot be written ({failure}); not taken") from failure
        raise BacklogFullError(f"{message}; not taken")

    def give_way(self) -> None:
        """Let the writer have the interpreter for a moment."""
        if self._options.on_full == "block" and not self._ring.cannot_wait:
            self._ring.stand_back()
