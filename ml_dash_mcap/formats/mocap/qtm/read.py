"""Reads TSV files of Qualisys Track Manager: markers, and bodies with six degrees of freedom."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ....errors import ForeignFileError
from ....meaning import rotations
from ....meaning.units import DECIMALS
from ....recorder import Recorder
from ...file_signs import QTM_FIRST_LINE
from ...file_start import FileStart
from ...foreign_names import distinct
from ...registry import Progress
from ...text.dialect import Dialect, number, of_line
from ...text.headers import HeaderLines, preview, without_empty_end
from ...text.number_cells import Cells, Floats, NumberPart
from ...text.plain_text import is_filler, opened
from .. import placement, restored, row_times, start_times
from ..placement import Note, Placement
from ..point_fields import about_points, marker
from ..row_times import Clue, Timing
from ..take_options import QtmReadOptions
from ..track_rows import ReadingProgress, TopicRows
from . import layout

_WORD = re.compile(r"[A-Z][A-Z0-9_]*$")
_OUT_COLUMNS = 11
"""Position, quaternion, angles and residual of a body."""


def record(src: Path, recorder: Recorder, options: QtmReadOptions, progress: Progress | None) -> None:
    """Append a TSV file, in metres: one topic with `markers` by name, or a topic a body with `pos` and `quat`.

    A body also has its `angles` (roll, pitch, yaw as the file defines them, in degrees) and its `residual`.

    Args:
        src: The file.
        recorder: Where its rows go.
        options: How to read it.
        progress: Called now and then with the rows done and the rows in all.

    Raises:
        ForeignFileError: The file is not as QTM writes it; says the line and the column.
    """
    report = ReadingProgress(src, progress)
    with opened(src) as file:
        header = HeaderLines(src, file)
        dialect = _dialect(src)
        keys, has_times = _keys(src, header, dialect)
        has_bodies = layout.BODIES in keys
        names = _names(keys[layout.BODIES if has_bodies else layout.MARKERS], "body" if has_bodies else "marker")
        per_name = _columns_of_body(file, dialect, 2 * has_times, len(names)) if has_bodies else 3
        count = per_name * len(names)
        note = None if has_bodies else placement.from_text(_first_cell(keys, layout.NOTE), count)
        lengths = {at for at in range(count) if at % per_name < 3 or (has_bodies and at % per_name == 6)}
        shifts = restored.shifts(note, DECIMALS[layout.UNIT], count, lengths)
        origin = options.start if options.start is not None else note.origin if note else None
        if origin is None:
            origin = start_times.read(src, " ".join(keys.get(layout.START, [])), layout.START, options.timezone) or 0.0
        leading = len(layout.COLUMNS) if has_times else 0
        cells = Cells(
            src, count + leading, dialect, [0] * leading + shifts, allow_short=True,
            on_bad=options.on_bad, keeps_blank_rows=not has_times,
        )  # fmt: skip
        cells.learn([*itertools.chain(*preview(file))])
        rate, line = _rate(src, keys, has_times), header.line + 1
        when = Timing(origin, rate, source=f"rows at {rate!r} Hz")
        if has_times:
            clue = Clue(1, 0, rate, (1.0, 0.0))
            when = row_times.settled(src, clue, cells, file, line, origin, is_asked=options.start is not None)
        tracks = _rows_of(src, recorder, note, _fields(names, options.topic, has_bodies), when, keys)
        row, most = 0, _frame_count(keys)
        for part in cells.read(file, line):
            if not has_times:
                part = _without_end(part, row, most)
            numbers = part.values[:, leading:]
            if has_bodies:
                numbers = _bodies(numbers, per_name)
            if note:
                restored.turn_back(numbers, note, [(at, at + 1, at + 2) for at in range(0, count, 3)], ())
            frames = part.values[:, 0] if has_times else np.arange(row, row + len(numbers), dtype=np.float64)
            times = when.stamps(frames, part.values[:, 1] if has_times else frames)
            tracks.append_from(cells, times, numbers, part, 2 if has_times else None)
            report.add(len(numbers), part.at)
            row += len(numbers)
    report.finish(cells.bad)


def _rows_of(
    path: Path, recorder: Recorder, note: Note | None, fields: list[Placement], when: Timing, keys: dict[str, list[str]]
) -> TopicRows:
    """Return the topics that the file's rows go to: those of its note, or else its own fields."""
    if note is not None:
        return TopicRows(path, recorder, note.placements, restored.metadata(note, when.metadata), skip_empty=True)
    return TopicRows(path, recorder, fields, _about(fields, layout.BODIES in keys, keys, when))


def _dialect(path: Path) -> Dialect:
    """Return the dialect of a file by what stands behind its first word."""
    beginning = QTM_FIRST_LINE.match(FileStart(path).first_line)
    return of_line(beginning.group(0)[-1] if beginning else "")


def _keys(path: Path, header: HeaderLines, dialect: Dialect) -> tuple[dict[str, list[str]], bool]:
    """Read the header; returns its keys and the cells behind them, and whether rows begin with frame and time."""
    keys: dict[str, list[str]] = {}
    while True:
        at = header.at()
        line = header.next("its numbers")
        if not keys and is_filler(line):
            continue
        cells = dialect.split(line)
        if cells[0] == layout.COLUMNS[0]:
            break
        if not dialect.is_blank(line) and not _WORD.fullmatch(cells[0]):
            header.to(at, header.line - 1)
            break
        if dialect.is_blank(line) and (layout.MARKERS in keys or layout.BODIES in keys):
            header.to(at, header.line - 1)
            break
        if cells[0]:
            more = without_empty_end(cells[1:])
            keys[cells[0]] = [*keys.get(cells[0], []), *more] if cells[0] == "EVENT" else keys.get(cells[0], more)
    if layout.MARKERS not in keys and layout.BODIES not in keys:
        problem = (
            "2D data" if _first_cell(keys, layout.INCLUDED) == "2D" else f"neither {layout.MARKERS} nor {layout.BODIES}"
        )
        raise ForeignFileError(path, f"the header has {problem}; export 3D or 6D data with the TSV header", header.line)
    return keys, cells[0] == layout.COLUMNS[0]


def _first_cell(keys: dict[str, list[str]], key: str) -> str:
    return next(iter(keys.get(key, [])), "")


def _names(cells: list[str], word: str) -> list[str]:
    return distinct([name or f"{word} {at}" for at, name in enumerate(cells, 1)])


def _rate(path: Path, keys: dict[str, list[str]], has_times: bool) -> float:
    rate = number(_first_cell(keys, layout.FREQUENCY)) or 0.0
    if rate <= 0 and not has_times:
        stated = _first_cell(keys, layout.FREQUENCY) or "missing"
        raise ForeignFileError(path, f"FREQUENCY is {stated!r}, and there are no times", 1)
    return rate


def _frame_count(keys: dict[str, list[str]]) -> int | None:
    count = number(_first_cell(keys, layout.FRAMES))
    return None if count is None else int(count)


def _without_end(part: NumberPart, row: int, most: int | None) -> NumberPart:
    """Leave out rows without numbers behind the last frame: where no frame is numbered, others may be frames."""
    if most is None or row + len(part.values) <= most:
        return part
    keep = (np.arange(row, row + len(part.values)) < most) | ~np.isnan(part.values).all(axis=1)
    return part._replace(values=part.values[keep], lines=part.lines[keep])


def _about(
    placements: list[Placement], has_bodies: bool, keys: dict[str, list[str]], when: Timing
) -> dict[str, dict[str, Any]]:
    kept = {key: " ".join(cells) for key, cells in keys.items() if not key.endswith("_NAMES") and key != layout.NOTE}
    more = {"qtm": kept, **when.metadata}
    about = about_points(placements, layout.UNIT, more)
    if not has_bodies:
        return about
    units = {"pos": "m", "residual": "m", "angles": "deg"}
    return {topic: {**metadata, "quat_order": "xyzw", "units": units} for topic, metadata in about.items()}


def _fields(names: Sequence[str], topic: str, has_bodies: bool) -> list[Placement]:
    """Return where the numbers of markers, or of bodies, go."""
    if not has_bodies:
        return [marker(name, (3 * at, 3 * at + 1, 3 * at + 2), topic) for at, name in enumerate(names)]
    return [field for at, name in enumerate(names) for field in _body(name, _OUT_COLUMNS * at)]


def _body(name: str, first: int) -> list[Placement]:
    return [
        Placement(name, ("pos",), (3,), tuple(range(first, first + 3))),
        Placement(name, ("quat",), (4,), tuple(range(first + 3, first + 7))),
        Placement(name, ("angles",), (3,), tuple(range(first + 7, first + 10))),
        Placement(name, ("residual",), (), (first + 10,)),
    ]


def _columns_of_body(file: BinaryIO, dialect: Dialect, leading: int, bodies: int) -> int:
    """Return how many columns each body has, by the longest of the first rows."""
    lines, _ = preview(file)
    longest = max((len(without_empty_end(dialect.split(line))) for line in lines[:100]), default=0)
    return layout.SHORT_BODY_COLUMNS if longest - leading <= layout.SHORT_BODY_COLUMNS * bodies else layout.BODY_COLUMNS


def _bodies(numbers: Floats, columns: int) -> Floats:
    """Return position, quaternion, angles and residual of each body, [N, 11 B].

    Args:
        numbers: What the file says, [N, columns * B].
        columns: Of each body; without a matrix there is no quaternion.
    """
    parts = []
    for at in range(0, numbers.shape[1], columns):
        body = numbers[:, at : at + columns]
        turns = np.full((len(body), 4), np.nan)
        if columns == layout.BODY_COLUMNS:
            # QTM writes a matrix column by column.
            turns, bad = rotations.of_matrices(body[:, 7:].reshape(-1, 3, 3).transpose(0, 2, 1))
            turns[bad] = np.nan
        parts.append(np.concatenate((body[:, :3], turns, body[:, 3:7]), axis=1))
    return np.concatenate(parts, axis=1)
