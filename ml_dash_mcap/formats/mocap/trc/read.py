"""Reads OpenSim marker files, .trc."""

from __future__ import annotations

import itertools
from pathlib import Path

from ....errors import ForeignFileError
from ....meaning.units import DECIMALS
from ....recorder import Recorder
from ...foreign_names import distinct
from ...registry import Progress
from ...text.dialect import Dialect, number, of_line
from ...text.headers import HeaderLines, preview, refuse_numbers, unit_of_length
from ...text.number_cells import Cells
from ...text.plain_text import opened
from .. import placement, restored, row_times
from ..placement import NOTE_KEY
from ..point_fields import about_points, marker
from ..row_times import Clue
from ..take_options import TrcReadOptions
from ..track_rows import ReadingProgress, TopicRows
from . import layout

LEADING = len(layout.COLUMNS)


def record(src: Path, recorder: Recorder, options: TrcReadOptions, progress: Progress | None) -> None:
    """Append a marker file: one topic with `markers` by name, in metres; `set:name` is a marker of the topic `set`.

    Args:
        src: The file.
        recorder: Where its rows go.
        options: How to read it.
        progress: Called now and then with the rows done and the rows in all.

    Raises:
        ForeignFileError: The file is no marker file; says the line and the column.
    """
    report = ReadingProgress(src, progress)
    with opened(src) as file:
        header = HeaderLines(src, file)
        first = header.first(repr(layout.FIRST_WORD))
        at_keys, line_of_keys = header.at(), header.line
        dialect = _dialect(header, first)
        header.to(at_keys, line_of_keys)
        about = dialect.split(first) if dialect.separator != " " else first.split("\t")
        keys = header.row("the row of keys", dialect)
        values = header.row("the row of values", dialect)
        values_by_key = {key.lower(): value for key, value in zip(keys, values, strict=False)}
        unit = _unit(src, values_by_key, keys, header.line, options.length_units)
        names = _names(src, header, values_by_key, dialect)
        count = 3 * len(names)
        note = placement.from_text(about[about.index(NOTE_KEY) + 1], count) if NOTE_KEY in about[:-1] else None
        groups = [tuple(range(at, at + 3)) for at in range(0, count, 3)]
        shifts = restored.shifts(note, DECIMALS[unit], count, set(range(count)))
        origin = options.start if options.start is not None else note.origin if note else 0.0
        cells = Cells(src, count + LEADING, dialect, [0, 0, *shifts], allow_short=True, on_bad=options.on_bad)
        cells.learn([*itertools.chain(*preview(file))])
        line = header.line + 1
        clue = Clue(1, 0, number(values_by_key.get(layout.RATE.lower(), "")), _starts(values_by_key))
        when = row_times.settled(src, clue, cells, file, line, origin, is_asked=options.start is not None)
        if note:
            metadata = restored.metadata(note, when.metadata)
            tracks = TopicRows(src, recorder, note.placements, metadata, skip_empty=True)
        else:
            placements = [marker(name, at, options.topic) for name, at in zip(names, groups, strict=True)]
            tracks = TopicRows(src, recorder, placements, about_points(placements, unit, when.metadata))
        for part in cells.read(file, line):
            numbers = part.values[:, LEADING:]
            if note:
                restored.turn_back(numbers, note, groups, ())
            times = when.stamps(part.values[:, 0], part.values[:, 1])
            tracks.append_from(cells, times, numbers, part, 2)
            report.add(len(numbers), part.at)
    report.finish(cells.bad)


def _dialect(header: HeaderLines, first: str) -> Dialect:
    """Return how the file is split, by the row of its keys: the first line may have a path with any letters in it."""
    line = first
    while layout.RATE.lower() not in line.lower() or line is first:
        next_line = header.next_or_none()
        if next_line is None:
            return of_line(first)
        line = next_line
    return of_line(line, default=" " if " " in line.strip() else "\t")


def _starts(values: dict[str, str]) -> list[float]:
    start = number(values.get(layout.START_FRAME.lower(), ""))
    # Tools disagree about the frame at time 0: the stated first frame, 1 or 0. `row_times` takes the one that fits
    # the printed times.
    return [1.0, 0.0] if start is None else [start, 1.0, 0.0]


def _unit(path: Path, values: dict[str, str], keys: list[str], line: int, asked: str | None) -> str:
    at = next((number for number, key in enumerate(keys, 1) if key.lower() == layout.UNITS.lower()), None)
    if at is None and asked is None:
        raise ForeignFileError(path, "the row of keys has no Units; pass length_units= to say them", line - 1)
    return unit_of_length(path, values.get(layout.UNITS.lower(), ""), asked, "the unit", line, at)


def _names(path: Path, header: HeaderLines, values: dict[str, str], dialect: Dialect) -> list[str]:
    """Read the rows of names and axes."""
    cells = header.row("the row of marker names", dialect)
    if len(cells) < LEADING or not cells[0].lower().startswith("frame") or not cells[1].lower().startswith("time"):
        raise ForeignFileError(path, "the row of marker names does not begin with Frame# and Time", header.line, 1)
    line = header.line
    axes = header.row("the row of axes", dialect)
    refuse_numbers(path, axes, "row of axes", header.line)
    wanted = number(values.get(layout.MARKERS.lower(), ""))
    names = cells[2::3]
    given = [name for name in cells[2:] if name]
    if any(cells[at] for at in range(3, len(cells)) if at % 3 != 2) or not all(names):
        if wanted != len(given) or len([axis for axis in axes if axis]) != 3 * len(given):
            raise ForeignFileError(path, "marker names do not stand in every third column", line)
        names = given
    if wanted is not None and wanted != len(names):
        raise ForeignFileError(
            path, f"{layout.MARKERS} is {values[layout.MARKERS.lower()]}, but {len(names)} markers are named", line
        )
    return distinct(names)
