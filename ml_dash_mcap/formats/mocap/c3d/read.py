"""Reads C3D files: markers, model outputs, rotations of bodies, analog channels."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from ....errors import ConversionWarning, ForeignFileError
from ....meaning import rotations
from ....meaning.space import unit_of
from ....meaning.units import DECIMALS
from ....recorder import Recorder
from ...registry import Progress
from ...text.headers import unit_of_length
from ...text.number_cells import Floats
from .. import placement, restored
from ..placement import Note
from ..take_options import C3dReadOptions
from ..track_rows import Arrays
from . import c3d_fields, file_parameters, frame_data, layout
from .c3d_fields import C3dFields
from .file_parameters import Head
from .frame_data import Data, Frames

_ROWS = 4096


def record(src: Path, recorder: Recorder, options: C3dReadOptions, progress: Progress | None) -> None:
    """Append a C3D file, in metres: one topic with `markers` by name; `set:name` is a marker of the topic `set`.

    Points that the file names as angles, forces, moments, powers or scalars are fields of the topic `model_outputs`, in
    the unit of the file. Rotations are topics with `pos` and `quat`. Analog channels are fields of the topic `analog`,
    at their own rate, in their own units. A file that this library wrote becomes the topics and fields that it was
    written from, to float32.

    Args:
        src: The file.
        recorder: Where its rows go.
        options: How to read it.
        progress: Called now and then with the rows done and the rows in all.

    Raises:
        ForeignFileError: The file is damaged, or its unit is not known.
    """
    if not src.stat().st_size:
        raise ForeignFileError(src, "it is no whole C3D file: it is empty")
    # Mapped instead of read: only the frames of the current part need memory.
    raw = memoryview(cast(Any, np.memmap(src, np.uint8, "r")))
    head = file_parameters.read(src, raw)
    data, is_cut = frame_data.lay_out(src, head, raw, is_lenient=options.on_bad == "missing")
    if is_cut:
        warnings.warn(
            f"{src}: it ends after {data.count} whole frames; those are read", ConversionWarning, stacklevel=2
        )
    matrices, ratio = frame_data.rotations(src, head, raw, data.count)
    width = 3 * head.points + 4 * matrices.shape[1] + data.channels
    note = _note(head, width) if data.samples <= 1 and ratio == 1 else None
    unit = _unit(src, head, options.length_units)
    take = _Take(src, recorder, head, data, raw, matrices, ratio, unit, options.start)
    if note is not None:
        take.restore(note, progress)
    else:
        take.append(c3d_fields.lay_out(head, data, matrices.shape[1], unit, options.topic), progress)


@dataclass(frozen=True, slots=True)
class _Take:
    """One file on its way into a recorder."""

    path: Path
    recorder: Recorder
    head: Head
    data: Data
    raw: memoryview
    matrices: Floats
    """Of the bodies, [N * ratio, B, 4, 4]."""
    ratio: int
    unit: str
    start: float | None

    def append(self, fields: C3dFields, progress: Progress | None) -> None:
        """Append a file of another tool."""
        origin = self.start or 0.0
        count = self.data.count
        points = fields.points and Arrays(self.path, self.recorder, fields.points, fields.metadata)
        analog = fields.channels and Arrays(self.path, self.recorder, fields.channels, fields.metadata)
        hz = self._rate(layout.POINT) if count and (fields.points or fields.bodies) else 0.0
        analog_hz = self._analog_rate(hz) if fields.channels else 0.0
        for first, frames in self._frames():
            stop = first + len(frames.points)
            if points:
                numbers = frames.points.reshape(stop - first, -1).copy()
                numbers[:, fields.lengths] /= 10.0 ** DECIMALS[self.unit]
                points.append(origin + np.arange(first, stop) / hz, numbers)
            if analog:
                samples = np.arange(first * self.data.samples, stop * self.data.samples)
                values = frames.analogs * 10.0 ** np.array(fields.channel_shifts, np.float64)
                analog.append(origin + samples / analog_hz, values)
            if progress is not None:
                progress(stop, count)
        if fields.bodies:
            self._append_bodies(fields, origin, hz)

    def _append_bodies(self, fields: C3dFields, origin: float, hz: float) -> None:
        bodies = Arrays(self.path, self.recorder, fields.bodies, fields.metadata)
        rate = self.head.first_number(layout.ROTATION, layout.RATE) or hz * self.ratio
        places = self.matrices[:, :, :3, 3] / 10.0 ** DECIMALS[fields.rotation_unit]
        numbers = np.concatenate((_turns(self.matrices), places.reshape(len(places), -1)), axis=1)
        for first in range(0, len(numbers), _ROWS):
            part = numbers[first : first + _ROWS]
            bodies.append(origin + np.arange(first, first + len(part)) / rate, part)

    def restore(self, note: Note, progress: Progress | None) -> None:
        """Append a file of this library: the topics and fields that it was written from."""
        origin = note.origin if self.start is None else self.start
        hz, bodies = self._rate(layout.POINT), self.matrices.shape[1]
        more = {"time_source": f"frame numbers at {hz!r} Hz"}
        metadata = restored.metadata(note, more)
        arrays = Arrays(self.path, self.recorder, note.placements, metadata, skip_empty=True)
        for first, frames in self._frames():
            stop = first + len(frames.points)
            turns = _turns(self.matrices[first:stop]) if bodies else np.empty((stop - first, 0))
            channels = frames.analogs.reshape(stop - first, -1)
            numbers = np.concatenate((frames.points.reshape(stop - first, -1), turns, channels), axis=1)
            _turn_back(numbers, note, self.head.points, bodies, self.unit)
            arrays.append(origin + np.arange(first, stop) / hz, numbers)
            if progress is not None:
                progress(stop, self.data.count)

    def _frames(self) -> Iterator[tuple[int, Frames]]:
        return frame_data.parts(self.data, self.raw, _ROWS)

    def _rate(self, group: str) -> float:
        """Return a rate in Hz; that of points stands in the header too."""
        stated = self.head.first_number(group, layout.RATE)
        rate = stated if stated and stated > 0 else self.head.rate if group == layout.POINT else 0.0
        if not 0 < rate < 1e9:
            raise ForeignFileError(self.path, f"{group}:RATE is {stated}, which is no rate in Hz")
        # The rate is float32 in the file. The text of our own note counts only while it rounds to the same float32.
        exact = _exact_rate(self.head) if group == layout.POINT else None
        return exact if exact is not None and np.float32(exact) == np.float32(rate) else rate

    def _analog_rate(self, hz: float) -> float:
        """Return the rate of analog channels: a whole number of samples a frame, unless there is no frame's rate."""
        stated = self.head.first_number(layout.ANALOG, layout.RATE)
        frames = hz or self.head.first_number(layout.POINT, layout.RATE) or self.head.rate
        from_frames = frames * self.data.samples
        if stated and stated > 0 and (self.data.samples > 1 or not from_frames > 0):
            return stated
        return from_frames if from_frames > 0 else self._rate(layout.ANALOG)


def _unit(path: Path, head: Head, asked: str | None) -> str:
    stated = next(iter(head.text(layout.POINT, layout.UNITS)), "")
    if stated or asked is not None:
        return unit_of_length(path, stated, asked, "POINT:UNITS")
    if head.points:
        warnings.warn(
            f"{path}: it does not say the unit of its points, so they are taken for millimetres; pass length_units=",
            ConversionWarning,
            stacklevel=3,
        )
    return "mm"


def _exact_rate(head: Head) -> float | None:
    """Return the rate that this library wrote as text, for the file has it as float32."""
    try:
        return float(head.text(layout.NOTES, layout.RATE)[0])
    except (IndexError, ValueError):
        return None


def _note(head: Head, columns: int) -> Note | None:
    return placement.from_text("".join(head.text(layout.NOTES, layout.NOTE)), columns)


def _turns(matrices: Floats) -> Floats:
    """Return the quaternions of the bodies, [N, 4 B], of their matrices, [N, B, 4, 4]."""
    count, bodies = matrices.shape[:2]
    turns, bad = rotations.of_matrices(matrices[:, :, :3, :3].reshape(-1, 3, 3))
    turns[bad] = np.nan
    return turns.reshape(count, 4 * bodies)


def _turn_back(numbers: Floats, note: Note, points: int, bodies: int, unit: str) -> None:
    """Give numbers the units and axes that they had when they were recorded, in place."""
    fields = {at: placement for placement in note.placements for at in placement.columns}
    places = [(at, at + 1, at + 2) for at in range(0, 3 * points, 3)]
    turns = [(at, at + 1, at + 2, at + 3) for at in range(3 * points, 3 * points + 4 * bodies, 4)]
    for place in places:
        field = fields.get(place[0])
        own = unit_of(note.metadata.get(field.topic, {}), ".".join(field.path)) if field else "m"
        numbers[:, place] *= 10.0 ** (DECIMALS[own] - DECIMALS[unit])
    restored.turn_back(numbers, note, places, turns)
