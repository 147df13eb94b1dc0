"""C3D files, read by ezc3d: markers, rotations of bodies, analog channels."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..errors import ForeignFileError, FormatError
from ..mocap import placement
from ..mocap.objects import MARKERS_TOPIC
from ..mocap.placement import Note, Placement
from ..mocap.space import DECIMALS, UNITS, turned, turned_rotations, unit_of
from ..recorder import Recorder
from ..rows import rotations
from . import Progress
from .cells import Floats
from .headers import distinct
from .tracks import Arrays
from .trc import marker

GROUP = "ML_DASH"
_MAGIC = 0x50
_ROWS = 4096
_BIG_ENDIAN = bytes((86,))
"""What files of MIPS machines have as their processor."""


def detect(path: Path) -> str | None:
    """Return "c3d" for a C3D file."""
    if path.suffix.lower() != ".c3d" or not path.is_file():
        return None
    with path.open("rb") as file:
        return "c3d" if file.read(2)[1:] == bytes((_MAGIC,)) else None


def record(
    src: Path,
    recorder: Recorder,
    *,
    progress: Progress | None = None,
    start: float | None = None,
    topic: str = MARKERS_TOPIC,
) -> None:
    """Append a C3D file, in metres: one topic with `markers` by name; `set:name` is a marker of the topic `set`.

    Rotations are topics with `pos` and `quat`. Analog channels are fields of the topic `analog`, at their own rate. A
    file that this library wrote becomes the topics and fields that it was written from, to float32.

    Args:
        src: The file.
        recorder: Where its rows go.
        progress: Called now and then with the rows done and the rows in all.
        start: The time stamp of its first frame, in s; the file does not say it.
        topic: The topic of markers that belong to no set.

    Raises:
        ForeignFileError: The file is damaged, or its unit is not known.
        FormatError: The extra `c3d` is not installed.
    """
    file = _open(src)
    said, data = file["parameters"], file["data"]
    points = np.asarray(data["points"], np.float64)
    count, hz = points.shape[2], _rate(src, said, "POINT")
    unit = _unit(src, said)
    matrices = np.asarray(data["rotations"], np.float64)
    has_rotations = matrices.ndim == 4 and matrices.shape[2:] == (matrices.shape[2], count)
    poses = matrices.transpose(3, 2, 0, 1) if has_rotations else np.empty((count, 0, 4, 4))
    analogs = np.asarray(data["analogs"], np.float64)
    sub_frames = analogs.shape[2] // count if count else 0
    frames = _frames(src)
    if count < frames:
        raise ForeignFileError(src, f"it is no whole C3D file: it has {count} of {frames} frames")
    width = 3 * points.shape[1] + 4 * poses.shape[1] + analogs.shape[1]
    note = _note(said, width) if sub_frames <= 1 else None
    places = points[:3].transpose(2, 1, 0).copy()  # [N, M, 3]
    places[(np.asarray(data["meta_points"]["residuals"])[0] < 0).T] = np.nan
    numbers = np.concatenate((places.reshape(count, -1), _turns(poses)), axis=1)
    origin = start if start is not None else note.origin if note else 0.0
    times = origin + np.arange(count) / hz
    labels = _labels(said, "POINT", points.shape[1], "point")
    bodies = _labels(said, "ROTATION", poses.shape[1], "body")
    channels = _labels(said, "ANALOG", analogs.shape[1], "channel")
    if note:
        numbers = np.concatenate((numbers, analogs[0].T.reshape(count, -1)), axis=1)
        _restore(numbers, note, len(labels), len(bodies), unit)
        found, metadata, channels = list(note.placements), note.metadata, []
    else:
        numbers[:, : 3 * len(labels)] /= 10.0 ** DECIMALS[unit]
        found = [marker(name, tuple(range(3 * at, 3 * at + 3)), topic) for at, name in enumerate(labels)]
        found += _placed(bodies, numbers, 3 * len(labels))
        if len(bodies):
            numbers = np.concatenate((numbers, poses[:, :, :3, 3].reshape(count, -1)), axis=1)
        metadata = {one.topic: {"length_units": "m", "quat_order": "xyzw"} for one in found}
    arrays = Arrays(recorder, found, metadata, skip_empty=note is not None)
    for first in range(0, count, _ROWS):
        part = slice(first, first + _ROWS)
        arrays.append(times[part], numbers[part])
        if progress is not None:
            progress(min(first + _ROWS, count), count)
    if channels and analogs.size:
        where = [Placement("analog", (name,), (), (at,)) for at, name in enumerate(channels)]
        analog_hz = _rate(src, said, "ANALOG") if sub_frames > 1 else hz
        Arrays(recorder, where, {}).append(origin + np.arange(analogs.shape[2]) / analog_hz, analogs[0].T)


def _open(path: Path) -> Any:
    try:
        import ezc3d
    except ImportError as error:
        raise FormatError("C3D needs the package ezc3d: pip install 'ml-dash-mcap[c3d]'") from error
    try:
        return ezc3d.c3d(str(path))
    except (OSError, ValueError, IndexError, KeyError, RuntimeError, MemoryError) as error:
        raise ForeignFileError(path, f"it is no whole C3D file: {error}") from error


def _rate(path: Path, said: Any, group: str) -> float:
    rate = float(np.ravel(said[group]["RATE"]["value"] or [0.0])[0])
    if not 0 < rate < 1e9:
        raise ForeignFileError(path, f"{group}:RATE is {rate}, which is no rate in Hz")
    exact = _exact_rate(said) if group == "POINT" else None
    return exact if exact is not None and np.float32(exact) == np.float32(rate) else rate


def _exact_rate(said: Any) -> float | None:
    """Return the rate that this library wrote as text, for the file has it as float32."""
    try:
        return float(said[GROUP]["RATE"]["value"][0])
    except (KeyError, IndexError, TypeError, ValueError):
        return None


def _unit(path: Path, said: Any) -> str:
    values = said["POINT"].get("UNITS", {}).get("value") or ["mm"]
    unit = UNITS.get(str(values[0]).strip().lower())
    if unit is None:
        raise ForeignFileError(path, f"POINT:UNITS is {values[0]!r}; m, cm and mm are known")
    return unit


def _labels(said: Any, group: str, count: int, word: str) -> list[str]:
    """Return the names of points or channels; those that the file does not name are numbered."""
    names: list[str] = []
    number = 1
    while group in said and (key := "LABELS" if number == 1 else f"LABELS{number}") in said[group]:
        names += [str(name).strip() for name in said[group][key]["value"]]
        number += 1
    names = [name or f"{word} {at + 1}" for at, name in enumerate(names[:count])]
    return distinct(names + [f"{word} {at + 1}" for at in range(len(names), count)])


def _frames(path: Path) -> int:
    """Return how many frames the file's header says that it has; ezc3d does not compare."""
    with path.open("rb") as file:
        head = file.read(512)
        file.seek((head[0] - 1) * 512 + 3)
        order: Literal["big", "little"] = "big" if file.read(1) == _BIG_ENDIAN else "little"
    first, last = (int.from_bytes(head[at : at + 2], order) for at in (6, 8))
    return last - first + 1


def _note(said: Any, columns: int) -> Note | None:
    try:
        text = "".join(str(piece) for piece in said[GROUP]["NOTE"]["value"])
    except (KeyError, TypeError):
        return None
    return placement.from_text(text, columns)


def _turns(matrices: Floats) -> Floats:
    """Return the quaternions of the bodies, [N, 4 B], of their matrices, [N, B, 4, 4]."""
    count, bodies = matrices.shape[:2]
    turns, bad = rotations.of_matrices(matrices[:, :, :3, :3].reshape(-1, 3, 3))
    turns[bad] = np.nan
    return turns.reshape(count, 4 * bodies)


def _placed(bodies: list[str], numbers: Floats, first: int) -> list[Placement]:
    """Return where the bodies of a foreign file go: their quaternions stand before their positions."""
    found: list[Placement] = []
    behind = numbers.shape[1]
    for at, name in enumerate(bodies):
        found.append(Placement(name, ("pos",), (3,), tuple(range(behind + 3 * at, behind + 3 * at + 3))))
        found.append(Placement(name, ("quat",), (4,), tuple(range(first + 4 * at, first + 4 * at + 4))))
    return found


def _restore(numbers: Floats, note: Note, points: int, bodies: int, unit: str) -> None:
    """Give numbers the units and axes that they had when they were recorded, in place."""
    topics = {at: one for one in note.placements for at in one.columns}
    for at in range(0, 3 * points, 3):
        one = topics.get(at)
        said = note.metadata.get(one.topic, {}) if one else {}
        own = unit_of(said, ".".join(one.path)) if one else "m"
        numbers[:, at : at + 3] *= 10.0 ** (DECIMALS[own] - DECIMALS[unit])
        if note.up is not None:
            numbers[:, at : at + 3] = turned(numbers[:, at : at + 3], note.up, str(said.get("up", "z")).lower())
    for at in range(3 * points, 3 * points + 4 * bodies, 4):
        up = str(note.metadata.get(topics[at].topic, {}).get("up", "z")).lower() if at in topics else "z"
        if note.up is not None:
            numbers[:, at : at + 4] = turned_rotations(numbers[:, at : at + 4], note.up, up)
