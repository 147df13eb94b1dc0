"""OptiTrack Motive CSV, versions 1.2 to 1.25.

Which rows the header has differs by version; they are told by what they hold. 1.2 and 1.21 have rows of types, names
and IDs without labels, 1.23 labels them, 1.24 may have a column of time codes, and 1.25 a row of parents.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..mocap import placement
from ..mocap.objects import MARKERS_TOPIC
from ..mocap.placement import NOTE_KEY, Placement
from ..mocap.space import DECIMALS
from ..recorder import Recorder
from . import Progress, motive_header, restored, sto
from .cells import Cells
from .headers import Header, check_on_bad, distinct, first_line, seconds_at
from .motive_header import BODIES, MARKERS, Column
from .tracks import Report, Tracks

_LENGTHS = ("Position", "Mean Marker Error", "Error Per Marker")
_KEPT = ("Take Name", "Capture Start Time", "Coordinate Space", "Export Frame Rate")
_ERRORS = ("Mean Marker Error", "Error Per Marker")
_START = re.compile(r"(\d{4})-(\d\d)-(\d\d) (\d{1,2})\.(\d\d)\.(\d\d)(?:\.(\d{1,6}))? ?([AP]M)?", re.IGNORECASE)


def detect(path: Path) -> str | None:
    """Return "mocap" for a file of Motive's."""
    return "mocap" if first_line(path).startswith(("Format Version,", "Format Version;", "Format Version\t")) else None


def record(
    src: Path,
    recorder: Recorder,
    *,
    progress: Progress | None = None,
    on_bad: str = "raise",
    timezone: str = "UTC",
    start: float | None = None,
) -> None:
    """Append a take: a topic a rigid body, with `pos`, `quat` (x y z w) and markers, and one for loose markers.

    Lengths become metres; axes stay as they are. What is occluded is absent from its row. A file that this library
    wrote becomes the topics and fields that it was written from, the joints beside it included.

    Args:
        src: The file.
        recorder: Where its rows go.
        progress: Called now and then with the rows done and the rows in all.
        on_bad: What to do with cells that are no numbers: "raise", or "missing" to leave them out and warn.
        timezone: Of the file's start time, for it does not say: an IANA name.
        start: The time stamp of its time 0, instead of the file's start time, in s.

    Raises:
        ForeignFileError: The file is not as Motive writes it; says the line and the column.
    """
    check_on_bad(on_bad)
    report = Report(src, progress)
    with src.open("rb") as file:
        header = Header(src, file)
        pairs = motive_header.read_pairs(src, header.next("its first line"))
        columns, leading = motive_header.read_columns(src, header)
        note = placement.from_text(pairs.get(NOTE_KEY, ""), len(columns))
        decimals = DECIMALS[motive_header.unit_of(src, pairs)]
        origin = start if start is not None else note.origin if note else _start(pairs, timezone)
        placements, metadata = (note.placements, note.metadata) if note else _foreign(columns, pairs)
        lengths = {at for at, column in enumerate(columns) if column.group in _LENGTHS}
        shifts = [-decimals if at in lengths else 0 for at in range(len(columns))]
        if note:
            shifts = restored.shifts(note, decimals, len(columns), lengths)
        points, rotations = (
            motive_header.vectors(columns, "Position", "XYZ"),
            motive_header.vectors(columns, "Rotation", "XYZW"),
        )
        cells = Cells(src, len(columns) + leading, ",", [0] * leading + shifts, on_bad=on_bad)
        tracks = Tracks(recorder, placements, metadata, skip_empty=note is not None)
        line = header.line + 1
        for values, at in cells.read(file, line):
            if note:
                restored.turn_back(values[:, leading:], note, points, rotations)
            line += tracks.append_from(cells, origin + values[:, 1], values[:, leading:], line)
            report.add(len(values), at)
    beside = sto.beside(src, note.joints if note else None)
    if beside is not None:
        sto.record(beside, recorder, on_bad=on_bad, start=start)
    report.finish(cells.bad)


def _start(pairs: Mapping[str, str], timezone: str) -> float:
    """Return the take's start, in s since 1970; 0.0 if the file does not say."""
    found = _START.fullmatch(pairs.get("Capture Start Time", "").strip())
    if found is None:
        return 0.0
    year, month, day, hour, minute, second = (int(part) for part in found.groups()[:6])
    half = (found[8] or "").upper()
    hour = hour % 12 + 12 * (half == "PM") if half else hour
    return seconds_at((year, month, day, hour, minute, second), found[7] or "", timezone)


def _foreign(columns: Sequence[Column], pairs: Mapping[str, str]) -> tuple[list[Placement], dict[str, dict[str, Any]]]:
    """Return where the fields of a foreign file's topics stand."""
    groups = motive_header.by_object(columns)
    bodies = [group for group in groups if columns[group[0]].type in BODIES]
    names = distinct([columns[group[0]].name or "body" for group in bodies])
    placements: list[Placement] = []
    for name, group in zip(names, bodies, strict=True):
        placements += _body(name, columns, group)
    taken: set[tuple[str, tuple[str, ...]]] = set()
    for group in groups:
        first = columns[group[0]]
        if first.type == "Joint":
            placements.append(Placement("joints", (first.name,), (), (group[0],)))
        elif first.type in MARKERS:
            topic, name = _marker(first, names)
            path = (MARKERS[first.type], name)
            number = 1
            while (topic, path) in taken:
                number += 1
                path = (MARKERS[first.type], f"{name}#{number}")
            taken.add((topic, path))
            placements.append(Placement(topic, path, (3,), motive_header.axes_of(columns, group, "Position", "XYZ")))
            quality = [at for at in group if columns[at].group == "Marker Quality"]
            if quality:
                placements.append(Placement(topic, ("marker_quality", path[1]), (), (quality[0],)))
    about = {key: pairs[key] for key in _KEPT if pairs.get(key)}
    said = {"quat_order": "xyzw", "length_units": "m", "up": "y", "motive": about}  # y is up unless changed in Motive
    return placements, {one.topic: said for one in placements}


def _body(name: str, columns: Sequence[Column], group: Sequence[int]) -> list[Placement]:
    found = [
        Placement(name, ("pos",), (3,), motive_header.axes_of(columns, group, "Position", "XYZ")),
        Placement(name, ("quat",), (4,), motive_header.axes_of(columns, group, "Rotation", "XYZW")),
    ]
    errors = [at for at in group if columns[at].group in _ERRORS]
    if errors:
        found.append(Placement(name, ("mean_marker_error",), (), (errors[0],)))
    return found


def _marker(column: Column, bodies: Sequence[str]) -> tuple[str, str]:
    """Return a marker's topic and its name there: the body that its name or its ID belongs to, or its set."""
    before, colon, behind = column.name.partition(":")
    if colon and before and behind:
        return before, behind
    for body in sorted(bodies, key=len, reverse=True):
        if column.name.startswith(f"{body}_"):
            return body, column.name[len(body) + 1 :]
    return MARKERS_TOPIC, column.name or "marker"
