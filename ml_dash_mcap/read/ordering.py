"""Parts of chunks in time order, holding no more of them than overlap."""

from __future__ import annotations

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


def in_time(found: Iterable[tuple[int, Sequence[P]]]) -> Iterator[list[P]]:
    """Yield groups of parts, each group later than the one before: all messages of one log time are in one group.

    Args:
        found: For each chunk, by start time: the log time of its first message, and the parts cut out of it.
    """
    pending: list[P] = []
    for start_ns, parts in found:
        ready, pending = _split(pending, start_ns - TOLERANCE_NS)
        if ready:
            yield ready
        pending += [part for part in parts if len(part.times_ns)]  # of some, all messages were lost
    if pending:
        yield pending


def is_in_order(times: npt.NDArray[Any], written: npt.NDArray[np.int64]) -> bool:
    """Whether messages are in the order of their times, those of one time in the order of writing."""
    earlier, later = times[:-1], times[1:]
    return bool(np.all((earlier < later) | ((earlier == later) & (written[:-1] < written[1:]))))


def is_close(seconds: npt.NDArray[np.float64], times_ns: npt.NDArray[np.uint64]) -> npt.NDArray[np.bool_]:
    """Tell which doubles can be the exact time stamps of messages with these log times, [N]."""
    close: npt.NDArray[np.bool_] = np.abs(seconds * clock.NS_PER_S - times_ns.astype(np.float64)) <= TOLERANCE_NS
    return close


def _split(parts: list[P], watermark_ns: int) -> tuple[list[P], list[P]]:
    """Divide into what lies before the watermark, and can go out, and what has to wait for later chunks."""
    ready: list[P] = []
    waiting: list[P] = []
    for part in parts:
        times = part.times_ns
        if int(times.max()) < watermark_ns:
            ready.append(part)
        elif watermark_ns <= 0 or int(times.min()) >= watermark_ns:
            waiting.append(part)
        else:
            early = times < np.uint64(watermark_ns)
            ready.append(part.pick(np.flatnonzero(early)))
            waiting.append(part.pick(np.flatnonzero(~early)))
    return ready, waiting
