"""Writes OpenSim marker files, .trc."""

from __future__ import annotations

from pathlib import Path

from ...destination import fresh_file
from ...export_job import Job
from ..placement import NOTE_KEY, to_text
from ..table_text import TableText
from ..take_options import TrcWriteOptions
from ..take_points import find
from . import layout


def export(job: Job, options: TrcWriteOptions) -> Path:
    """Write markers, and the positions of bodies, into one .trc file; what is missing is `nan`.

    Args:
        job: What to export; its destination is the file.
        options: How to write it.
    """
    points = find(job, options, options.length_units)
    clock, names = points.take.clock, points.names
    hz, count = f"{clock.stated_rate:.6f}".rstrip("0").rstrip("."), clock.count
    values = [hz, hz, str(count), str(len(names)), options.length_units, hz, "1", str(count)]
    axes = [f"{axis}{number + 1}" for number in range(len(names)) for axis in "XYZ"]
    lines = [
        [layout.FIRST_WORD, "4", "(X/Y/Z)", " ".join(job.dest.name.split()), NOTE_KEY, to_text(points.note)],
        [*layout.KEYS],
        values,
        [*layout.COLUMNS, *(cell for name in names for cell in (name, "", ""))],
        ["", "", *axes],
        [],
    ]
    decimals = options.decimals
    text = TableText(
        separator="\t", missing="nan", end="\n", decimals=decimals, time_decimals=clock.time_decimals(decimals)
    )
    with fresh_file(job.dest) as path, path.open("wb") as file:
        file.write("".join("\t".join(line) + "\n" for line in lines).encode())
        for window in points.take.windows():
            heads = text.heads(window.frames + 1, window.times)
            file.write(text.rows(heads, points.of(window.values), points.shifts))
    return job.dest
