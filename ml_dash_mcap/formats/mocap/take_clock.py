"""Makes the clock of a take: the times of the topics' rows, or a rate that they are resampled to."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ... import clock as clocks
from ...clock import NS_PER_S
from ...errors import ConversionError, OptionError
from ...query import counts, topic_rows
from ...rows.plain_row import TIME_KEY
from ..export_job import Job
from . import frame_numbers as frames
from .frame_numbers import Spacing
from .take_options import Rate

_HIGHEST_RATE = 1e6

_MOST_DECIMALS = 9
"""Nanoseconds."""


class ClockPart(NamedTuple):
    """Some frames of a clock."""

    frames: npt.NDArray[np.int64]
    times: npt.NDArray[np.float64]
    """The times of the frames, as `_ts`, in s. A frame without a sample has a time between its neighbours."""


@dataclass(frozen=True, slots=True)
class Clock:
    """The frames of a take and their times."""

    origin: float
    """The time stamp from which the file's times count, in s."""
    rate: float
    """Frames a second; 0.0 if there are fewer than two."""
    count: int
    is_resampled: bool
    medians_ns: dict[str, float]
    """The median distance of each topic's samples, in ns."""
    times_ns: npt.NDArray[np.int64]
    """The times of all samples, ascending, if they are written as they are; else empty."""
    numbers: npt.NDArray[np.int64]
    """The frame of each of them."""
    first_s: float
    """The first time stamp, in s."""

    @property
    def stated_rate(self) -> float:
        """Frames a second as files say it: 1.0 of a single frame, because other programs refuse a rate of 0."""
        return self.rate or 1.0

    def time_decimals(self, decimals: int | None) -> int | None:
        """Return how many decimals times need so that no two frames print the same; None for all.

        Args:
            decimals: That numbers have; times have no fewer.
        """
        if decimals is None:
            return None
        steps = np.diff(self.times_ns)
        shortest_s = min(steps[steps > 0], default=0) / NS_PER_S
        if self.is_resampled and self.rate:
            shortest_s = 1 / self.rate
        needed = math.ceil(-math.log10(shortest_s * frames.TOLERANCE)) if shortest_s else 0
        return max(decimals, min(needed, _MOST_DECIMALS))

    def part(self, first: int, stop: int) -> ClockPart:
        """Return the frames [first, stop)."""
        which = np.arange(first, stop)
        if self.is_resampled:
            return ClockPart(which, self.first_s + which / self.stated_rate)
        after = np.minimum(np.searchsorted(self.numbers, which), len(self.numbers) - 1)
        before = np.maximum(after - 1, 0)
        span = np.maximum(self.numbers[after] - self.numbers[before], 1)
        back = (self.numbers[after] - which) * (self.times_ns[after] - self.times_ns[before]) / span
        times = self.times_ns[after] - np.rint(back).astype(np.int64)
        return ClockPart(which, np.array(clocks.to_seconds_each(times.tolist())))

    def frames_of(self, times: npt.NDArray[np.float64], topic: str) -> npt.NDArray[np.int64]:
        """Return the frames of a topic's rows, by their time stamps, ascending, in s.

        Raises:
            ConversionError: Two of them have the same.
        """
        samples = self._find(times)
        again = np.arange(len(samples)) - np.searchsorted(samples, samples)
        samples = np.minimum(samples + again, len(self.times_ns) - 1)
        numbers = self.numbers[samples]
        wrong = np.flatnonzero((np.diff(numbers) == 0) | (self.times_ns[samples] != self.times_ns[samples - again])[1:])
        if len(wrong):
            at = int(wrong[0])
            raise ConversionError(
                f"topic {topic!r}: its rows at _ts={float(times[at])!r} and {float(times[at + 1])!r} are in the same"
                " nanosecond; pass rate= to resample"
            )
        return numbers

    def _find(self, times: npt.NDArray[np.float64]) -> npt.NDArray[np.intp]:
        """Return which sample each time is; of several at one time, the first."""
        times_ns = clocks.to_nanoseconds_each(times).astype(np.int64)
        after = np.minimum(np.searchsorted(self.times_ns, times_ns), len(self.times_ns) - 1)
        before = np.maximum(after - 1, 0)
        # The double of a time may lie a few nanoseconds beside the stored time, so the nearest sample is taken.
        is_before = np.abs(self.times_ns[before] - times_ns) < np.abs(self.times_ns[after] - times_ns)
        return np.searchsorted(self.times_ns, self.times_ns[np.where(is_before, before, after)])


def find(
    job: Job,
    topics: Iterable[str],
    rate: Rate,
    *,
    needs_even: bool = True,
    with_origin: Iterable[str] = (),
) -> Clock:
    """Lay the clock of a take.

    Args:
        job: Its recording and time range.
        topics: That have a part in it.
        rate: Frames a second, "median", or None.
        needs_even: Whether the format has no times of its own, so that samples must be evenly spaced.
        with_origin: Topics that are written with the same origin, elsewhere.

    Raises:
        ConversionError: They are not, and no rate was given; or there are no rows.
        OptionError: The rate is none.
    """
    check_rate(rate)
    low, high = topic_rows.to_ns_range(job.low, job.high)
    topics = list(dict.fromkeys(topics))
    every = {topic: _times(job, topic, low, high) for topic in dict.fromkeys((*topics, *with_origin))}
    times = {topic: every[topic] for topic in topics if len(every[topic])}
    if not times:
        raise ConversionError("there are no rows to export in this time range")
    if needs_even and rate is None:
        _refuse_same(times)
    spacings = {topic: frames.spacing(np.unique(times_ns)) for topic, times_ns in times.items()}
    medians = {topic: spacing.median_ns for topic, spacing in spacings.items()}
    medians.update((topic, 0.0) for topic in topics if topic not in medians)
    union = _union(list(times.values()))
    first_s = _first(job, times)
    started = {topic: times_ns for topic, times_ns in every.items() if len(times_ns)}
    last_ns = max(int(times_ns[-1]) for times_ns in started.values())
    origin = frames.exact_origin(_first(job, started), clocks.to_seconds(last_ns + 1))
    if rate is None:
        numbers = _numbers(union, spacings) if needs_even else np.arange(len(union))
        mean = frames.mean_rate(union, numbers)
        return Clock(origin, mean, int(numbers[-1]) + 1, False, medians, union, numbers, first_s)
    distances = [median for median in medians.values() if median]
    hz = float(rate) if rate != "median" else (NS_PER_S / min(distances) if distances else 0.0)
    count = frames.count_at(hz, first_s, clocks.to_seconds(int(union[-1]))) if hz else 1
    none: npt.NDArray[np.int64] = np.empty(0, np.int64)
    return Clock(origin, hz, count, True, medians, none, none, first_s)


def _times(job: Job, topic: str, low: int, high: int) -> npt.NDArray[np.int64]:
    """Return the times of a topic's rows, ascending, in ns; those of a track merge where their doubles are the same."""
    stored = job.stored(topic)
    times_ns = np.sort(stored.times(low, high).astype(np.int64))
    if not stored.is_track or np.diff(times_ns).all():
        return times_ns
    distinct = np.unique(times_ns)
    is_whole = len(times_ns) == len(stored.times())
    # Reading the rows is slow; it is needed only where two different doubles fall into one nanosecond.
    if is_whole and counts.count(stored) == len(distinct):
        return distinct
    stamps = np.array([row[TIME_KEY] for row in job.part(topic).rows()], np.float64)
    return clocks.to_nanoseconds_each(stamps).astype(np.int64)  # two doubles may be in one nanosecond


def _union(times: list[npt.NDArray[np.int64]]) -> npt.NDArray[np.int64]:
    """Return all times, ascending; one that a topic has several times as often as the topic that has it most often."""
    if all(np.diff(times_ns).all() for times_ns in times):
        return np.unique(np.concatenate(times))
    numbered = [
        np.stack((times_ns, np.arange(len(times_ns)) - np.searchsorted(times_ns, times_ns)), axis=1)
        for times_ns in times
    ]
    return np.unique(np.concatenate(numbered), axis=0)[:, 0]


def _refuse_same(times: dict[str, npt.NDArray[np.int64]]) -> None:
    """Raise ConversionError for rows of one topic that have the same time, where each frame has one of its own."""
    for topic, times_ns in times.items():
        same = np.flatnonzero(np.diff(times_ns) == 0)
        if len(same):
            raise ConversionError(
                f"topic {topic!r}: {len(same)} of its rows have the time of the row before, for the first time at"
                f" _ts={clocks.to_seconds(int(times_ns[same[0]]))!r}, and a file of frames has no place for both; pass"
                " rate= to resample, or export it as 'sto', 'csv' or layout='wide', which have"
            )


def check_rate(rate: Rate) -> None:
    """Raise OptionError unless something is a rate."""
    if rate is None or rate == "median":
        return
    is_number = isinstance(rate, (int, float)) and not isinstance(rate, bool)
    if not is_number or not 0 < rate <= _HIGHEST_RATE:
        raise OptionError(f"rate={rate!r}: pass frames a second, above 0, or 'median', or None for the rows' own times")


def _first(job: Job, times: dict[str, npt.NDArray[np.int64]]) -> float:
    """Return the exact time stamp of the first row of several topics, in s."""
    first_ns = min(times_ns[0] for times_ns in times.values())
    starting = [topic for topic, times_ns in times.items() if times_ns[0] == first_ns]
    return min(float(next(job.part(topic).rows())[TIME_KEY]) for topic in starting)


def _numbers(union: npt.NDArray[np.int64], spacings: dict[str, Spacing]) -> npt.NDArray[np.int64]:
    both = frames.spacing(union)
    if both.frames is None:
        named = next(((topic, spacing) for topic, spacing in spacings.items() if spacing.frames is None), None)
        if named is None:
            names = " and ".join(repr(topic) for topic in spacings)
            reason = f"the topics {names} are evenly spaced each, but not at the same times"
        else:
            topic, spacing = named
            reason = (
                f"topic {topic!r} is not evenly spaced: its rows are {spacing.shortest_ns / 1e6:.6g} to"
                f" {spacing.longest_ns / 1e6:.6g} ms apart (median {spacing.median_ns / 1e6:.6g} ms), for the first"
                f" time at _ts={clocks.to_seconds(spacing.worst_ns)!r}"
            )
        mean = max(spacing.rate for spacing in spacings.values())
        raise ConversionError(f"{reason}; pass rate={mean:.3g} or rate='median' to resample")
    if frames.too_sparse(both.frames):
        raise ConversionError(
            f"{len(both.frames)} rows would become {int(both.frames[-1]) + 1} frames, for there are gaps between them;"
            " choose a part by start= and end="
        )
    return both.frames
