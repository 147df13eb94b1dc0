"""Finds times that are out of order in the order of writing: rows that came late, and clocks that were set."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .. import clock

Times = npt.NDArray[np.uint64]
Flags = npt.NDArray[np.bool_]

_LEAP_NS = 60 * clock.NS_PER_S
_LEAP_SPACINGS = 1000
"""Times that go on by more than both at once are not just a gap: the clock was set, or nothing ran for a while."""

_CLOSE_SPACINGS = 2
_MOST_STEPS = 1000
"""So many steps of a clock are told apart; behind them everything that is not in order is late."""


@dataclass(frozen=True, slots=True)
class Late:
    """Rows that follow each other and were written after a row of a later time."""

    first: int
    """Place of the first one in the order of writing."""
    count: int
    by_ns: int
    """How far the first one lies behind the latest row before it."""


@dataclass(frozen=True, slots=True)
class Step:
    """A place where the clock was set, back or ahead."""

    at: int
    """Place of the first row there, in the order of writing."""
    from_ns: int
    """The latest time before it."""
    to_ns: int
    """Its time; before `from_ns` if the clock was set back."""


def find(times_ns: Times) -> tuple[list[Late], list[Step]]:
    """Find rows that are out of order, and steps of the clock.

    Rows behind the latest time so far are late if the times then leap back to where they were. If they go on from
    there at their usual pace, the clock was set back.

    Args:
        times_ns: In the order of writing, [N].
    """
    usual_ns = _usual(times_ns)
    lates: list[Late] = []
    steps: list[Step] = []
    start = 0
    while start < len(times_ns):
        part = times_ns[start:]
        # The latest time before each row. Behind a step of the clock it is counted anew.
        latest = np.concatenate((part[:1], np.maximum.accumulate(part)[:-1]))
        firsts, lasts = _stretches(part < latest)
        depths = latest[firsts] - part[firsts]
        is_step = _were_set_back(part, latest, firsts, lasts, usual_ns) & (len(steps) < _MOST_STEPS)
        end = int(is_step.argmax()) if is_step.any() else len(firsts)
        lates += [
            Late(start + first, last - first, depth)
            for first, last, depth in zip(
                firsts[:end].tolist(), lasts[:end].tolist(), depths[:end].tolist(), strict=True
            )
        ]
        stop = int(firsts[end]) if end < len(firsts) else len(part)
        steps += _leaps(part[:stop], latest[:stop], start, usual_ns)
        if stop < len(part):
            steps.append(Step(start + stop, int(latest[stop]), int(part[stop])))
        start += stop
    return lates, steps


def _usual(times_ns: Times) -> float:
    """Return the median of the steps forward, in ns."""
    forward = times_ns[1:] > times_ns[:-1]
    return float(np.median(np.diff(times_ns)[forward])) if forward.any() else 0.0


def _stretches(flags: Flags) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return where runs of true flags start, and where they end (the first false one)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False])).astype(np.int8)))
    # The flags change at each edge, by turns to true and to false.
    return edges[::2], edges[1::2]


def _were_set_back(
    part: Times, latest: Times, firsts: npt.NDArray[np.intp], lasts: npt.NDArray[np.intp], usual_ns: float
) -> Flags:
    """Tell which stretches behind the latest time are those of a clock that was set back."""
    first_depth, last_depth = latest[firsts] - part[firsts], latest[lasts - 1] - part[lasts - 1]
    is_deep = first_depth > _CLOSE_SPACINGS * usual_ns
    is_overtaken = np.where(lasts < len(part), last_depth <= _CLOSE_SPACINGS * usual_ns, lasts - firsts > 1)
    is_set_back: Flags = is_deep & is_overtaken
    return is_set_back


def _leaps(part: Times, latest: Times, start: int, usual_ns: float) -> list[Step]:
    ahead = np.flatnonzero(part > latest)
    far = ahead[part[ahead] - latest[ahead] > max(_LEAP_NS, _LEAP_SPACINGS * usual_ns)]
    return [Step(start + at, int(latest[at]), int(part[at])) for at in far.tolist()]
