"""Vicon CSV files, of Nexus and of Tracker: sections, each with a rate, names, axes and units."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ..errors import ForeignFileError
from ..mocap import placement
from ..mocap.objects import MARKERS_TOPIC
from ..mocap.placement import NOTE_KEY, Note, Placement
from ..mocap.space import DECIMALS
from ..recorder import Recorder
from . import Progress, restored
from .cells import Cells, Floats
from .headers import Header, check_on_bad, csv_cells, distinct, first_line, refuse_numbers
from .tracks import Report, Tracks
from .trc import marker

SECTIONS = ("Trajectories", "Devices", "Model Outputs", "Joints", "Segments", "Objects", "Bones", "Events")
"""What the first line of a section says."""

_NOTE_BYTES = 1 << 24
_MOST_COLUMNS = 1 << 20
_ROTATION = ("RX", "RY", "RZ", "RW")
_PLACE = ("TX", "TY", "TZ")


@dataclass(frozen=True, slots=True)
class _Section:
    """The head of one section."""

    title: str
    rate: float
    names: list[str]
    """Of each column behind those of frame and sub frame; a name stands for all columns up to the next."""
    axes: list[str]
    units: list[str]


def detect(path: Path) -> str | None:
    """Return "vicon" for a CSV file of Vicon's."""
    return "vicon" if first_line(path).strip().strip(",;") in SECTIONS else None


def record(
    src: Path,
    recorder: Recorder,
    *,
    progress: Progress | None = None,
    on_bad: str = "raise",
    start: float = 0.0,
    topic: str = MARKERS_TOPIC,
) -> None:
    """Append the sections of a file; lengths become metres.

    Trajectories are markers, those of a subject in a topic of its name. What has RX RY RZ RW TX TY TZ is a topic with
    `pos` and `quat`; three rotation angles stay as they are, in `rotation`. Everything else, such as devices and model
    outputs, is a topic of the section's name with a field an axis.

    Args:
        src: The file.
        recorder: Where its rows go.
        progress: Called now and then with the rows done and the rows in all.
        on_bad: What to do with cells that are no numbers: "raise", or "missing" to leave them out and warn.
        start: The time stamp of frame 1, in s; the file does not say it.
        topic: The topic of markers without a subject.

    Raises:
        ForeignFileError: The file is not as Vicon writes it; says the line and the column.
    """
    check_on_bad(on_bad)
    report = Report(src, progress)
    bad = 0
    with src.open("rb") as file:
        note = _note(file)
        header = Header(src, file)
        before = 0
        while (title := _title(src, header)) is not None:
            if title == NOTE_KEY:
                break
            section = _head(src, header, title)
            if section is None:  # events
                continue
            count = len(section.axes)
            bad += _Reading(src, recorder, section, topic, note, before, start).run(file, header, report, on_bad)
            before += count
    report.finish(bad)


class _Reading:
    """Appends one section."""

    def __init__(
        self,
        path: Path,
        recorder: Recorder,
        section: _Section,
        topic: str,
        note: Note | None,
        before: int,
        start: float,
    ) -> None:
        self._path, self._section = path, section
        self._origin = note.origin if note and not start else start
        placements = _placed(section, topic)
        self._points = [one.columns for one in placements if one.path[0] in ("markers", "pos")]
        self._rotations = [one.columns for one in placements if one.path[0] == "quat"]
        self._shifts = [-DECIMALS["mm"] if unit == "mm" else 0 for unit in section.units]
        self._note: Note | None = None
        metadata: dict[str, dict[str, Any]] = {one.topic: _about(section) for one in placements}
        if note is not None:
            self._note = note = _part(note, before, len(section.axes))
            lengths = {at for at, unit in enumerate(section.units) if unit == "mm"}
            self._shifts = restored.shifts(note, DECIMALS["mm"], len(section.axes), lengths)
            placements, metadata = list(note.placements), {topic: dict(one) for topic, one in note.metadata.items()}
        self._tracks = Tracks(recorder, placements, metadata, skip_empty=note is not None)

    def run(self, file: BinaryIO, header: Header, report: Report, on_bad: str) -> int:
        """Append its rows; returns how many cells were left out."""
        section = self._section
        line = header.line + 1
        cells = Cells(self._path, len(section.axes) + 2, ",", [0, 0, *self._shifts], True, on_bad, stop_at_blank=True)
        sub_frames = 1
        for values, at in cells.read(file, line):
            frames, subs = values[:, 0], values[:, 1]
            sub_frames = max(sub_frames, _sub_frames(subs))
            times = self._origin + ((frames - 1) * sub_frames + subs) / section.rate
            numbers = values[:, 2:]
            if self._note:
                restored.turn_back(numbers, self._note, self._points, self._rotations)
            line += self._tracks.append_from(cells, times, numbers, line)
            report.add(len(values), at)
        header.skip(cells.lines)
        return cells.bad


def _sub_frames(subs: Floats) -> int:
    known = subs[~np.isnan(subs)]
    return int(known.max()) + 1 if len(known) else 1


def _note(file: BinaryIO) -> Note | None:
    """Return the note at the end of a file that this library wrote."""
    size = file.seek(0, 2)
    file.seek(max(size - _NOTE_BYTES, 0))
    _, key, text = file.read().rpartition(f"\n{NOTE_KEY}\r\n".encode())
    file.seek(0)
    if not key:
        return None
    return placement.from_text(text.decode("utf-8", "replace").strip(), _MOST_COLUMNS)


def _title(path: Path, header: Header) -> str | None:
    """Return the first line of the next section; None at the end of the file."""
    while True:
        line = header.next_or_none()
        if line is None:
            return None
        title = line.strip().strip(",;")
        if not title:
            continue
        if title in (*SECTIONS, NOTE_KEY):
            return title
        known = ", ".join(SECTIONS)
        raise ForeignFileError(path, f"{title[:40]!r} is not the name of a section; {known} are known", header.line)


def _head(path: Path, header: Header, title: str) -> _Section | None:
    """Read the rest of a section's head; None for one without a table of numbers, which is skipped."""
    text = header.next("the section's rate").strip().strip(",")
    if title == "Events":
        while text.strip(" ,"):
            text = header.next_or_none() or ""
        return None
    try:
        rate = float(text)
    except ValueError:
        rate = 0.0
    if not 0 < rate < 1e9:
        hint = "; it seems to be separated by ';', as some languages export it" if ";" in text else ""
        raise ForeignFileError(path, f"{text[:40]!r} is not a rate in Hz{hint}", header.line, 1)
    names = _cells(path, header, "the row of names")
    axes = _cells(path, header, "the row of axes")
    if len(axes) < 2 or axes[0].lower() != "frame" or axes[1].lower().replace(" ", "") != "subframe":
        hint = "; it seems to be separated by ';': export with commas and points" if ";" in axes[0] else ""
        raise ForeignFileError(path, f"the row of axes does not begin with Frame and Sub Frame{hint}", header.line, 1)
    while len(axes) > 2 and not axes[-1]:
        axes.pop()
    units = _cells(path, header, "the row of units")
    refuse_numbers(path, units, "row of units", header.line)
    count = len(axes)
    if len(names) > count and any(names[count:]):
        raise ForeignFileError(path, f"there are names for {len(names)} columns, but axes for {count}", header.line - 2)
    filled, last = [], ""
    for name in (names + [""] * count)[2:count]:
        last = name or last
        filled.append(last)
    return _Section(title, rate, filled, axes[2:], [unit.lower() for unit in (units + [""] * count)[2:count]])


def _cells(path: Path, header: Header, what: str) -> list[str]:
    return [cell.strip() for cell in csv_cells(path, header.next(what), header.line)]


def _placed(section: _Section, topic: str) -> list[Placement]:
    """Return where a foreign section's numbers go."""
    groups: dict[str, list[int]] = {}
    starts: list[tuple[str, list[int]]] = []
    for at, name in enumerate(section.names):
        if not starts or starts[-1][0] != name or section.axes[at] in [section.axes[one] for one in starts[-1][1]]:
            starts.append((name, []))
        starts[-1][1].append(at)
    for name, (_, columns) in zip(distinct([name for name, _ in starts]), starts, strict=True):
        groups[name] = columns
    placements: list[Placement] = []
    for name, columns in groups.items():
        by_axis = {section.axes[at].upper(): at for at in columns}
        if set(by_axis) == set("XYZ") and section.title == "Trajectories":
            placements.append(marker(name or "marker", tuple(by_axis[axis] for axis in "XYZ"), topic))
        elif set(_PLACE) <= set(by_axis):
            where = name.replace(":", "/") or section.title.lower()
            placements.append(Placement(where, ("pos",), (3,), tuple(by_axis[axis] for axis in _PLACE)))
            turns = tuple(by_axis[axis] for axis in _ROTATION if axis in by_axis)
            if len(turns) > 2:
                placements.append(Placement(where, ("quat" if len(turns) == 4 else "rotation",), (len(turns),), turns))
        else:
            where = section.title.lower().replace(" ", "_")
            paths = {at: tuple(filter(None, (name, section.axes[at]))) or ("value",) for at in columns}
            placements += [Placement(where, path, (), (at,)) for at, path in paths.items()]
    return placements


def _about(section: _Section) -> dict[str, Any]:
    said: dict[str, Any] = {"length_units": "m", "quat_order": "xyzw", "vicon": {"section": section.title}}
    turned = {unit for axis, unit in zip(section.axes, section.units, strict=True) if axis in _ROTATION[:3]}
    if "RW" not in section.axes and turned:
        said["units"] = {"rotation": turned.pop()}
    return said


def _part(note: Note, first: int, count: int) -> Note:
    """Return what a note says of one section's columns."""
    mine = [one for one in note.placements if all(first <= at < first + count for at in one.columns)]
    moved = tuple(Placement(one.topic, one.path, one.shape, tuple(at - first for at in one.columns)) for one in mine)
    return replace(note, placements=moved)
