"""What is wrong with one topic, told by its times and sequence numbers."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from .. import clock
from . import gaps, setbacks
from .findings import Finding, Kind, rows_said, said
from .setbacks import Step
from .written import Written

Times = npt.NDArray[np.uint64]

_FEWEST_SPACINGS = 5
"""Fewer say nothing about what is usual."""

_OFF, _SHARE_OFF = 0.2, 0.05
"""A topic is irregular if more than this share of its spacings is off the median by more than a fifth of it."""

_SELDOM = 0.95
"""A spacing is a gap in an irregular topic if it is clearly longer than this share of all spacings."""

_EPOCH_NS = np.uint64(int(clock.EPOCH_LIKE_S) * clock.NS_PER_S)
_HALF = 2**31
_MOST_ALIKE = 1000


def topic(name: str, runs: Sequence[Written]) -> list[Finding]:
    """Judge a topic.

    Args:
        name: The topic.
        runs: What each recorder wrote of it.
    """
    notes = _Notes(name)
    for run in runs:
        _find_missing(run, notes)
    near_0 = [run.times_ns[run.times_ns < _EPOCH_NS] for run in runs]
    wall = [run.times_ns[run.times_ns >= _EPOCH_NS] for run in runs]
    early, late = clocks(runs)
    if early and late:
        first = next(int(run.times_ns[0]) for run in runs if len(run.times_ns))
        what = f"two kinds of clocks on one topic: {rows_said(early)} near 0, {rows_said(late)} in wall-clock time"
        notes.add("clock", first, what)
    _find_restarts(near_0, notes)
    pauses = {int(run.times_ns.min()) for run in runs if run.is_ours and len(run.times_ns)}
    for times in (near_0, wall):
        _judge_times([one for one in times if len(one)], pauses, notes)
    return notes.all()


def clocks(runs: Sequence[Written]) -> tuple[int, int]:
    """Return how many messages have times near 0, and how many are at wall-clock times."""
    late = sum(int((run.times_ns >= _EPOCH_NS).sum()) for run in runs)
    return sum(len(run.times_ns) for run in runs) - late, late


class _Notes:
    """Findings about one topic; of very many alike, the first ones and how many more there are."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._found: dict[Kind, list[Finding]] = {}
        self._more: dict[Kind, int] = {}

    def add(self, kind: Kind, time_ns: int, what: str) -> None:
        found = self._found.setdefault(kind, [])
        if len(found) < _MOST_ALIKE:
            found.append(Finding(self._name, kind, clock.to_seconds(time_ns), what))
        else:
            self._more[kind] = self._more.get(kind, 0) + 1

    def all(self) -> list[Finding]:
        for kind, count in self._more.items():
            last = self._found[kind].pop()
            self._found[kind].append(Finding(self._name, kind, last.time, f"{last.what}; and {count} more like this"))
        return [one for found in self._found.values() for one in found]


def _find_missing(run: Written, notes: _Notes) -> None:
    """Find numbers that no message has; of other tools' files, only where the numbers mostly go on by ones."""
    steps = np.diff(run.sequences)  # unsigned: a counter may begin again at 0
    if not run.is_ours and 2 * int((steps == 1).sum()) <= len(steps):
        return
    for at in np.flatnonzero((steps > 1) & (steps < _HALF)).tolist():
        count, first = int(steps[at]) - 1, int(run.sequences[at]) + 1
        what = f"{rows_said(count)} missing after this one (sequence numbers {first} to {first + count - 1})"
        notes.add("missing", int(run.times_ns[at]), what)


def _find_restarts(runs: Sequence[Times], notes: _Notes) -> None:
    """Find recorders whose clock started near 0 again, so that their rows lie among those of the one before."""
    runs = [run for run in runs if len(run)]
    for before, after in pairwise(runs):
        if after.min() <= before.max():
            end = said(clock.to_seconds(int(before.max())))
            what = f"the times of the next recorder begin here, before the end of the last one at {end}"
            notes.add("clock", int(after.min()), what)


def _judge_times(runs: Sequence[Times], pauses: set[int], notes: _Notes) -> None:
    """Judge the times of one kind of clock.

    Args:
        runs: Of each recorder, in the order of writing.
        pauses: Times before which nobody recorded.
        notes: Gets what is wrong.
    """
    times = np.unique(np.concatenate(runs)) if runs else np.empty(0, np.uint64)
    spacings = np.diff(times)
    usual_ns = gaps.usual(spacings)
    leaps: set[int] = set()
    for run in runs:
        lates, steps = setbacks.find(run)
        for late in lates:
            by = said(clock.to_seconds(late.by_ns))
            notes.add("late", int(run[late.first]), f"{rows_said(late.count)} written after one of {by} later")
        for step in steps:
            leaps.add(step.to_ns)
            notes.add("clock", step.to_ns, _said_of(step))
    if len(spacings) < _FEWEST_SPACINGS:
        return
    limit_ns = _judge_spacings(times, spacings, usual_ns, notes)
    for at in np.flatnonzero(spacings > limit_ns).tolist():
        start_ns, end_ns = int(times[at]), int(times[at + 1])
        if end_ns not in leaps and end_ns not in pauses:
            missing = max(round((end_ns - start_ns) / usual_ns) - 1, 0)
            duration = said(clock.to_seconds(end_ns - start_ns))
            notes.add("gap", start_ns, f"no row for {duration}, in which there are {missing} as a rule")


def _judge_spacings(times: Times, spacings: Times, usual_ns: float, notes: _Notes) -> float:
    """Tell whether the spacings vary; return the longest one that is no gap, in ns."""
    longest_ns = gaps.USUAL_FACTOR * usual_ns
    near = spacings[spacings <= longest_ns]
    if float((np.abs(near - usual_ns) > _OFF * usual_ns).mean()) <= _SHARE_OFF:
        return longest_ns
    low, middle, high = (float(one) for one in np.quantile(spacings, (1 - _SELDOM, 0.5, _SELDOM)))
    ends = f"{said(low / clock.NS_PER_S)} and {said(high / clock.NS_PER_S)}"
    what = f"the spacings vary: {said(middle / clock.NS_PER_S)} in the middle, nine in ten between {ends}"
    notes.add("irregular", int(times[0]), what)
    return gaps.USUAL_FACTOR * high


def _said_of(step: Step) -> str:
    by = said(clock.to_seconds(abs(step.to_ns - step.from_ns)))
    before = said(clock.to_seconds(step.from_ns))
    if step.to_ns < step.from_ns:
        return f"the clock steps back by {by}, after {before}"
    return f"times leap on by {by}, after {before}: the clock was set, or nothing ran"
