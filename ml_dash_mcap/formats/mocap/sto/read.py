"""Reads OpenSim storage files, .sto and .mot, and the .mot files of SIMM."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from ....errors import ForeignFileError
from ....recorder import Recorder
from ...foreign_names import distinct
from ...registry import Progress
from ...text.dialect import BLANKS, Dialect, number, of_line
from ...text.headers import HeaderLines, preview, without_empty_end
from ...text.number_cells import Cells, Floats, NumberPart
from ...text.plain_text import opened
from .. import placement, row_times
from ..placement import Note, Placement
from ..row_times import Clue, Timing
from ..take_options import StoReadOptions
from ..track_rows import ReadingProgress, TopicRows, checked
from . import layout, vectors

_MOST_HEADER_LINES = 1000
_QUOTED = re.compile(r'"((?:[^"]|"")*)"')
_DOUBLES = ("", "double", "float")


def beside(path: Path, name: str | None) -> Path | None:
    """Return the storage file of a name in the folder of another file, if it is there."""
    # The name stands in a file from outside and must not lead out of its folder.
    if not name or Path(name).name != name:
        return None
    file = path.with_name(name)
    return file if file.is_file() else None


def record(src: Path, recorder: Recorder, options: StoReadOptions, progress: Progress | None) -> None:
    """Append a storage file: one topic, whose field `q` has all columns, with their names as its `joint_names`.

    Angles stay in the unit of the file, which the topic's metadata says. Columns of vectors and quaternions
    (`DataType=Vec3` and the like) are a field each. A file that this library wrote becomes the topics and fields that
    it was written from.

    Args:
        src: The file.
        recorder: Where its rows go.
        options: How to read it.
        progress: Called now and then with the rows done and the rows in all.

    Raises:
        ForeignFileError: The file is no storage file; says the line and the column.
    """
    report = ReadingProgress(src, progress)
    with table(src, on_bad=options.on_bad, start=options.start) as source:
        kind = vectors.KINDS.get(source.data_type)
        placements, metadata = source.fields(options.topic or (layout.TOPIC if kind is None else kind.topic))
        tracks = TopicRows(src, recorder, placements, metadata, skip_empty=source.note is not None)
        for part in source.parts():
            times = source.when.stamps(part.values[:, 0], part.values[:, 0])
            tracks.append_from(source.cells, times, part.values[:, 1:], part, 1)
            report.add(len(part.values), part.at)
    report.finish(source.cells.bad)


@dataclass
class Table:
    """An open storage file, its header read."""

    path: Path
    file: BinaryIO
    keys: dict[str, str]
    """The keys of the header in lower case, to their values."""
    names: list[str]
    """The names of the columns, without that of time."""
    cells: Cells
    line: int
    """Where the numbers begin."""
    note: Note | None = None
    when: Timing = field(default_factory=lambda: Timing(0.0))

    @property
    def data_type(self) -> str:
        """The type of the columns' values: "" or "double" for numbers."""
        return self.keys.get("datatype", "").lower()

    def parts(self) -> Iterator[NumberPart]:
        """Yield the rows; the times that frames say stand in the first column, if these count."""
        row = 0
        for part in self.cells.read(self.file, self.line):
            if self.when.rate is not None:
                # `when` makes times of row numbers where the printed times are too coarse.
                part.values[:, 0] = range(row, row + len(part.values))
                row += len(part.values)
            yield part

    def stamped(self) -> Iterator[tuple[Floats, Floats]]:
        """Yield time stamps, [N], s, and numbers, [N, C]."""
        for part in self.parts():
            times, keep = checked(self.cells, self.when.stamps(part.values[:, 0], part.values[:, 0]), part.lines, 1)
            yield times, part.values[:, 1:] if keep is None else part.values[keep, 1:]

    def fields(self, topic: str) -> tuple[list[Placement], dict[str, dict[str, Any]]]:
        """Return where the numbers go, and the metadata of the topics."""
        if self.note is not None:
            return list(self.note.placements), {
                name: {**about, **self.when.metadata} for name, about in self.note.metadata.items()
            }
        about: dict[str, Any] = {"sto": {key: value for key, value in self.keys.items() if key != layout.NOTE}}
        kind = vectors.KINDS.get(self.data_type)
        stated = self.keys.get("units")
        if kind is not None:
            more: dict[str, Any] = {"quat_order": "wxyz"} if kind.is_rotation else {}
            if stated:
                more["units"] = dict.fromkeys(self.names, stated)
            return vectors.placements(self.names, kind, topic), {topic: {**more, **about, **self.when.metadata}}
        unit = _angle_unit(self.path, self.keys) or stated
        count = len(self.names)
        metadata = {
            "joint_names": self.names,
            **({"units": {"q": unit}} if unit else {}),
            **about,
            **self.when.metadata,
        }
        return [Placement(topic, ("q",), (count,), tuple(range(count)))], {topic: metadata}


@contextmanager
def table(src: Path, *, on_bad: str, start: float | None) -> Iterator[Table]:
    """Open a storage file and read its header.

    Raises:
        ForeignFileError: It is none; says the line and the column.
    """
    with opened(src) as file:
        header = HeaderLines(src, file)
        keys = _keys(src, header)
        labels = header.next("the row of column names")
        while not labels.strip(f"{BLANKS},;"):
            labels = header.next("the row of column names")
        dialect = of_line(labels, default=" ")
        names = without_empty_end(dialect.split(labels))
        _check_names(src, keys, names, header.line)
        note = placement.from_text(keys.get(layout.NOTE, ""), len(names) - 1)
        head, tail = preview(file)
        line = header.line + 1
        kind = vectors.KINDS.get(keys.get("datatype", "").lower())
        if kind is not None:
            cells: Cells = vectors.VectorCells(src, len(names), dialect, kind, on_bad)
        elif keys.get("datatype", "").lower() in _DOUBLES:
            cells = Cells(src, len(names), _of_numbers(dialect, head), on_bad=on_bad)
            cells.learn(head + tail)
        else:
            types = ", ".join(("double", *(vector_kind.word for vector_kind in vectors.KINDS.values())))
            raise ForeignFileError(src, f"DataType={keys['datatype']} is not known; {types} are")
        opened_table = Table(src, file, keys, distinct(names[1:]), cells, line, note)
        origin = start if start is not None else note.origin if note else 0.0
        clue = Clue(0, None, number(keys.get("datarate", "")))
        is_asked = start is not None
        opened_table.when = row_times.settled(src, clue, cells, file, line, origin, is_asked=is_asked)
        yield opened_table


def _check_names(path: Path, keys: dict[str, str], names: list[str], line: int) -> None:
    if not names or names[0].lower() != layout.TIME:
        first = repr(names[0]) if names else "missing"
        raise ForeignFileError(path, f"the first column is {first}, not {layout.TIME!r}", line, 1)
    for word in (layout.COLUMNS, "datacolumns"):
        count = number(keys.get(word.lower(), ""))
        if count is not None and count != len(names):
            raise ForeignFileError(
                path, f"the header says {word}={keys[word.lower()]}, but {len(names)} columns are named", line
            )


def _angle_unit(path: Path, keys: dict[str, str]) -> str | None:
    """Return "deg" or "rad" for a file of angles; None if it does not say.

    OpenSim takes .mot files without a version, as SIMM writes them, for degrees, unless they say otherwise.
    """
    in_degrees = keys.get(layout.IN_DEGREES.lower())
    if in_degrees is not None:
        return "deg" if in_degrees.lower() in ("yes", "true", "1", "y") else "rad"
    version = number(keys.get(layout.VERSION, "0")) or 0.0
    return "deg" if path.suffix.lower() == ".mot" and version < 1 else None


def _keys(path: Path, header: HeaderLines) -> dict[str, str]:
    """Read up to `endheader`; returns the keys, in small letters, and their values.

    OpenSim writes `key=value`, SIMM `key value`.
    """
    values: dict[str, str] = {}
    while True:
        line = header.next(repr(layout.END)).strip(BLANKS)
        quoted = _QUOTED.match(line)
        line = quoted[1].replace('""', '"') if quoted else line.strip(f"{BLANKS},;")
        if line.lower() == layout.END:
            return values
        if header.line > _MOST_HEADER_LINES:
            raise ForeignFileError(path, f"the header has no {layout.END!r}", header.line)
        key, equals, value = line.partition("=")
        if not equals:
            key, _, value = line.partition(" " if " " in line else "\t")
            if key.lower() not in ("name", "datacolumns", "datarows", "range", "wordwrap"):
                continue
        values.setdefault(key.strip(BLANKS).lower(), value.strip(BLANKS))


def _of_numbers(dialect: Dialect, lines: list[str]) -> Dialect:
    """Return the dialect of the numbers, which blanks may separate although tabs do so with the names."""
    first = next((line for line in lines if not dialect.is_blank(line)), "")
    return dialect if dialect.separator in first or not first else Dialect(" ")
