"""OpenSim marker files, .trc."""

from __future__ import annotations

from pathlib import Path

from ..errors import ForeignFileError
from ..mocap import placement
from ..mocap.objects import MARKERS_TOPIC
from ..mocap.placement import NOTE_KEY, Placement
from ..mocap.space import DECIMALS, UNITS
from ..recorder import Recorder
from . import Progress, restored
from .cells import Cells
from .headers import Header, check_on_bad, distinct, first_line, refuse_numbers
from .tracks import Report, Tracks


def detect(path: Path) -> str | None:
    """Return "trc" for a marker file."""
    return "trc" if first_line(path).startswith("PathFileType") else None


def record(
    src: Path,
    recorder: Recorder,
    *,
    progress: Progress | None = None,
    on_bad: str = "raise",
    start: float | None = None,
    topic: str = MARKERS_TOPIC,
) -> None:
    """Append a marker file: one topic with `markers` by name, in metres; `set:name` is a marker of the topic `set`.

    Args:
        src: The file.
        recorder: Where its rows go.
        progress: Called now and then with the rows done and the rows in all.
        on_bad: What to do with cells that are no numbers: "raise", or "missing" to leave them out and warn.
        start: The time stamp of its time 0, in s.
        topic: The topic of markers that belong to no set.

    Raises:
        ForeignFileError: The file is no marker file; says the line and the column.
    """
    check_on_bad(on_bad)
    report = Report(src, progress)
    with src.open("rb") as file:
        header = Header(src, file)
        about = header.next("'PathFileType'").split("\t")
        keys = header.next("the row of keys").split("\t")
        values = header.next("the row of values").split("\t")
        said = {key.strip().lower(): value.strip() for key, value in zip(keys, values, strict=False)}
        decimals = _decimals(src, said, keys)
        names = _names(src, header, said)
        count = 3 * len(names)
        note = placement.from_text(about[about.index(NOTE_KEY) + 1], count) if NOTE_KEY in about[:-1] else None
        groups = [tuple(range(at, at + 3)) for at in range(0, count, 3)]
        shifts, origin = [-decimals] * count, start or 0.0
        if note:
            shifts = restored.shifts(note, decimals, count, range(count))
            origin = note.origin if start is None else start
            tracks = Tracks(recorder, note.placements, note.metadata, skip_empty=True)
        else:
            placements = [marker(name, at, topic) for name, at in zip(names, groups, strict=True)]
            tracks = Tracks(recorder, placements, {one.topic: {"length_units": "m"} for one in placements})
        cells = Cells(src, count + 2, "\t", [0, 0, *shifts], allow_short=True, on_bad=on_bad)
        line = header.line + 1
        for numbers, at in cells.read(file, line):
            if note:
                restored.turn_back(numbers[:, 2:], note, groups, ())
            line += tracks.append_from(cells, origin + numbers[:, 1], numbers[:, 2:], line)
            report.add(len(numbers), at)
    report.finish(cells.bad)


def marker(name: str, columns: tuple[int, ...], topic: str) -> Placement:
    """Return where a marker's numbers go: `set:name` into the topic `set`."""
    before, colon, behind = name.partition(":")
    if colon and before and behind:
        return Placement(before, ("markers", behind), (3,), columns)
    return Placement(topic, ("markers", name), (3,), columns)


def _decimals(path: Path, said: dict[str, str], keys: list[str]) -> int:
    unit = UNITS.get(said.get("units", "").lower())
    if unit is None:
        at = next((number for number, key in enumerate(keys, 1) if key.strip().lower() == "units"), None)
        raise ForeignFileError(path, f"the unit {said.get('units', '')!r} is not known; m, cm and mm are", 3, at)
    return DECIMALS[unit]


def _names(path: Path, header: Header, said: dict[str, str]) -> list[str]:
    """Read the rows of names and axes."""
    cells = [cell.strip() for cell in header.next("the row of marker names").rstrip("\r\n").split("\t")]
    if len(cells) < 3 or not cells[0].lower().startswith("frame") or cells[1].lower() != "time":
        raise ForeignFileError(path, "the row of marker names does not begin with Frame# and Time", header.line, 1)
    line = header.line
    axes = header.next("the row of axes").split("\t")
    refuse_numbers(path, axes, "row of axes", header.line)
    while cells and not cells[-1]:
        cells.pop()
    names = cells[2::3]
    if any(cells[at] for at in range(3, len(cells)) if at % 3 != 2) or not all(names):
        raise ForeignFileError(path, "marker names do not stand in every third column", line)
    if said.get("nummarkers", "").isdigit() and int(said["nummarkers"]) != len(names):
        raise ForeignFileError(path, f"NumMarkers is {said['nummarkers']}, but {len(names)} markers are named", line)
    return distinct(names)
