"""The header of Motive's CSV: its pairs, and what each column is."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import ForeignFileError
from ..mocap.space import UNITS
from .headers import Header, csv_cells, refuse_semicolons

VERSIONS = ("1.2", "1.20", "1.21", "1.22", "1.23", "1.24", "1.25")
BODIES = ("Rigid Body", "Bone")
MARKERS = {"Marker": "markers", "Rigid Body Marker": "body_markers", "Bone Marker": "bone_markers"}
"""Types of markers, to the fields that hold them."""

_TYPES = (*BODIES, *MARKERS, "Joint")


@dataclass(frozen=True, slots=True)
class Column:
    """One column behind those of frame, time and time code."""

    type: str
    name: str
    identity: str
    group: str
    axis: str


def read_pairs(path: Path, line: str) -> dict[str, str]:
    """Return the first line's keys and values."""
    if line.startswith(("Format Version;", "Format Version\t")):
        refuse_semicolons(path)
    cells = csv_cells(path, line, 1)
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


def read_columns(path: Path, header: Header) -> tuple[list[Column], int]:
    """Read the header's rows; returns the columns, and how many come before them."""
    rows: list[list[str]] = []
    lines: list[int] = []
    while True:
        text = header.next("the row of 'Frame' and 'Time'")
        cells = [cell.strip() for cell in csv_cells(path, text, header.line)]
        if any(cells):
            rows.append(cells)
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
        found.append(Column(kind, name, identity, group, axes[at]))
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


def _check(path: Path, columns: Sequence[Column], leading: int, line: int) -> None:
    """Raise if an object does not have the columns that its type has."""
    for group in by_object(columns):
        first = columns[group[0]]
        have = [(columns[at].group, columns[at].axis) for at in group]
        wanted = [("Position", axis) for axis in "XYZ"] if first.type != "Joint" else []
        if first.type in BODIES:
            wanted = [*(("Rotation", axis) for axis in "XYZW"), *wanted]
        missing = next((one for one in wanted if one not in have), None)
        if missing is not None:
            at = leading + group[0] + 1
            raise ForeignFileError(path, f"{first.type} {first.name!r} has no column {' '.join(missing)}", line, at)


def by_object(columns: Sequence[Column]) -> list[list[int]]:
    """Return the columns of each object."""
    groups: dict[tuple[str, str, str], list[int]] = {}
    for at, column in enumerate(columns):
        groups.setdefault((column.type, column.name, column.identity), []).append(at)
    return list(groups.values())


def vectors(columns: Sequence[Column], kind: str, axes: str) -> list[tuple[int, ...]]:
    """Return the columns of each object's position, or of its rotation."""
    groups = by_object(columns)
    having = [group for group in groups if any(columns[at].group == kind for at in group)]
    return [axes_of(columns, group, kind, axes) for group in having]


def axes_of(columns: Sequence[Column], group: Sequence[int], kind: str, axes: str) -> tuple[int, ...]:
    """Return the columns of some axes of one object, in the order of the axes."""
    by_axis = {columns[at].axis: at for at in group if columns[at].group == kind}
    return tuple(by_axis[axis] for axis in axes)


def unit_of(path: Path, pairs: Mapping[str, str]) -> str:
    """Return the file's unit of length, as `UNITS` has it."""
    said = pairs.get("Length Units", "Meters")
    unit = UNITS.get(said.strip().lower())
    if unit is None:
        at = 2 + 2 * list(pairs).index("Length Units")
        raise ForeignFileError(path, f"length units {said!r}; Meters, Centimeters and Millimeters are known", 1, at)
    return unit
