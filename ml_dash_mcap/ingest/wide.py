"""Wide CSV tables, as `layout="wide"` writes them: `frame,time,q.0,q.1,...`."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..mocap.placement import Placement
from ..recorder import Recorder
from . import Progress
from .cells import Cells
from .headers import Header, check_on_bad, csv_cells, first_line, refuse_semicolons
from .tracks import Report, Tracks

_START = re.compile("frame[,;\t]time([,;\t]|$)", re.IGNORECASE)
_INDEXED = re.compile(r"(.+?)((?:\.\d+)+)")


def detect(path: Path) -> str | None:
    """Return "wide" for a table whose first columns are frame and time."""
    return "wide" if _START.match(first_line(path).strip()) else None


def record(
    src: Path, recorder: Recorder, *, progress: Progress | None = None, on_bad: str = "raise", topic: str | None = None
) -> None:
    """Append a wide table: `q.0`, `q.1`, ... become the vector `q`, and `robot:q.0` one of the topic `robot`.

    Args:
        src: The file; its times are the time stamps.
        recorder: Where its rows go.
        progress: Called now and then with the rows done and the rows in all.
        on_bad: What to do with cells that are no numbers: "raise", or "missing" to leave them out and warn.
        topic: The topic of columns that do not say theirs; the file's name by default.

    Raises:
        ForeignFileError: A cell is no number; says the line and the column.
    """
    check_on_bad(on_bad)
    report = Report(src, progress)
    with src.open("rb") as file:
        header = Header(src, file)
        names = _names(src, header)
        tracks = Tracks(recorder, _placements(names, topic or src.stem), {}, skip_empty=True)
        cells = Cells(src, len(names) + 2, on_bad=on_bad)
        line = 2
        for values, at in cells.read(file, line):
            line += tracks.append_from(cells, values[:, 1], values[:, 2:], line)
            report.add(len(values), at)
    report.finish(cells.bad)


def _names(path: Path, header: Header) -> list[str]:
    text = header.next("the row of column names")
    if "," not in text:
        refuse_semicolons(path)
    return csv_cells(path, text, 1)[2:]


def _placements(names: Sequence[str], topic: str) -> list[Placement]:
    split = [name.partition(":") if ":" in name else (topic, ":", name) for name in names]
    fields: dict[tuple[str, str], list[tuple[tuple[int, ...], int]]] = {}
    for at, (of, _, name) in enumerate(split):
        found = _INDEXED.fullmatch(name)
        label, index = (found[1], tuple(map(int, found[2][1:].split(".")))) if found else (name, ())
        fields.setdefault((of, label), []).append((index, at))
    placements: list[Placement] = []
    for (of, label), entries in fields.items():
        indices = [index for index, _ in entries]
        shape = tuple(max(axis) + 1 for axis in zip(*indices, strict=False))
        if math.prod(shape) == len(indices) and indices == list(np.ndindex(*shape)):
            placements.append(Placement(of, tuple(label.split(".")), shape, tuple(at for _, at in entries)))
        else:  # numbers that are names
            placements += [Placement(of, (split[at][2],), (), (at,)) for _, at in entries]
    return placements
