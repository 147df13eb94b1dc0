"""OpenSim storage files, .sto and .mot."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

from ..errors import ForeignFileError
from ..mocap import placement
from ..mocap.placement import Placement
from ..recorder import Recorder
from . import Progress
from .cells import Cells
from .headers import Header, check_on_bad
from .tracks import Report, Tracks

NOTE_LINE = "ml_dash_note"
_SUFFIXES = (".sto", ".mot")
_MOST_HEADER_LINES = 1000


def detect(path: Path) -> str | None:
    """Return "sto" for a storage file."""
    return "sto" if path.suffix.lower() in _SUFFIXES and path.is_file() else None


def beside(path: Path, name: str | None) -> Path | None:
    """Return the storage file of a name in the folder of another file, if it is there."""
    if not name or Path(name).name != name:
        return None
    found = path.with_name(name)
    return found if found.is_file() else None


def record(
    src: Path,
    recorder: Recorder,
    *,
    progress: Progress | None = None,
    on_bad: str = "raise",
    start: float | None = None,
    topic: str = "joints",
) -> None:
    """Append a storage file: one topic, whose field `q` has all columns, with their names as its `joint_names`.

    Angles stay in the unit of the file, which the topic's metadata says. A file that this library wrote becomes the
    topics and fields that it was written from.

    Args:
        src: The file.
        recorder: Where its rows go.
        progress: Called now and then with the rows done and the rows in all.
        on_bad: What to do with cells that are no numbers: "raise", or "missing" to leave them out and warn.
        start: The time stamp of its time 0, in s.
        topic: What to call the topic.

    Raises:
        ForeignFileError: The file is no storage file; says the line and the column.
    """
    check_on_bad(on_bad)
    report = Report(src, progress)
    with src.open("rb") as file:
        header = Header(src, file)
        said = _keys(src, header)
        labels = header.next("the row of column names")
        while not labels.strip():
            labels = header.next("the row of column names")
        separator = "\t" if "\t" in labels else " "
        names = [name.strip() for name in (labels.rstrip("\t").split("\t") if separator == "\t" else labels.split())]
        if not names or names[0].lower() != "time":
            raise ForeignFileError(src, f"the first column is {names[0]!r}, not 'time'", header.line, 1)
        if said.get("ncolumns", "").isdigit() and int(said["ncolumns"]) != len(names):
            raise ForeignFileError(
                src, f"the header says nColumns={said['ncolumns']}, but {len(names)} columns are named", header.line
            )
        note = placement.from_text(said.get(NOTE_LINE, ""), len(names) - 1)
        origin = start if start is not None else note.origin if note else 0.0
        if note:
            tracks = Tracks(recorder, note.placements, note.metadata, skip_empty=True)
        else:
            unit = "deg" if said.get("indegrees", "no").lower() in ("yes", "true", "1") else "rad"
            whole = Placement(topic, ("q",), (len(names) - 1,), tuple(range(len(names) - 1)))
            tracks = Tracks(recorder, [whole], {topic: {"joint_names": names[1:], "units": {"q": unit}}})
        cells = Cells(src, len(names), separator if _is_split(file, separator) else " ", on_bad=on_bad)
        line = header.line + 1
        for values, at in cells.read(file, line):
            line += tracks.append_from(cells, origin + values[:, 0], values[:, 1:], line)
            report.add(len(values), at)
    report.finish(cells.bad)


def _keys(path: Path, header: Header) -> dict[str, str]:
    """Read up to `endheader`; returns the keys, in small letters, and their values."""
    said: dict[str, str] = {}
    while True:
        line = header.next("'endheader'")
        if line.strip().lower() == "endheader":
            return said
        if header.line > _MOST_HEADER_LINES:
            raise ForeignFileError(path, "the header has no 'endheader'", header.line)
        key, equals, value = line.partition("=")
        if equals:
            said[key.strip().lower()] = value.strip()


def _is_split(file: BinaryIO, separator: str) -> bool:
    """Whether the first line of numbers is split as the names are."""
    if separator == " ":
        return True
    at = file.tell()
    line = file.readline(1 << 20)
    file.seek(at)
    return b"\t" in line or not line.strip()
