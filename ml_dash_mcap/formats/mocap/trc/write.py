"""OpenSim marker files, .trc.

The layout is that of opensim-org's documentation, "Marker (.trc) Files"; what it says of the recording stands behind
the file's name in its first line, where readers do not look.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from ...destination import fresh_file
from ...export_job import Job
from ..placement import NOTE_KEY, to_text
from ..table_text import TableText
from ..take_clock import Rate
from ..take_options import TakeOptions, check, check_decimals
from ..take_points import find

UNITS = ("m", "mm")


def export(
    job: Job,
    *,
    rate: Rate = None,
    length_units: Literal["m", "mm"] = "m",
    up: Literal["z", "y"] | None = None,
    decimals: int | None = None,
    on_bad: Literal["raise", "missing"] = "raise",
) -> Path:
    """Write markers, and the positions of bodies, into one .trc file; what is missing is `nan`.

    Args:
        job: What to export; its destination is the file.
        rate: Frames a second, or "median", to resample to; None for the rows as they are, evenly spaced.
        length_units: Of the file.
        up: Which axis points up; OpenSim's models have "y". None turns nothing.
        decimals: How many each number has; None for as many as it needs to come back the same.
        on_bad: Whether a rotation that is none is an error, or missing.
    """
    check("length_units", length_units, UNITS)
    check_decimals(decimals)
    points = find(job, TakeOptions(rate, up, on_bad=on_bad), length_units)
    clock, names = points.take.clock, points.names
    hz, count = f"{clock.rate:.6f}".rstrip("0").rstrip("."), clock.count
    keys = ["DataRate", "CameraRate", "NumFrames", "NumMarkers"]
    keys += ["Units", "OrigDataRate", "OrigDataStartFrame", "OrigNumFrames"]
    values = [hz, hz, str(count), str(len(names)), length_units, hz, "1", str(count)]
    axes = [f"{axis}{number + 1}" for number in range(len(names)) for axis in "XYZ"]
    lines = [
        ["PathFileType", "4", "(X/Y/Z)", " ".join(job.dest.name.split()), NOTE_KEY, to_text(points.note)],
        keys,
        values,
        ["Frame#", "Time", *(cell for name in names for cell in (name, "", ""))],
        ["", "", *axes],
        [],
    ]
    text = TableText(
        separator="\t", missing="nan", end="\n", decimals=decimals, time_decimals=clock.time_decimals(decimals)
    )
    with fresh_file(job.dest) as path, path.open("wb") as file:
        file.write("".join("\t".join(line) + "\n" for line in lines).encode())
        for window in points.take.windows():
            heads = text.heads(window.frames + 1, window.times)
            file.write(text.rows(heads, points.of(window.values), points.shifts))
    return job.dest
