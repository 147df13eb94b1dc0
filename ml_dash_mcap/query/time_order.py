"""Brings parts of chunks into time order, and holds no more of them than overlap."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from .. import clock

TOLERANCE_NS = 4096
"""How far a row's double and its log time may be apart, in ns (doubles at the end of MCAP's time are 3815 ns apart)."""


class Part(Protocol):
    """Some messages."""

    @property
    def times_ns(self) -> npt.NDArray[np.uint64]:
        """Their log times, in any order."""

    def pick(self: P, which: npt.NDArray[np.intp]) -> P:
        """Return some of them."""


P = TypeVar("P", bound=Part)


_Pending = list[tuple[int, int, P]]
"""A heap of parts with their first log times, and numbers that tell those of one time apart: only what a new chunk
releases is looked at, however many chunks overlap."""


def in_time(chunks: Iterable[tuple[int, Sequence[P]]]) -> Iterator[list[P]]:
    """Yield groups of parts, each group later than the one before: all messages of one log time are in one group.

    Args:
        chunks: For each chunk, by start time: the log time of its first message, and the parts cut out of it.
    """
    pending: _Pending[P] = []
    number = 0
    for start_ns, parts in chunks:
        # No later chunk begins before this one, so what lies before it is complete. The tolerance is for rows whose
        # doubles have another order than their log times.
        ready = _before(pending, start_ns - TOLERANCE_NS)
        if ready:
            yield ready
        for part in parts:
            if len(part.times_ns):  # all messages of a part may be lost
                number += 1
                _wait(pending, number, part)
    if pending:
        yield [part for _, _, part in sorted(pending, key=lambda waiting: waiting[:2])]


def is_in_order(times: npt.NDArray[Any], written: npt.NDArray[np.int64]) -> bool:
    """Whether messages are in the order of their times, those of one time in the order of writing."""
    earlier, later = times[:-1], times[1:]
    return bool(np.all((earlier < later) | ((earlier == later) & (written[:-1] < written[1:]))))


def is_close(seconds: npt.NDArray[np.float64], times_ns: npt.NDArray[np.uint64]) -> npt.NDArray[np.bool_]:
    """Tell which doubles can be the exact time stamps of messages with these log times, [N]."""
    close: npt.NDArray[np.bool_] = np.abs(seconds * clock.NS_PER_S - times_ns.astype(np.float64)) <= TOLERANCE_NS
    return close


def _wait(pending: _Pending[P], number: int, part: P) -> None:
    heapq.heappush(pending, (int(part.times_ns.min()), number, part))


def _before(pending: _Pending[P], watermark_ns: int) -> list[P]:
    """Take out all messages before the watermark. The others wait for later chunks."""
    ready: list[P] = []
    waiting: list[tuple[int, P]] = []
    while pending and pending[0][0] < watermark_ns:
        _, number, part = heapq.heappop(pending)
        times = part.times_ns
        if int(times.max()) < watermark_ns:
            ready.append(part)
        else:
            early = times < np.uint64(watermark_ns)
            ready.append(part.pick(np.flatnonzero(early)))
            waiting.append((number, part.pick(np.flatnonzero(~early))))
    for number, part in waiting:
        _wait(pending, number, part)
    return ready
