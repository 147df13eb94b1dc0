"""OptiTrack Motive CSV, versions 1.2 to 1.25.

Which rows the header has differs by version; they are told by what they hold. 1.2 and 1.21 have rows of types, names
and IDs without labels, 1.23 labels them, 1.24 may have a column of time codes, and 1.25 a row of parents.
"""

from __future__ import annotations

import csv
import datetime
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

from ..errors import ForeignFileError, OptionError
from ..mocap import placement
from ..mocap.objects import MARKERS_TOPIC
from ..mocap.placement import NOTE_KEY, Placement
from ..mocap.space import DECIMALS, UNITS
from ..recorder import Recorder
from . import Progress, restored, sto
from .cells import Cells
from .headers import Header, check_on_bad, distinct, first_line
from .tracks import Report, Tracks

VERSIONS = ("1.2", "1.20", "1.21", "1.22", "1.23", "1.24", "1.25")

_BODIES = ("Rigid Body", "Bone")
_MARKERS = {"Marker": "markers", "Rigid Body Marker": "body_markers", "Bone Marker": "bone_markers"}
_TYPES = (*_BODIES, *_MARKERS, "Joint")
_LABELS = ("Type", "Name", "ID", "Parent", "")
_LENGTHS = ("Position", "Mean Marker Error", "Error Per Marker")
_KEPT = ("Take Name", "Capture Start Time", "Coordinate Space", "Export Frame Rate")
_ERRORS = ("Mean Marker Error", "Error Per Marker")
_START = re.compile(r"(\d{4})-(\d\d)-(\d\d) (\d{1,2})\.(\d\d)\.(\d\d)(?:\.(\d{1,6}))? ?([AP]M)?", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class _Column:
    """One column behind those of frame, time and time code."""

    type: str
    name: str
    identity: str
    group: str
    axis: str


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
        pairs = _pairs(src, header.next("its first line"))
        columns, leading = _columns(src, header)
        note = placement.from_text(pairs.get(NOTE_KEY, ""), len(columns))
        decimals = DECIMALS[_unit(src, pairs)]
        origin = start if start is not None else note.origin if note else _start(pairs, timezone)
        placements, metadata = (note.placements, note.metadata) if note else _foreign(columns, pairs)
        lengths = {at for at, column in enumerate(columns) if column.group in _LENGTHS}
        shifts = [-decimals if at in lengths else 0 for at in range(len(columns))]
        if note:
            shifts = restored.shifts(note, decimals, len(columns), lengths)
        points, rotations = _groups(columns, "Position", "XYZ"), _groups(columns, "Rotation", "XYZW")
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


def _pairs(path: Path, line: str) -> dict[str, str]:
    """Return the first line's keys and values."""
    if line.startswith(("Format Version;", "Format Version\t")):
        raise ForeignFileError(
            path,
            "the file is separated by ';' or tabs, as some languages export it: export with commas and points",
            1,
            1,
        )
    cells = next(csv.reader([line]), [])
    if not cells or cells[0] != "Format Version":
        raise ForeignFileError(path, "the file does not begin with 'Format Version'; it is no CSV of Motive's", 1, 1)
    pairs = dict(zip(cells[::2], cells[1::2], strict=False))
    version = pairs["Format Version"] if len(cells) > 1 else ""
    if version not in VERSIONS:
        raise ForeignFileError(path, f"format version {version!r}; {', '.join(VERSIONS)} are known", 1, 2)
    if pairs.get("Rotation Type", "Quaternion") not in ("Quaternion", ""):
        kind = pairs["Rotation Type"]
        at = 2 + 2 * list(pairs).index("Rotation Type")
        raise ForeignFileError(path, f"rotation type {kind!r}; export with quaternions", 1, at)
    return pairs


def _columns(path: Path, header: Header) -> tuple[list[_Column], int]:
    """Read the header's rows; returns the columns, and how many come before them."""
    rows: list[list[str]] = []
    lines: list[int] = []
    while True:
        text = header.next("the row of 'Frame' and 'Time'")
        cells = next(csv.reader([text]), [])
        if any(cell.strip() for cell in cells):
            rows.append([cell.strip() for cell in cells])
            lines.append(header.line)
        if rows and rows[-1][0].lower() == "frame":
            break
        if len(rows) > 6 or (rows and re.fullmatch(r"[-\d.]+", rows[-1][0])):
            raise ForeignFileError(path, "the header has no row that begins with 'Frame'", header.line)
    *above, axes = rows
    leading = 3 if len(axes) > 2 and axes[2].lower().replace(" ", "") in ("timecode", "smpte") else 2
    if len(axes) < leading or not axes[1].lower().startswith("time"):
        raise ForeignFileError(path, "the column after 'Frame' is not 'Time'", lines[-1], 2)
    named = _named(path, above, lines)
    for what, line in named.items():
        row, number = line
        if len(row) != len(axes):
            raise ForeignFileError(
                path, f"the row of {what} has {len(row)} cells, but that of axes {len(axes)}", number
            )
    found = []
    for at in range(leading, len(axes)):
        kind, name, identity, group = (named[what][0][at] for what in ("types", "names", "IDs", "groups"))
        if kind not in _TYPES:
            known = ", ".join(_TYPES)
            raise ForeignFileError(
                path, f"the column type {kind!r} is not known; {known} are", named["types"][1], at + 1
            )
        found.append(_Column(kind, name, identity, group, axes[at]))
    _check(path, found, leading, lines[-1])
    return found, leading


def _named(path: Path, rows: Sequence[list[str]], lines: Sequence[int]) -> dict[str, tuple[list[str], int]]:
    """Return the header's rows above the axes, with their lines, by what they say."""
    labels = {row[1]: (row, line) for row, line in zip(rows, lines, strict=False) if len(row) > 1 and row[1]}
    plain = [(row, line) for row, line in zip(rows, lines, strict=False) if len(row) < 2 or not row[1]]
    if labels:
        wanted = {"types": labels.get("Type"), "names": labels.get("Name"), "IDs": labels.get("ID")}
        wanted["groups"] = plain[0] if plain else None
    else:
        wanted = dict(zip(("types", "names", "IDs", "groups"), [*plain, None, None, None, None], strict=False))
        if len(plain) == 3 and wanted["groups"] is None:  # version 1.2 may have no IDs
            wanted["groups"], wanted["IDs"] = wanted["IDs"], wanted["names"]
    found: dict[str, tuple[list[str], int]] = {}
    for what, row in wanted.items():
        if row is None:
            raise ForeignFileError(path, f"the header has no row of {what}", lines[-1])
        found[what] = row
    return found


def _check(path: Path, columns: Sequence[_Column], leading: int, line: int) -> None:
    """Raise if an object does not have the columns that its type has."""
    for group in _objects(columns):
        first = columns[group[0]]
        have = [(columns[at].group, columns[at].axis) for at in group]
        wanted = [("Position", axis) for axis in "XYZ"] if first.type != "Joint" else []
        if first.type in _BODIES:
            wanted = [*(("Rotation", axis) for axis in "XYZW"), *wanted]
        missing = next((one for one in wanted if one not in have), None)
        if missing is not None:
            at = leading + group[0] + 1
            raise ForeignFileError(path, f"{first.type} {first.name!r} has no column {' '.join(missing)}", line, at)


def _objects(columns: Sequence[_Column]) -> list[list[int]]:
    """Return the columns of each object."""
    groups: dict[tuple[str, str, str], list[int]] = {}
    for at, column in enumerate(columns):
        groups.setdefault((column.type, column.name, column.identity), []).append(at)
    return list(groups.values())


def _unit(path: Path, pairs: Mapping[str, str]) -> str:
    said = pairs.get("Length Units", "Meters")
    unit = UNITS.get(said.strip().lower())
    if unit is None:
        at = 2 + 2 * list(pairs).index("Length Units")
        raise ForeignFileError(path, f"length units {said!r}; Meters, Centimeters and Millimeters are known", 1, at)
    return unit


def _start(pairs: Mapping[str, str], timezone: str) -> float:
    """Return the take's start, in s since 1970; 0.0 if the file does not say."""
    found = _START.fullmatch(pairs.get("Capture Start Time", "").strip())
    if found is None:
        return 0.0
    try:
        zone = ZoneInfo(timezone)
    except (KeyError, ValueError) as error:
        raise OptionError(f"timezone={timezone!r} is no time zone; pass a name such as 'Europe/Berlin'") from error
    year, month, day, hour, minute, second = (int(part) for part in found.groups()[:6])
    half = (found[8] or "").upper()
    hour = hour % 12 + 12 * (half == "PM") if half else hour
    try:
        moment = datetime.datetime(year, month, day, hour, minute, second, tzinfo=zone)
    except ValueError:
        return 0.0
    return max(moment.timestamp() + int((found[7] or "0").ljust(6, "0")) / 1e6, 0.0)


def _foreign(columns: Sequence[_Column], pairs: Mapping[str, str]) -> tuple[list[Placement], dict[str, dict[str, Any]]]:
    """Return where the fields of a foreign file's topics stand."""
    groups = _objects(columns)
    bodies = [group for group in groups if columns[group[0]].type in _BODIES]
    names = distinct([columns[group[0]].name or "body" for group in bodies])
    placements: list[Placement] = []
    for name, group in zip(names, bodies, strict=True):
        placements += _body(name, columns, group)
    taken: set[tuple[str, tuple[str, ...]]] = set()
    for group in groups:
        first = columns[group[0]]
        if first.type == "Joint":
            placements.append(Placement("joints", (first.name,), (), (group[0],)))
        elif first.type in _MARKERS:
            topic, name = _marker(first, names)
            path = (_MARKERS[first.type], name)
            number = 1
            while (topic, path) in taken:
                number += 1
                path = (_MARKERS[first.type], f"{name}#{number}")
            taken.add((topic, path))
            placements.append(Placement(topic, path, (3,), _axes(columns, group, "Position", "XYZ")))
            quality = [at for at in group if columns[at].group == "Marker Quality"]
            if quality:
                placements.append(Placement(topic, ("marker_quality", path[1]), (), (quality[0],)))
    about = {key: pairs[key] for key in _KEPT if pairs.get(key)}
    said = {"quat_order": "xyzw", "length_units": "m", "up": "y", "motive": about}  # y is up unless changed in Motive
    return placements, {one.topic: said for one in placements}


def _body(name: str, columns: Sequence[_Column], group: Sequence[int]) -> list[Placement]:
    found = [
        Placement(name, ("pos",), (3,), _axes(columns, group, "Position", "XYZ")),
        Placement(name, ("quat",), (4,), _axes(columns, group, "Rotation", "XYZW")),
    ]
    errors = [at for at in group if columns[at].group in _ERRORS]
    if errors:
        found.append(Placement(name, ("mean_marker_error",), (), (errors[0],)))
    return found


def _groups(columns: Sequence[_Column], kind: str, axes: str) -> list[tuple[int, ...]]:
    """Return the columns of each object's position, or of its rotation."""
    groups = _objects(columns)
    having = [group for group in groups if any(columns[at].group == kind for at in group)]
    return [_axes(columns, group, kind, axes) for group in having]


def _axes(columns: Sequence[_Column], group: Sequence[int], kind: str, axes: str) -> tuple[int, ...]:
    by_axis = {columns[at].axis: at for at in group if columns[at].group == kind}
    return tuple(by_axis[axis] for axis in axes)


def _marker(column: _Column, bodies: Sequence[str]) -> tuple[str, str]:
    """Return a marker's topic and its name there: the body that its name or its ID belongs to, or its set."""
    before, colon, behind = column.name.partition(":")
    if colon and before and behind:
        return before, behind
    for body in sorted(bodies, key=len, reverse=True):
        if column.name.startswith(f"{body}_"):
            return body, column.name[len(body) + 1 :]
    return MARKERS_TOPIC, column.name or "marker"
