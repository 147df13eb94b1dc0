"""Reads the header of Motive's CSV: its pairs, and the type, name, group and axis of each column."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from ....errors import ForeignFileError
from ...text.dialect import Dialect, number
from ...text.headers import HeaderLines, unit_of_length, without_empty_end
from . import layout

_TIME_CODES = ("timecode", "smpte", "smptetimecode")


class HeaderColumn(NamedTuple):
    """One column behind those of frame, time and time code."""

    type: str
    name: str
    identity: str
    group: str
    axis: str


@dataclass(frozen=True, slots=True)
class ColumnHeader:
    """The columns of a file."""

    columns: list[HeaderColumn]
    time: int
    """The column of times."""
    time_codes: tuple[int, ...] = ()
    """The columns of text: time codes."""

    @property
    def leading(self) -> int:
        """How many columns come before the others: frame, time, and a time code."""
        return 2 + len(self.time_codes)


def read_pairs(path: Path, line: str, dialect: Dialect) -> dict[str, str]:
    """Return the first line's keys and values."""
    cells = dialect.split(line)
    if not cells or cells[0] != layout.FORMAT_VERSION:
        problem = f"the file does not begin with {layout.FORMAT_VERSION!r}; it is no CSV of Motive's"
        raise ForeignFileError(path, problem, 1, 1)
    pairs = {key: value for key, value in zip(cells[::2], cells[1::2], strict=False) if key}
    version = pairs.get(layout.FORMAT_VERSION, "").replace(",", ".")
    if version not in layout.VERSIONS:
        raise ForeignFileError(path, f"format version {version!r}; {', '.join(layout.VERSIONS)} are known", 1, 2)
    if pairs.get(layout.ROTATION_TYPE, "") not in (layout.QUATERNION, ""):
        kind = pairs[layout.ROTATION_TYPE]
        raise ForeignFileError(
            path, f"rotation type {kind!r}; export with quaternions", 1, 1 + cells.index(layout.ROTATION_TYPE) + 1
        )
    return pairs


def read_columns(path: Path, header: HeaderLines, dialect: Dialect) -> ColumnHeader:
    """Read the header's rows; returns what the columns are."""
    rows: list[list[str]] = []
    lines: list[int] = []
    while True:
        cells = dialect.split(header.next("the row of 'Frame' and 'Time'"))
        if any(cells):
            rows.append(cells)
            lines.append(header.line)
        if rows and rows[-1][0].lower() == layout.FRAME.lower():
            break
        # Motive writes at most five rows above it (version 1.25). More rows, or numbers, mean that it is missing.
        if len(rows) > 6 or (rows and number(rows[-1][0]) is not None):
            raise ForeignFileError(path, "the header has no row that begins with 'Frame'", header.line)
    *above, axes = rows
    codes = tuple(at for at in (1, 2) if at < len(axes) and axes[at].lower().replace(" ", "") in _TIME_CODES)[:1]
    time, leading = 2 if codes == (1,) else 1, 2 + len(codes)
    if len(axes) < leading or not axes[time].lower().startswith("time"):
        raise ForeignFileError(path, "the column after 'Frame' is not 'Time'", lines[-1], time + 1)
    named = _named(path, above, lines, leading)
    width = max(len(without_empty_end(row)) for row in (axes, *(row for row, _ in named.values())))
    for row_name, (row, line) in named.items():
        if len(row) != len(axes) and (len(row) < width or any(row[width:])):
            raise ForeignFileError(
                path, f"the row of {row_name} has {len(row)} cells, but that of axes {len(axes)}", line
            )
    axes = [*axes, *[""] * (width - len(axes))][:width]
    header_columns = [
        HeaderColumn._make([*(named[row_name][0][at] for row_name in ("types", "names", "IDs", "groups")), axes[at]])
        for at in range(leading, width)
    ]
    for at, column in enumerate(header_columns, leading + 1):
        if not column.type:
            raise ForeignFileError(path, "the column has no type", named["types"][1], at)
    _check(path, header_columns, leading, lines[-1])
    return ColumnHeader(header_columns, time, codes)


def _named(
    path: Path, rows: Sequence[list[str]], lines: Sequence[int], leading: int
) -> dict[str, tuple[list[str], int]]:
    """Return the rows of types, names, IDs and groups, with their lines."""
    labels: dict[str, tuple[list[str], int]] = {}
    plain: list[tuple[list[str], int]] = []
    for row, line in zip(rows, lines, strict=False):
        label = next((cell for cell in row[1:leading] if cell), "")
        if label:
            labels[label] = row, line
        else:
            plain.append((row, line))
    if labels:
        wanted = {
            "types": labels.get(layout.TYPE),
            "names": labels.get(layout.NAME),
            "IDs": labels.get(layout.IDENTITY),
        }
        wanted["groups"] = plain[0] if plain else None
    else:
        wanted = dict(zip(("types", "names", "IDs", "groups"), [*plain, None, None, None, None], strict=False))
        if len(plain) == 3 and wanted["groups"] is None:  # version 1.2 may have no IDs
            wanted["groups"], wanted["IDs"] = wanted["IDs"], wanted["names"]
    rows_by_label: dict[str, tuple[list[str], int]] = {}
    for row_name, placed in wanted.items():
        if placed is None:
            raise ForeignFileError(path, f"the header has no row of {row_name}", lines[-1])
        rows_by_label[row_name] = placed
    return rows_by_label


def _check(path: Path, columns: Sequence[HeaderColumn], leading: int, line: int) -> None:
    """Raise if an object does not have the columns that its type has."""
    for group in by_object(columns):
        first = columns[group[0]]
        have = [(columns[at].group, columns[at].axis) for at in group]
        is_point = first.type in (*layout.BODIES, *layout.MARKERS)
        wanted = [(layout.POSITION, axis) for axis in layout.POSITION_AXES] if is_point else []
        if first.type in layout.BODIES:
            wanted = [*((layout.ROTATION, axis) for axis in layout.ROTATION_AXES), *wanted]
        missing = next((column for column in wanted if column not in have), None)
        if missing is not None:
            at = leading + group[0] + 1
            raise ForeignFileError(path, f"{first.type} {first.name!r} has no column {' '.join(missing)}", line, at)


def by_object(columns: Sequence[HeaderColumn]) -> list[list[int]]:
    """Return the columns of each object; one that has all of its columns begins again where they are repeated."""
    groups: dict[tuple[str, str, str], list[list[int]]] = {}
    for at, column in enumerate(columns):
        same = groups.setdefault((column.type, column.name, column.identity), [[]])
        taken = {(columns[place].group, columns[place].axis) for place in same[-1]}
        if (column.group, column.axis) in taken:
            same.append([])
        same[-1].append(at)
    return sorted((group for same in groups.values() for group in same), key=lambda group: group[0])


def vectors(columns: Sequence[HeaderColumn], kind: str, axes: str) -> list[tuple[int, ...]]:
    """Return the columns of each object's position, or of its rotation."""
    having = [{columns[at].axis: at for at in group if columns[at].group == kind} for group in by_object(columns)]
    return [tuple(by_axis[axis] for axis in axes) for by_axis in having if set(axes) <= by_axis.keys()]


def axes_of(columns: Sequence[HeaderColumn], group: Sequence[int], kind: str, axes: str) -> tuple[int, ...]:
    """Return the columns of some axes of one object, in the order of the axes."""
    by_axis = {columns[at].axis: at for at in group if columns[at].group == kind}
    return tuple(by_axis[axis] for axis in axes)


def unit_of(path: Path, pairs: Mapping[str, str], asked: str | None) -> str:
    """Return the file's unit of length: "m", "cm" or "mm"."""
    stated = pairs.get(layout.LENGTH_UNITS, layout.UNIT_WORDS["m"])
    at = 2 + 2 * list(pairs).index(layout.LENGTH_UNITS) if layout.LENGTH_UNITS in pairs else None
    return unit_of_length(path, stated, asked, "length units", 1, at)


def slug(text: str) -> str:
    """Return a word of Motive's as the name of a field: "Marker Quality" is marker_quality."""
    return re.sub(r"[^0-9a-z]+", "_", text.lower()).strip("_") or "value"
