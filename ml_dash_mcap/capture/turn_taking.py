"""Lets the writer thread and a thread that appends at full speed take turns at running Python.

A thread that appends without a pause holds the interpreter lock all the time. The writer has to ask for the lock, and
gets it after the switch interval, 5 ms, each time, while the appender stands still for a moment. So the two take turns.
An appender that has filled a buffer stands back until the writer compresses, which needs no interpreter. A writer that
has compressed waits until the appender stands back again. While the writer waits for the disk to sync, nobody waits.
"""

from __future__ import annotations

import contextlib
import queue
import time
from collections.abc import Callable
from enum import Enum, auto

_FULL_SPEED_ROWS_PER_S = 50_000
"""A thread that appends faster than this does hardly anything else."""

_LONGEST_TURN_S = 0.05
_POLL_S = 0.00025
_FAR_AHEAD = 2
"""Sealed buffers that wait for the writer when an appender stands back although the writer is away."""


class State(Enum):
    """The state of the writer thread."""

    RESTING = auto()
    """It waits for a buffer."""
    RUNNING = auto()
    """It needs the interpreter."""
    AWAY = auto()
    """It compresses or waits for the disk, and needs no interpreter."""


class Turns:
    """Appending threads call `stand_back`, the writer thread `compressed`, any thread `hurry`.

    A signal handler may come anywhere, and nothing here has a lock that it would wait for.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self.writer = State.RESTING
        """Set by the writer thread."""
        self.is_hurried = False
        """Whether somebody waits for the writer; the writer clears this when nothing is left to do."""
        self._standing_back = 0
        self._stood_back_s = 0.0
        """How long the last one stood back."""
        self._full_speed_until_s = 0.0
        self._last_s = clock()
        self._last_rows = 0
        self._wake: queue.SimpleQueue[None] = queue.SimpleQueue()

    def stand_back(self, rows: int, waiting: Callable[[], int]) -> None:
        """Let the writer run, if the caller appends at full speed; called whenever a buffer may have been filled.

        Args:
            rows: How many are in the buffers filled so far.
            waiting: Returns how many of these the writer has not begun with.
        """
        count, begun_s = rows - self._last_rows, self._clock()
        took_s = begun_s - self._last_s
        if not count:
            return
        self._last_rows, self._last_s = rows, begun_s
        if count < took_s * _FULL_SPEED_ROWS_PER_S:
            return
        self._standing_back += 1
        try:
            self._wake.put(None)
            # Each look takes the interpreter from the writer, so there is none for half of the time that it takes.
            pause_s = max(_POLL_S, min(self._stood_back_s, _LONGEST_TURN_S) / 2)
            while not self._is_my_turn(waiting()) and self._clock() < begun_s + _LONGEST_TURN_S:
                time.sleep(pause_s)
                pause_s = _POLL_S
        finally:
            self._standing_back -= 1
            self._last_s = self._clock()
            self._stood_back_s = self._last_s - begun_s
            self._full_speed_until_s = self._last_s + 2 * took_s

    def _is_my_turn(self, waiting: int) -> bool:
        if self.writer is State.AWAY:
            return waiting < _FAR_AHEAD
        return self.writer is State.RESTING and not waiting

    def hurry(self) -> None:
        """Have the writer wait for no turn until all is written."""
        self.is_hurried = True
        self._wake.put(None)

    def compressed(self) -> None:
        """Wait, on the writer thread, until the thread that appends at full speed stands back or stops."""
        self.writer = State.RUNNING
        while not self._wake.empty():
            self._wake.get()
        while not (self._standing_back or self.is_hurried):
            rest_s = self._full_speed_until_s - self._clock()
            if rest_s <= 0:
                return
            with contextlib.suppress(queue.Empty):
                self._wake.get(timeout=rest_s)
