"""Qualisys Track Manager TSV files: markers, and bodies with six degrees of freedom."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..errors import ForeignFileError
from ..mocap import placement
from ..mocap.objects import MARKERS_TOPIC
from ..mocap.placement import Placement
from ..mocap.space import DECIMALS
from ..recorder import Recorder
from ..rows import rotations
from . import Progress, restored
from .cells import Cells, Floats
from .headers import Header, check_on_bad, distinct, first_line, seconds_at
from .tracks import Report, Tracks
from .trc import marker

NOTE_WORD = "ML_DASH_NOTE"
_FIRST_WORDS = ("FILE_VERSION\t", "NO_OF_FRAMES\t", "NO_OF_CAMERAS\t")
_STAMP = re.compile(r"(\d{4})-(\d\d)-(\d\d)[, ]+(\d\d):(\d\d):(\d\d)(?:[.:](\d{1,6}))?")
_WORD = re.compile(r"[A-Z][A-Z0-9_]*$")
_BODY_COLUMNS = 16
"""X Y Z, roll pitch yaw, residual, and the rotation matrix column by column."""


def detect(path: Path) -> str | None:
    """Return "qtm" for a TSV file of QTM's."""
    return "qtm" if first_line(path).startswith(_FIRST_WORDS) else None


def record(
    src: Path,
    recorder: Recorder,
    *,
    progress: Progress | None = None,
    on_bad: str = "raise",
    timezone: str = "UTC",
    start: float | None = None,
    topic: str = MARKERS_TOPIC,
) -> None:
    """Append a TSV file, in metres: one topic with `markers` by name, or a topic a body with `pos` and `quat`.

    Args:
        src: The file.
        recorder: Where its rows go.
        progress: Called now and then with the rows done and the rows in all.
        on_bad: What to do with cells that are no numbers: "raise", or "missing" to leave them out and warn.
        timezone: Of the file's time stamp, for it does not say: an IANA name.
        start: The time stamp of its time 0, instead of the file's time stamp, in s.
        topic: The topic of markers that belong to no set.

    Raises:
        ForeignFileError: The file is not as QTM writes it; says the line and the column.
    """
    check_on_bad(on_bad)
    report = Report(src, progress)
    with src.open("rb") as file:
        header = Header(src, file)
        said, has_times = _keys(src, header)
        has_bodies = "BODY_NAMES" in said
        names = distinct(
            [name.strip() for name in said["BODY_NAMES" if has_bodies else "MARKER_NAMES"].split("\t") if name.strip()]
        )
        per_name = _BODY_COLUMNS if has_bodies else 3
        count = per_name * len(names)
        note = placement.from_text(said.get(NOTE_WORD, ""), count)
        shifts = [-DECIMALS["mm"] if at % per_name < 3 else 0 for at in range(count)]
        groups = [tuple(range(at, at + 3)) for at in range(0, count, per_name)]
        origin = _start(said, timezone) if start is None else start
        if note and not has_bodies:
            shifts = restored.shifts(note, DECIMALS["mm"], count, range(count))
            origin = note.origin if start is None else start
            tracks = Tracks(recorder, note.placements, note.metadata, skip_empty=True)
        else:
            found = [one for number, name in enumerate(names) for one in _placed(name, number, topic, has_bodies)]
            about = {"length_units": "m", "quat_order": "xyzw"} if has_bodies else {"length_units": "m"}
            tracks = Tracks(recorder, found, {one.topic: about for one in found})
        leading = 2 if has_times else 0
        cells = Cells(src, count + leading, "\t", [0] * leading + shifts, allow_short=True, on_bad=on_bad)
        rate, line, row = _rate(src, said, has_times), header.line + 1, 0
        for values, at in cells.read(file, line):
            times = values[:, 1] if has_times else np.arange(row, row + len(values)) / rate
            numbers = _bodies(values[:, leading:]) if has_bodies else values[:, leading:]
            if note and not has_bodies:
                restored.turn_back(numbers, note, groups, ())
            tracks.append_from(cells, origin + times, numbers, line)
            report.add(len(values), at)
            line, row = line + len(values), row + len(values)
    report.finish(cells.bad)


def _keys(path: Path, header: Header) -> tuple[dict[str, str], bool]:
    """Read the header; returns its keys and values, and whether rows begin with frame and time."""
    said: dict[str, str] = {}
    while True:
        at = header.at()
        line = header.next("its numbers")
        key, _, value = line.partition("\t")
        if key.strip() == "Frame":
            break
        if not _WORD.fullmatch(key.strip()):
            header.back(at)
            break
        said.setdefault(key.strip(), value.rstrip("\t"))
    if "MARKER_NAMES" not in said and "BODY_NAMES" not in said:
        what = "2D data" if said.get("DATA_INCLUDED") == "2D" else "neither MARKER_NAMES nor BODY_NAMES"
        raise ForeignFileError(path, f"the header has {what}; export 3D or 6D data with the TSV header", header.line)
    return said, key.strip() == "Frame"


def _rate(path: Path, said: dict[str, str], has_times: bool) -> float:
    try:
        rate = float(said.get("FREQUENCY", ""))
    except ValueError:
        rate = 0.0
    if rate <= 0 and not has_times:
        raise ForeignFileError(path, f"FREQUENCY is {said.get('FREQUENCY', 'missing')!r}, and there are no times", 1)
    return rate


def _start(said: dict[str, str], timezone: str) -> float:
    """Return the start of the capture, in s since 1970; 0.0 if the file does not say."""
    found = _STAMP.match(said.get("TIME_STAMP", ""))
    if found is None:
        return 0.0
    year, month, day, hour, minute, second = (int(part) for part in found.groups()[:6])
    return seconds_at((year, month, day, hour, minute, second), found[7] or "", timezone)


def _placed(name: str, number: int, topic: str, has_bodies: bool) -> list[Placement]:
    if not has_bodies:
        return [marker(name, tuple(range(3 * number, 3 * number + 3)), topic)]
    at = 8 * number
    return [
        Placement(name, ("pos",), (3,), (at, at + 1, at + 2)),
        Placement(name, ("quat",), (4,), tuple(range(at + 3, at + 7))),
        Placement(name, ("residual",), (), (at + 7,)),
    ]


def _bodies(numbers: Floats) -> Floats:
    """Return position, quaternion and residual of each body, [N, 8 B], of what the file says, [N, 16 B]."""
    found = []
    for at in range(0, numbers.shape[1], _BODY_COLUMNS):
        body = numbers[:, at : at + _BODY_COLUMNS]
        matrices = body[:, 7:].reshape(-1, 3, 3).transpose(0, 2, 1)
        turns, bad = rotations.of_matrices(matrices)
        turns[bad] = np.nan
        found.append(np.concatenate((body[:, :3], turns, body[:, 6:7]), axis=1))
    return np.concatenate(found, axis=1)
