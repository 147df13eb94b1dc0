"""Numbers the frames of samples at a constant rate, and finds the times of a new rate."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...clock import NS_PER_S

Times = npt.NDArray[np.int64]

TOLERANCE = 0.01
"""Samples are evenly spaced if no distance is off by more than this part of it."""

LONGEST_GAP_FRAMES = 2.5
LONGEST_GAP_S = 0.1
"""Gaps that are longer than both limits are not interpolated."""

_NOISE = 1e-8
"""The relative precision of a rate from times in nanoseconds. A rounded rate that is as near is written instead."""

_EMPTY_FRAMES_FACTOR = 100
_EMPTY_FRAMES_FREE = 1_000_000


@dataclass(frozen=True, slots=True)
class Spacing:
    """How far samples are apart."""

    median_ns: float
    mean_ns: float
    """The mean of the distances that are no gaps."""
    shortest_ns: int
    longest_ns: int
    worst_ns: int
    """Time of the sample whose distance from the sample before it is farthest from even, in ns."""
    frames: Times | None
    """The number of each sample at a constant rate, from 0; None if they are not evenly spaced."""

    @property
    def rate(self) -> float:
        """Samples a second where there are no gaps, in Hz."""
        return NS_PER_S / self.mean_ns if self.mean_ns else 0.0


def spacing(times_ns: Times) -> Spacing:
    """Look at the times of samples, ascending and distinct, in ns.

    A distance near a whole number of medians is even: there are samples missing in between.
    """
    if len(times_ns) < 2:
        return Spacing(0.0, 0.0, 0, 0, int(times_ns[0]) if len(times_ns) else 0, np.arange(len(times_ns)))
    steps = np.diff(times_ns)
    shortest, longest = int(steps.min()), int(steps.max())
    # `lower` gives a distance that occurs; the mean of two different ones would be the spacing of no sample.
    typical = float(np.quantile(steps, 0.5, method="lower"))
    mean = float(steps[steps <= LONGEST_GAP_FRAMES * typical].mean())
    for base in (typical, float(shortest)):  # where most samples have a hole behind them, the shortest is the frame
        counts = np.maximum(np.rint(steps / base), 1)
        off = np.abs(steps / counts - base)
        if off.max() <= TOLERANCE * base:
            frames = np.concatenate(([0], np.cumsum(counts))).astype(np.int64)
            return Spacing(base, mean, shortest, longest, int(times_ns[1]), frames)
    worst = int(np.abs(steps - typical).argmax())
    return Spacing(typical, mean, shortest, longest, int(times_ns[worst + 1]), None)


def mean_rate(times_ns: Times, frames: Times) -> float:
    """Return the rate over all frames, in Hz; 0.0 for fewer than two, and for frames of one time."""
    if len(frames) < 2 or times_ns[-1] == times_ns[0]:
        return 0.0
    rate = float(frames[-1]) * NS_PER_S / float(times_ns[-1] - times_ns[0])
    rounded = round(rate, 6)
    return rounded if abs(rate - rounded) <= _NOISE * rate else rate


def too_sparse(frames: Times) -> bool:
    """Whether a file of all frames would consist of empty frames almost entirely: 100 and more for each sample."""
    return len(frames) > 0 and int(frames[-1]) > _EMPTY_FRAMES_FREE + _EMPTY_FRAMES_FACTOR * len(frames)


def count_at(rate: float, first_s: float, last_s: float) -> int:
    """Return how many frames a rate has between two times, the first included, and the last if it falls on one."""
    # A last frame that rounding puts just behind the end still counts.
    return math.floor((last_s - first_s) * rate + 1e-6) + 1


def longest_gap_s(median_ns: float) -> float:
    """Return across how long a gap samples may be interpolated, in s."""
    return max(LONGEST_GAP_FRAMES * median_ns / NS_PER_S, LONGEST_GAP_S)


def exact_origin(first_s: float, last_s: float) -> float:
    """Return a time at or just before the first one, from which every time counts without rounding.

    A double `t` up to `last_s` is a whole number of its own units in the last place. Of an origin that is a whole
    number of the largest of these, `t - origin` is exact, and so is `origin + (t - origin)`.
    """
    unit = math.ulp(last_s)
    return math.floor(first_s / unit) * unit
