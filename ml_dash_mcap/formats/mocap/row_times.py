"""Times the rows of a table: by the times that the file prints, or by its frame numbers and rate."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ...errors import ConversionWarning
from ..text.headers import preview
from ..text.number_cells import Cells, Floats, NumberPart

_SLACK = 1e-6
"""The part of the last printed digit by which doubles may be off."""


@dataclass(frozen=True, slots=True)
class Timing:
    """How rows get their time stamps."""

    origin: float
    """The time stamp of the file's time 0, in s."""
    rate: float | None = None
    """At which frames say the time, in Hz; None if the printed times do."""
    first: float = 0.0
    """The frame at `base`."""
    base: float = 0.0
    """In s, as the file counts."""
    source: str = ""
    """A description of the source of the times; "" for printed times."""
    shift: float = 0.0
    """By how much all times were moved, so that none is below 0, in s."""

    def stamps(self, frames: Floats, printed: Floats) -> Floats:
        """Return the time stamps of rows, [N], s."""
        times = printed if self.rate is None else self.base + (frames - self.first) / self.rate
        stamps = self.origin + times
        return stamps + self.shift if self.shift else stamps

    @property
    def metadata(self) -> dict[str, Any]:
        """How the times were made, for the metadata of topics; empty for printed times."""
        done: dict[str, Any] = {}
        if self.source:
            done["time_source"] = self.source
        if self.shift:
            done["time_shift_s"] = self.shift
        return done


@dataclass(frozen=True, slots=True)
class Clue:
    """Where a table says times."""

    time: int
    """The column of printed times."""
    frame: int | None = None
    """The column of frame numbers; None to count rows."""
    rate: float | None = None
    """Frames a second, as the header says, in Hz."""
    starts: Sequence[float] = (0.0,)
    """Frames that may be at time 0."""

    def frames(self, values: Floats, first_row: int) -> Floats:
        """Return the frame of each row; rows are counted from `first_row`."""
        if self.frame is None:
            return np.arange(first_row, first_row + len(values), dtype=np.float64)
        return values[:, self.frame]


def find(clue: Clue, cells: Cells, file: BinaryIO, line: int, origin: float) -> Timing:
    """Find out how a table's rows get their times.

    The printed times count, unless neighbouring frames print the same one because it has too few decimals. Then the
    frames' own times count, if the file says a rate and every printed time agrees with it.

    Args:
        clue: Where the table says times.
        cells: How it is parsed.
        file: At the table's first line; it stays there.
        line: The number of that line.
        origin: The time stamp of time 0, in s.
    """
    head, tail = preview(file)
    head, tail = _rows(cells, head), _rows(cells, tail)
    if clue.rate and clue.rate > 0 and (_is_coarse(cells, clue, head) or _is_coarse(cells, clue, tail)):
        grid = max(_grid(cells, clue.time, head), _grid(cells, clue.time, tail))
        at = file.tell()
        timing = _by_frames(clue, cells.read(file, line), grid)
        # The same cells are parsed again for the rows, and must not be counted twice.
        cells.bad = 0
        file.seek(at)
        if timing is not None:
            return replace(timing, origin=origin)
    return Timing(origin)


def settled(
    path: Path, clue: Clue, cells: Cells, file: BinaryIO, line: int, origin: float, *, is_asked: bool
) -> Timing:
    """Return how the rows of a file's only table get their times, none of which lies below 0.

    Args:
        path: The file.
        clue: As in `find`, like `cells`, `file`, `line` and `origin`.
        cells: How the table is parsed.
        file: At the table's first line; it stays there.
        line: The number of that line.
        origin: The time stamp of time 0, in s.
        is_asked: As in `not_below_zero`.
    """
    timing = find(clue, cells, file, line, origin)
    return not_below_zero(path, timing, [first_stamp(clue, cells, file, timing)], is_asked=is_asked)


def not_below_zero(path: Path, timing: Timing, first_s: Iterable[float], *, is_asked: bool) -> Timing:
    """Return the timing moved so that a take that begins before time 0 begins there, with a warning.

    Args:
        path: The file.
        timing: As the file says it.
        first_s: The first time stamps of its tables by that timing, in s.
        is_asked: Whether the caller gave the time stamp of time 0: then nothing is moved.
    """
    stamps = [time for time in first_s if time == time]
    if is_asked or not stamps or min(stamps) >= 0:
        return timing
    shift = -min(stamps)
    warnings.warn(
        f"{path}: its times begin at {-shift!r} s, and those of a recording at 0: all are moved by {shift!r} s, which"
        " the topics' metadata say as time_shift_s; pass start= to say the time stamp of time 0",
        ConversionWarning,
        stacklevel=3,
    )
    return replace(timing, shift=shift)


def first_stamp(clue: Clue, cells: Cells, file: BinaryIO, timing: Timing) -> float:
    """Return the time stamp of the first row of a table that has one, in s; NaN if none has."""
    head, _ = preview(file)
    values = cells.sample(_rows(cells, head))
    stamps = timing.stamps(clue.frames(values, 0), values[:, clue.time])
    stamps = stamps[~np.isnan(stamps)]
    return float(stamps[0]) if len(stamps) else float("nan")


def _rows(cells: Cells, lines: Sequence[str]) -> list[str]:
    return [line for line in lines if not cells.dialect.is_blank(line)]


def _is_coarse(cells: Cells, clue: Clue, lines: Sequence[str]) -> bool:
    """Whether the printed times of some lines cannot tell neighbouring frames apart."""
    assert clue.rate
    times = cells.sample(lines)[:, clue.time]
    return 1 / clue.rate < _grid(cells, clue.time, lines) * (1 - _SLACK) or bool((np.diff(times) == 0).any())


def _grid(cells: Cells, column: int, lines: Sequence[str]) -> float:
    """Return what the last printed digit of the most precise time is worth, in s."""
    finest = 0
    for line in lines:
        row = cells.dialect.split(line)
        if column < len(row):
            try:
                exponent = Decimal(row[column].replace(",", ".")).as_tuple().exponent
            except InvalidOperation:
                continue
            finest = min(finest, exponent) if isinstance(exponent, int) else finest
    return 10.0**finest


def _by_frames(clue: Clue, parts: Iterable[NumberPart], grid: float) -> Timing | None:
    """Return the times of frames at the header's rate; None if a printed time contradicts them."""
    assert clue.rate
    first: tuple[float, float] | None = None
    low, high, last, row = np.inf, -np.inf, -np.inf, 0
    for part in parts:
        frames, times = clue.frames(part.values, row), part.values[:, clue.time]
        row += len(times)
        has_time = ~np.isnan(times)
        if np.isnan(frames).any() or frames[0] <= last or (np.diff(frames) <= 0).any():
            return None
        last = float(frames[-1])
        if first is None and has_time.any():
            at = int(has_time.argmax())
            first = float(frames[at]), float(times[at])
        off = (times - frames / clue.rate)[has_time]
        low, high = min(low, off.min(initial=np.inf)), max(high, off.max(initial=-np.inf))
    if first is None:
        return None
    # A printed time was rounded or cut, so it may differ from the frame's own time by one last digit.
    best = grid * (1 + _SLACK)
    chosen: tuple[float, float] | None = None
    for start, base in (*((start, 0.0) for start in clue.starts), first):
        offset = base - start / clue.rate
        worst = max(high - offset, offset - low)
        if worst <= best:
            # A later start must fit better by more than rounding, or else the first of them stays.
            best, chosen = worst - grid * _SLACK, (start, base)
    if chosen is None:
        return None
    counted = "rows" if clue.frame is None else "frame numbers"
    source = f"{counted} at {clue.rate!r} Hz, for the printed times have too few decimals"
    return Timing(0.0, clue.rate, *chosen, source)
