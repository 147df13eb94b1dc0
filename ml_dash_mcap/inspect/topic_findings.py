"""Checks one topic by its times and sequence numbers, and collects the findings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from .. import clock
from . import clock_passes, gaps, row_spacing, time_steps_back
from .clock_passes import Counted
from .findings import Finding, Gathering, Occurrence
from .plain_words import rows_text, seconds_text
from .row_spacing import Spacings
from .time_steps_back import Step
from .writing_order import Written

Times = npt.NDArray[np.uint64]

_EPOCH_NS = np.uint64(int(clock.EPOCH_LIKE_S) * clock.NS_PER_S)
# Sequence numbers are unsigned: a difference from here on is a step back.
_HALF = 2**31
_WORST = 1e12
"""Beyond any step of a clock, in s: rows that are merged are worse than all of these."""


def topic(
    name: str, runs: Sequence[Written], counted: Mapping[tuple[str, str], Counted]
) -> tuple[list[Finding], Spacings | None]:
    """Check one topic.

    Args:
        name: The topic.
        runs: Its messages by recorder.
        counted: The figures that recorders kept while they wrote, by recorder and topic.

    Returns:
        Its findings, and how far apart its rows are.
    """
    gathered = Gathering(name)
    for run in runs:
        _find_missing(run, gathered)
    _find_two_clocks(runs, gathered)
    pauses = {int(run.times_ns.min()) for run in runs if run.is_ours and len(run.times_ns)}
    measured = [
        _check_clock(name, part, pauses, counted, gathered)
        for part in (_parts(runs, near_0=True), _parts(runs, near_0=False))
    ]
    _find_mixed_unseen(name, runs, counted, gathered)
    spacings = [some for some in measured if some is not None]
    return gathered.all(), max(spacings, key=lambda some: some.count, default=None)


def clocks(runs: Sequence[Written]) -> tuple[int, int]:
    """Return how many messages have times near 0, and how many are at wall-clock times."""
    late = sum(int((run.times_ns >= _EPOCH_NS).sum()) for run in runs)
    return sum(len(run.times_ns) for run in runs) - late, late


def _parts(runs: Sequence[Written], *, near_0: bool) -> list[tuple[Written, Times]]:
    """Return the times of each recorder that are near 0, or those that are not, where it has any."""
    parts = [(run, run.times_ns[(run.times_ns < _EPOCH_NS) == near_0]) for run in runs]
    return [(run, times) for run, times in parts if len(times)]


def _find_missing(run: Written, gathered: Gathering) -> None:
    """Find sequence numbers that no message has.

    In other tools' files, that is only looked for where most numbers are one greater than the number before.
    """
    steps = np.diff(run.sequences)  # unsigned: a counter may begin again at 0
    if not run.is_ours and 2 * int((steps == 1).sum()) <= len(steps):
        return
    for at in np.flatnonzero((steps > 1) & (steps < _HALF)).tolist():
        count, first = int(steps[at]) - 1, int(run.sequences[at]) + 1
        what = f"{rows_text(count)} missing after this one (sequence numbers {first} to {first + count - 1})"
        gathered.add("missing", _at(int(run.times_ns[at]), what, count, count))


def _find_two_clocks(runs: Sequence[Written], gathered: Gathering) -> None:
    early, late = clocks(runs)
    if early and late:
        first = next(int(run.times_ns[0]) for run in runs if len(run.times_ns))
        what = f"two kinds of clocks on one topic: {rows_text(early)} near 0, {rows_text(late)} in wall-clock time"
        gathered.add("clock", _at(first, what, size=_WORST))


def _check_clock(
    name: str,
    parts: Sequence[tuple[Written, Times]],
    pauses: set[int],
    counted: Mapping[tuple[str, str], Counted],
    gathered: Gathering,
) -> Spacings | None:
    """Check the times of one kind of clock, near 0 or not; returns how far apart they are.

    Args:
        name: The topic.
        parts: Of each recorder, its times in the order of writing.
        pauses: Times of first messages, before which no recorder ran.
        counted: The figures that recorders kept, by recorder and topic.
        gathered: Gets the findings.
    """
    leaps: set[int] = set()
    for run, times in parts:
        lates, steps = time_steps_back.find(times)
        for late in lates:
            what = f"{rows_text(late.count)} written after one of {_span(late.by_ns)} later"
            gathered.add("late", _at(int(times[late.first]), what, late.count, clock.to_seconds(late.by_ns)))
        for step in steps:
            leaps.add(step.to_ns)
            size = clock.to_seconds(abs(step.to_ns - step.from_ns))
            gathered.add("clock", _at(step.to_ns, _step_text(step), size=size))
        if run.merges:
            _find_mixed(times, steps, counted.get((run.run, name), Counted()), gathered)
    _find_restarts(parts, gathered)
    times = np.unique(np.concatenate([times for _, times in parts])) if parts else np.empty(0, np.uint64)
    widths = np.diff(times)
    if len(widths) < row_spacing.FEWEST:
        return None
    is_pause = np.isin(times[1:], np.fromiter(pauses | leaps, np.uint64, len(pauses | leaps)))
    _find_gaps(times, widths, is_pause, gathered)
    return row_spacing.measure(name, times[:-1][~is_pause], widths[~is_pause])


def _find_mixed(times: Times, steps: Sequence[Step], hidden: Counted, gathered: Gathering) -> None:
    """Find rows that are merged with rows of the same time from before a step back of one recorder's clock.

    Those of one block were merged when it was written, and the recorder counted them. Those of several are in the file.
    """
    backs = [step for step in steps if step.to_ns < step.from_ns]
    rows = clock_passes.shared_within(times) + hidden.overwritten
    if not rows or not (backs or hidden.overwritten):
        return
    count = hidden.steps if hidden.overwritten else len(backs)
    by_ns = max([hidden.by_ns, *(step.from_ns - step.to_ns for step in backs)])
    begins = f"time steps back {count} time{'' if count == 1 else 's'}, by {_span(by_ns)} at most"
    what = f"{begins}, and {_merged_text(rows)} rows of the same time from before"
    gathered.add("clock", _at(backs[0].to_ns if backs else int(times.min()), what, rows, _WORST + rows))


def _find_mixed_unseen(
    name: str, runs: Sequence[Written], counted: Mapping[tuple[str, str], Counted], gathered: Gathering
) -> None:
    """Find rows that came late with more fields for rows of the same time: nothing of these is lost."""
    for run in runs:
        hidden = counted.get((run.run, name), Counted())
        rows = hidden.merged - hidden.overwritten
        if rows > 0 and len(run.times_ns):
            times = f"up to {_span(hidden.by_ns)} later"
            what = f"{rows_text(rows)} appended after one of {times}, with more fields for rows of the same time"
            gathered.add("late", _at(int(run.times_ns.min()), what, rows, clock.to_seconds(hidden.by_ns)))


def _find_restarts(parts: Sequence[tuple[Written, Times]], gathered: Gathering) -> None:
    """Find recorders whose times begin before the end of an earlier recorder's times."""
    earlier: list[Times] = []
    latest_ns = -1
    for run, times in parts:
        first_ns = int(times.min())
        if first_ns <= latest_ns:
            _add_restart(first_ns, latest_ns, clock_passes.shared_with(times, earlier) if run.merges else 0, gathered)
        earlier.append(times)
        latest_ns = max(latest_ns, int(times.max()))


def _add_restart(first_ns: int, latest_ns: int, merged: int, gathered: Gathering) -> None:
    """Add a recorder that begins before the end of the last one; on the wall clock, two may well record at once."""
    what = f"the times of the next recorder begin here, before the end of the last one at {_span(latest_ns)}"
    if merged:
        what += f", and {_merged_text(merged)} rows of the same time there; Recording(path, run=...) reads one run"
        gathered.add("clock", _at(first_ns, what, merged, _WORST + merged))
    elif first_ns < _EPOCH_NS:
        gathered.add("clock", _at(first_ns, what, size=clock.to_seconds(latest_ns - first_ns)))


def _find_gaps(times: Times, widths: Times, is_pause: npt.NDArray[np.bool_], gathered: Gathering) -> None:
    """Find spacings that are too long, and that no pause of the recording explains.

    Args:
        times: In order, each once, [N + 1].
        widths: The spacings between them, [N].
        is_pause: Which of these are pauses, [N].
        gathered: Gets the findings.
    """
    ours = widths[~is_pause]
    if not len(ours):
        return
    usual_ns, limit_ns = gaps.usual(ours), row_spacing.limit_ns(ours)
    for at in np.flatnonzero((widths > limit_ns) & ~is_pause).tolist():
        width = int(widths[at])
        missing = max(round(width / usual_ns) - 1, 0)
        what = f"no row for {_span(width)}, in which there are {missing} as a rule"
        gathered.add("gap", _at(int(times[at]), what, missing, clock.to_seconds(width)))


def _at(time_ns: int, what: str, rows: int = 0, size: float = 0.0) -> Occurrence:
    return Occurrence(clock.to_seconds(time_ns), what, rows, size)


def _span(ns: int) -> str:
    return seconds_text(clock.to_seconds(ns))


def _merged_text(rows: int) -> str:
    return f"{rows_text(rows)} {'is' if rows == 1 else 'are'} merged with"


def _step_text(step: Step) -> str:
    by = _span(abs(step.to_ns - step.from_ns))
    before = _span(step.from_ns)
    if step.to_ns < step.from_ns:
        return f"the clock steps back by {by}, after {before}"
    return f"times leap on by {by}, after {before}: the clock was set, or nothing ran"
