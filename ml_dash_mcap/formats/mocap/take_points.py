"""Lays out the points of a take for formats that have only points: markers, and the positions of bodies."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from ...meaning.mocap_objects import Body, Marker
from ...meaning.units import DECIMALS
from ..destination import refuse_existing
from ..export_job import Job
from . import take_clock as rates
from .placement import Note, Placing
from .take import Floats, OutgoingTake, Thing
from .take_contents import bodies_and_markers
from .take_options import TakeOptions


@dataclass(frozen=True, slots=True)
class Points:
    """A take's points, in the order of a file's columns."""

    take: OutgoingTake
    things: tuple[Body | Marker, ...]
    columns: tuple[int, ...]
    """The columns of the take with x y z of each point."""
    shifts: tuple[int, ...]
    """By how many places the decimal point of each column moves to the right to have the unit of the file."""
    note: Note

    @property
    def names(self) -> list[str]:
        """The names of the points, without tabs and ends of lines."""
        return [re.sub(r"[\t\r\n]+", " ", thing.name).strip(" ") for thing in self.things]

    def of(self, values: Floats) -> Floats:
        """Return the points among a window's values, [N, 3 M]; one without all of its numbers is missing."""
        points = values[:, self.columns]
        partial = np.isnan(points.reshape(len(points), -1, 3)).any(axis=2)
        if partial.any():
            points[np.repeat(partial, 3, axis=1)] = np.nan
        return points


def find(job: Job, options: TakeOptions, unit: str, *, with_rotations: bool = False) -> Points:
    """Lay out the points of a job's markers and bodies.

    Args:
        job: What to export.
        options: On which clock, and how.
        unit: Of the file.
        with_rotations: Whether the format has bodies of its own: then they are no points, and need not be there.

    Raises:
        DestinationExistsError: Something is at the destination.
        ConversionError: There are no points, or no clock to write them on.
    """
    refuse_existing(job.dest)
    things: list[Thing] = [*bodies_and_markers(job, options.quat_order)[0]]
    clock = rates.find(job, [thing.topic for thing in things], options.rate)
    take = OutgoingTake(job, options, things, clock)
    points: list[Body | Marker] = []
    columns: list[int] = []
    shifts: list[int] = []
    placing = Placing()
    for thing, at in take.columns():
        if not isinstance(thing, (Body, Marker)) or (isinstance(thing, Body) and with_rotations):
            continue
        first = at + 4 if isinstance(thing, Body) else at
        placing.add(thing, {"position": range(len(columns), len(columns) + 3)})
        points.append(thing)
        columns += range(first, first + 3)
        shifts += [DECIMALS[unit] - DECIMALS[take.unit_of(thing)]] * 3
    return Points(take, tuple(points), tuple(columns), tuple(shifts), take.note(placing))
