"""Measures how far apart a topic's rows are: the usual spacing, how much it varies, and what counts as a gap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .. import clock
from . import gaps
from .plain_words import brief_duration

Times = npt.NDArray[np.uint64]

FEWEST = 5
"""With fewer spacings, no usual spacing can be told."""

_ON_GRID, _SHARE_ON_GRID = 0.05, 0.95
"""Times are on a grid if so many of the spacings are within so much of a multiple of the usual one. Then they were
computed, by a simulation or a camera's counter, and a longer spacing is a row that is not there."""

_OFF, _SHARE_OFF = 0.2, 0.05
"""Spacings vary if more than this share of them is off the usual one by more than a fifth of it."""

_LOW, _HIGH = 0.05, 0.95

_HICCUP_NS = 100_000_000
"""For so long a loop in Python may stand still now and then: the scheduler, garbage, a page fault. On measured times,
what is not longer is counted, and no gap."""

_SHARE_MISSING = 0.05
_NEAR_GRID, _SHARE_NEAR_GRID = 0.2, 0.8
"""On measured times too, long spacings are gaps if more than a share of the rows would have been in them, and if so
many of them are within so much of a multiple of the usual one: pictures were dropped. A loop is held up for any time.
"""


@dataclass(frozen=True, slots=True)
class Spacings:
    """How far apart the rows of a topic are; pauses between recorders are not among them."""

    topic: str
    count: int
    """How many spacings there are."""
    usual: float
    """The median, in s."""
    low: float
    """One in twenty is shorter, in s."""
    high: float
    """One in twenty is longer, in s."""
    longest: float
    """In s."""
    longest_at: float
    """Time of the row before the longest one, in s."""
    long: int
    """How many are above 1.5 times the usual one."""
    is_even: bool
    """Whether all are within a twentieth of a multiple of the usual one."""

    def __str__(self) -> str:
        above = f", {self.long} above {gaps.USUAL_FACTOR} times the usual" if self.long else ""
        ends = f"nine in ten between {brief_duration(self.low)} and {brief_duration(self.high)}"
        return f"{brief_duration(self.usual)} as a rule, {ends}, the longest {brief_duration(self.longest)}{above}"


def measure(topic: str, times_ns: Times, spacings_ns: Times) -> Spacings | None:
    """Measure a topic's spacings; None where there are too few to tell.

    Args:
        topic: Its name.
        times_ns: Of the row before each spacing, [N].
        spacings_ns: [N].
    """
    if len(spacings_ns) < FEWEST:
        return None
    low, middle, high = (float(spacing) for spacing in np.quantile(spacings_ns, (_LOW, 0.5, _HIGH)))
    at = int(spacings_ns.argmax())
    return Spacings(
        topic=topic,
        count=len(spacings_ns),
        usual=middle / clock.NS_PER_S,
        low=low / clock.NS_PER_S,
        high=high / clock.NS_PER_S,
        longest=clock.to_seconds(int(spacings_ns[at])),
        longest_at=clock.to_seconds(int(times_ns[at])),
        long=int((spacings_ns > gaps.USUAL_FACTOR * middle).sum()),
        is_even=bool(_on_grid(spacings_ns, middle).all()),
    )


def limit_ns(spacings_ns: Times) -> float:
    """Return the longest spacing that is no gap, in ns."""
    usual_ns = gaps.usual(spacings_ns)
    limit = gaps.USUAL_FACTOR * usual_ns
    is_long = spacings_ns > limit
    if not is_long.any():
        return limit
    on_grid = _on_grid(spacings_ns, usual_ns)
    if on_grid.mean() >= _SHARE_ON_GRID and on_grid[is_long].mean() >= _SHARE_ON_GRID:
        return limit
    varies = float((np.abs(spacings_ns[~is_long] - usual_ns) > _OFF * usual_ns).mean()) > _SHARE_OFF
    missing = float((np.round(spacings_ns[is_long] / usual_ns) - 1).sum())
    are_multiples = float(_on_grid(spacings_ns[is_long], usual_ns, _NEAR_GRID).mean()) >= _SHARE_NEAR_GRID
    if not varies and are_multiples and missing > _SHARE_MISSING * len(spacings_ns):
        return limit
    seldom_ns = float(np.quantile(spacings_ns, _HIGH))
    return max(gaps.USUAL_FACTOR * seldom_ns, usual_ns + _HICCUP_NS)


def _on_grid(spacings_ns: Times, usual_ns: float, within: float = _ON_GRID) -> npt.NDArray[np.bool_]:
    """Tell which spacings lie close to a multiple of the usual spacing, within a part of it."""
    times = spacings_ns / max(usual_ns, 1.0)
    is_near: npt.NDArray[np.bool_] = np.abs(times - np.maximum(np.round(times), 1.0)) <= within
    return is_near
