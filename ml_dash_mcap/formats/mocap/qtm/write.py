"""Writes TSV files of Qualisys Track Manager."""

from __future__ import annotations

import datetime
from pathlib import Path

from .... import clock as clocks
from ...destination import fresh_file
from ...export_job import Job
from ..placement import to_text
from ..table_text import TableText
from ..take_options import QtmWriteOptions
from ..take_points import find
from . import layout


def export(job: Job, options: QtmWriteOptions) -> Path:
    """Write markers, and the positions of bodies, into one TSV file, in mm; what is missing is blank.

    Args:
        job: What to export; its destination is the file.
        options: How to write it.
    """
    points = find(job, options, layout.UNIT)
    clock, names = points.take.clock, points.names
    pairs = [
        ("FILE_VERSION", "2.0.0"),
        (layout.FRAMES, str(clock.count)),
        ("NO_OF_CAMERAS", "0"),
        ("NO_OF_MARKERS", str(len(names))),
        (layout.FREQUENCY, f"{clock.stated_rate:.6f}".rstrip("0").rstrip(".")),
        ("NO_OF_ANALOG", "0"),
        ("ANALOG_FREQUENCY", "0"),
        ("DESCRIPTION", "--"),
        *([(layout.START, _stamp(clock.origin))] if clocks.is_epoch_like(clock.origin) else []),
        (layout.INCLUDED, "3D"),
        (layout.NOTE, to_text(points.note)),
        (layout.MARKERS, "\t".join(names)),
    ]
    labels = [*layout.COLUMNS, *(f"{name} {axis}" for name in names for axis in "XYZ")]
    text = TableText(separator="\t", decimals=options.decimals, time_decimals=clock.time_decimals(options.decimals))
    with fresh_file(job.dest) as path, path.open("wb") as file:
        file.write("".join(f"{key}\t{value}\r\n" for key, value in pairs).encode())
        file.write(("\t".join(labels) + "\r\n").encode())
        for window in points.take.windows():
            heads = text.heads(window.frames + 1, window.times)
            file.write(text.rows(heads, points.of(window.values), points.shifts))
    return job.dest


def _stamp(origin_s: float) -> str:
    start = datetime.datetime.fromtimestamp(origin_s, datetime.timezone.utc)
    return f"{start:%Y-%m-%d, %H:%M:%S}.{start.microsecond // 1000:03d}\t0"
