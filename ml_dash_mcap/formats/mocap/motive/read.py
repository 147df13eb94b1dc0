"""Reads OptiTrack Motive CSV, versions 1.2 to 1.25.

The rows of the header differ by version and are recognised by their content. 1.2 and 1.21 have rows of types, names
and IDs without labels, 1.23 labels them, 1.24 may have a column of time codes, and 1.25 a row of parents.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ....meaning.units import DECIMALS
from ....recorder import Recorder
from ...registry import Progress
from ...text.dialect import number, of_line
from ...text.headers import HeaderLines, preview
from ...text.number_cells import Cells, Floats, NumberPart
from ...text.plain_text import opened
from .. import joined_tables, placement, restored, row_times, start_times
from ..placement import NOTE_KEY, Note, Placement
from ..row_times import Clue, Timing
from ..sto import layout as sto_layout
from ..sto import read as sto
from ..take_options import MotiveReadOptions
from ..track_rows import ReadingProgress, TopicRows, checked
from . import column_header, layout, motive_fields


def record(src: Path, recorder: Recorder, options: MotiveReadOptions, progress: Progress | None) -> None:
    """Append a take: a topic a rigid body, with `pos`, `quat` (x y z w) and markers, and one for loose markers.

    Lengths become metres; axes stay as they are. What is occluded is absent from its row. Columns of a kind that is not
    known are fields too, and a time code is the field `time_code`. A file that this library wrote becomes the topics
    and fields that it was written from, the joints beside it included.

    Args:
        src: The file.
        recorder: Where its rows go.
        options: How to read it.
        progress: Called now and then with the rows done and the rows in all.

    Raises:
        ForeignFileError: The file is not as Motive writes it; says the line and the column.
    """
    report = ReadingProgress(src, progress)
    with opened(src) as file:
        header = HeaderLines(src, file)
        first = header.first("its first line")
        # The pairs may hold paths and notes with any letters; what follows the first key is the separator.
        dialect = of_line(first.lstrip(' "').removeprefix(layout.FORMAT_VERSION).lstrip(' "')[:1], default=",")
        pairs = column_header.read_pairs(src, first, dialect)
        header_columns = column_header.read_columns(src, header, dialect)
        columns, leading = header_columns.columns, header_columns.leading
        note = placement.from_text(pairs.get(NOTE_KEY, ""), len(columns))
        unit = column_header.unit_of(src, pairs, options.length_units)
        lengths = {at for at, column in enumerate(columns) if column.group in layout.LENGTHS}
        shifts = [0] * leading + restored.shifts(note, DECIMALS[unit], len(columns), lengths)
        cells = Cells(src, len(shifts), dialect, shifts, header_columns.time_codes, on_bad=options.on_bad)
        cells.learn([*itertools.chain(*preview(file))])
        line = header.line + 1
        origin = options.start if options.start is not None else note.origin if note else None
        if origin is None:
            origin = start_times.read(src, pairs.get(layout.START_TIME, ""), layout.START_TIME, options.timezone) or 0.0
        clue = Clue(header_columns.time, 0, number(pairs.get(layout.EXPORT_RATE, "")))
        when = row_times.settled(src, clue, cells, file, line, origin, is_asked=options.start is not None)
        placements, metadata = (note.placements, note.metadata) if note else motive_fields.foreign(columns, pairs, unit)
        metadata = {topic: {**about, **when.metadata} for topic, about in metadata.items()}
        parts = _restored(cells.read(file, line), note, leading, header_columns) if note else cells.read(file, line)
        beside = sto.beside(src, note.joints if note else None)
        if beside is None:
            tracks = TopicRows(src, recorder, placements, metadata, skip_empty=note is not None)
            for part in parts:
                times = when.stamps(part.values[:, 0], part.values[:, header_columns.time])
                tracks.append_from(cells, times, part.values[:, leading:], part, header_columns.time + 1)
                report.add(len(part.values), part.at)
        else:
            rows = _stamped(cells, parts, when, leading, report)
            with sto.table(beside, on_bad=options.on_bad, start=options.start) as joints:
                _append_joined(src, recorder, (placements, metadata), rows, joints, len(columns))
                cells.bad += joints.cells.bad
    report.finish(cells.bad)


def _append_joined(
    path: Path,
    recorder: Recorder,
    fields: tuple[Sequence[Placement], Mapping[str, Mapping[str, Any]]],
    rows: Iterator[tuple[Floats, Floats]],
    joints: sto.Table,
    width: int,
) -> None:
    """Append rows together with those of the file of joints beside them."""
    placements, metadata = fields
    others, more = joints.fields(sto_layout.TOPIC)
    behind = [replace(other, columns=tuple(width + at for at in other.columns)) for other in others]
    tracks = TopicRows(path, recorder, [*placements, *behind], {**more, **metadata}, skip_empty=True)
    for times, values in joined_tables.joined(rows, joints.stamped(), (width, len(joints.names))):
        tracks.append(times, values)


def _restored(
    parts: Iterator[NumberPart], note: Note, leading: int, header_columns: column_header.ColumnHeader
) -> Iterator[NumberPart]:
    """Yield the rows of a file that this library wrote, turned to the axes that they had."""
    points = column_header.vectors(header_columns.columns, layout.POSITION, layout.POSITION_AXES)
    rotations = column_header.vectors(header_columns.columns, layout.ROTATION, layout.ROTATION_AXES)
    for part in parts:
        restored.turn_back(part.values[:, leading:], note, points, rotations)
        yield part


def _stamped(
    cells: Cells, parts: Iterator[NumberPart], when: Timing, leading: int, report: ReadingProgress
) -> Iterator[tuple[Floats, Floats]]:
    """Yield time stamps, [N], s, and numbers, [N, C]."""
    for part in parts:
        times, keep = checked(cells, when.stamps(part.values[:, 0], part.values[:, 1]), part.lines, 2)
        report.add(len(part.values), part.at)
        yield times, part.values[:, leading:] if keep is None else part.values[keep, leading:]
