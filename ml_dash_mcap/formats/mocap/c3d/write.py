"""Writes C3D files with ezc3d: points, rotations of bodies, joints as analog channels (c3d.org, User Guide)."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from ....errors import ConversionError, ConversionWarning, FormatError
from ....meaning import rotations
from ....meaning.mocap_objects import Body, Joint
from ....meaning.units import DECIMALS
from ...destination import fresh_file, refuse_existing
from ...export_job import Job
from .. import take_clock as rates
from ..placement import Note, Placing, to_text
from ..take import Floats, OutgoingTake, Thing
from ..take_contents import bodies_and_markers
from ..take_options import C3dWriteOptions
from . import layout

_ROUNDING_M = 1e-4
"""Rounding to float32 that moves a point by more draws a warning."""


def export(job: Job, options: C3dWriteOptions) -> Path:
    """Write markers and bodies into one C3D file; its numbers are float32. What is missing has the residual -1.

    The format has no times: a sample's time is that of its frame, at the rate that the file says.

    Args:
        job: What to export; its destination is the file.
        options: How to write it.

    Raises:
        FormatError: The extra `c3d` is not installed.
        ConversionError: There are more than 65,535 frames, or nothing to write.
    """
    refuse_existing(job.dest)
    file = package().c3d()
    points, joints = bodies_and_markers(job, options.quat_order)
    things: list[Thing] = [*points, *(joints if options.joints else ())]
    clock = rates.find(job, [thing.topic for thing in things], options.rate)
    if clock.count > layout.MOST_FRAMES:
        raise ConversionError(
            f"C3D holds at most {layout.MOST_FRAMES} frames, and these are {clock.count}: choose a part by start= and"
            " end=, or a lower rate="
        )
    take = OutgoingTake(job, options, things, clock)
    values = np.concatenate([window.values for window in take.windows()])
    _fill(file, take, values, options.length_units)
    with fresh_file(job.dest) as path:
        named = path.with_name(f"{path.name}.c3d")  # ezc3d would add the suffix itself
        try:
            file.write(str(named))
            named.replace(path)
        finally:
            named.unlink(missing_ok=True)
    return job.dest


def package() -> Any:
    """Return the package ezc3d.

    Raises:
        FormatError: It is not installed.
    """
    try:
        import ezc3d
    except ImportError as error:
        raise FormatError("C3D needs the package ezc3d: pip install 'ml-dash-mcap[c3d]'") from error
    return ezc3d


def _fill(file: Any, take: OutgoingTake, values: Floats, unit: str) -> None:
    points = [(thing, at + 4 * isinstance(thing, Body)) for thing, at in take.columns() if not isinstance(thing, Joint)]
    bodies = [(thing, at) for thing, at in take.columns() if isinstance(thing, Body)]
    joints = [(thing, at) for thing, at in take.columns() if isinstance(thing, Joint)]
    parameters, count, hz = file["parameters"], len(values), take.clock.stated_rate
    places = np.full((4, len(points), count), 1.0)
    for number, (thing, at) in enumerate(points):
        shift = DECIMALS[unit] - DECIMALS[take.unit_of(thing)]
        places[:3, number] = values[:, at : at + 3].T * 10.0**shift
    _warn_of_rounding(places[:3], unit)
    places[:, np.isnan(places).any(axis=0)] = np.nan
    parameters[layout.POINT][layout.RATE]["value"] = [hz]
    parameters[layout.POINT][layout.UNITS]["value"] = [unit]
    parameters[layout.POINT][layout.LABELS]["value"] = [thing.name for thing, _ in points]
    file["data"]["points"] = places
    if joints:
        parameters[layout.ANALOG][layout.RATE]["value"] = [hz]
        parameters[layout.ANALOG][layout.LABELS]["value"] = [joint.name for joint, _ in joints]
        file["data"]["analogs"] = values[:, [at for _, at in joints]].T[None]
    if bodies:
        file.add_parameter(layout.ROTATION, layout.LABELS, [body.name for body, _ in bodies])
        file.add_parameter(layout.ROTATION, layout.RATE, [hz])
        file["data"]["rotations"] = np.stack([_matrices(values[:, at : at + 7]) for _, at in bodies], axis=2)
    placing = Placing()
    for number, (thing, _) in enumerate(points):
        placing.add(thing, {"position": range(3 * number, 3 * number + 3)})
    first = 3 * len(points)
    for number, (body, _) in enumerate(bodies):
        placing.add(body, {"rotation": range(first + 4 * number, first + 4 * number + 4)})
    first += 4 * len(bodies)
    for number, (joint, _) in enumerate(joints):
        placing.add(joint, {"value": [first + number]})
    _add_note(file, take.note(placing), hz)


def _add_note(file: Any, note: Note, rate: float) -> None:
    text = to_text(note)
    file.add_parameter(layout.NOTES, layout.RATE, [repr(rate)])
    # The dimensions of a parameter have 8 bits, so a long text is stored as a list of pieces.
    pieces = [text[at : at + layout.NOTE_PIECE] for at in range(0, len(text), layout.NOTE_PIECE)]
    file.add_parameter(layout.NOTES, layout.NOTE, pieces)


def _matrices(values: Floats) -> Floats:
    """Return the 4x4 matrices of quaternions and positions, [4, 4, N], of x y z w, x y z, [N, 7]."""
    matrices = np.zeros((4, 4, len(values)))
    matrices[:3, :3] = rotations.to_matrices(values[:, :4]).transpose(1, 2, 0)
    matrices[:3, 3] = values[:, 4:].T
    matrices[3, 3] = 1.0
    return matrices


def _warn_of_rounding(places: Floats, unit: str) -> None:
    with np.errstate(over="ignore"):
        error = np.abs(places - places.astype(np.float32))
    worst = float(np.nanmax(error, initial=0.0)) / 10.0 ** DECIMALS[unit]
    if worst > _ROUNDING_M or math.isinf(worst):
        warnings.warn(
            f"C3D holds float32 numbers, which moves points by up to {worst:.2g} m; they are far from the origin",
            ConversionWarning,
            stacklevel=2,
        )
