"""Writes Vicon CSV files: Trajectories as Nexus lays them out, Objects as Tracker does."""

from __future__ import annotations

from pathlib import Path

from ....meaning.mocap_objects import Body
from ....meaning.units import DECIMALS
from ...destination import fresh_file
from ...export_job import Job
from ..placement import NOTE_KEY, Note, Placing, to_text
from ..table_text import TableText
from ..take_options import ViconWriteOptions
from ..take_points import Points, find
from . import layout


def export(job: Job, options: ViconWriteOptions) -> Path:
    """Write markers (section Trajectories) and bodies (section Objects, with quaternions) into one CSV file, in mm.

    The format has no times: a sample's time is that of its frame, at the rate that the file says.

    Args:
        job: What to export; its destination is the file.
        options: How to write it.
    """
    points = find(job, options, layout.UNIT, with_rotations=True)
    bodies = [(thing, at) for thing, at in points.take.columns() if isinstance(thing, Body)]
    text = TableText(decimals=options.decimals)
    hz = repr(points.take.clock.stated_rate).removesuffix(".0")
    with fresh_file(job.dest) as path, path.open("wb") as file:
        if points.things:
            names = ["", "", *(cell for name in points.names for cell in (name.replace(",", " "), "", ""))]
            units = ["", "", *[layout.UNIT] * len(points.columns)]
            axes = [*layout.COLUMNS, *layout.POINT_AXES * len(points.things)]
            file.write(_head(layout.TRAJECTORIES, hz, names, axes, units))
            for window in points.take.windows():
                heads = [b"%d,0" % frame for frame in (window.frames + 1).tolist()]
                file.write(text.rows(heads, points.of(window.values), points.shifts))
        if bodies:
            file.write(b"\r\n" if points.things else b"")
            names = ["", "", *(cell for body, _ in bodies for cell in (body.name.replace(",", " "), *[""] * 6))]
            units = ["", "", *[*[""] * 4, *[layout.UNIT] * 3] * len(bodies)]
            file.write(_head(layout.OBJECTS, hz, names, [*layout.COLUMNS, *layout.BODY_AXES * len(bodies)], units))
            columns = [at + number for _, at in bodies for number in range(7)]
            shifts: list[int] = []
            for body, _ in bodies:
                shifts += [0] * 4 + [DECIMALS[layout.UNIT] - DECIMALS[points.take.unit_of(body)]] * 3
            for window in points.take.windows():
                heads = [b"%d,0" % frame for frame in (window.frames + 1).tolist()]
                file.write(text.rows(heads, window.values[:, columns], shifts))
        file.write(f"\r\n{NOTE_KEY}\r\n{to_text(_note(points, bodies))}\r\n".encode())
    return job.dest


def _head(section: str, hz: str, *rows: list[str]) -> bytes:
    lines = [section, hz, *(",".join(row) for row in rows)]
    return "".join(f"{line}\r\n" for line in lines).encode()


def _note(points: Points, bodies: list[tuple[Body, int]]) -> Note:
    """Return the note; columns are counted through all sections, without those of frames."""
    placing = Placing()
    at = 0
    for thing in points.things:
        placing.add(thing, {"position": range(at, at + 3)})
        at += 3
    for body, _ in bodies:
        placing.add(body, {"rotation": range(at, at + 4), "position": range(at + 4, at + 7)})
        at += 7
    return points.take.note(placing)
