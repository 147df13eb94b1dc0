"""Reads wide CSV tables, as `layout="wide"` writes them: `frame,time,q.0,q.1,...`."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

from ....errors import ForeignFileError
from ....recorder import Recorder
from ... import vector_names
from ...registry import Progress
from ...text.dialect import of_line
from ...text.headers import HeaderLines, preview, without_empty_end
from ...text.number_cells import Cells
from ...text.plain_text import opened
from .. import row_times
from ..placement import Placement
from ..row_times import Clue, Timing
from ..take_options import WideReadOptions
from ..track_rows import ReadingProgress, TopicRows
from . import layout


def record(src: Path, recorder: Recorder, options: WideReadOptions, progress: Progress | None) -> None:
    """Append a wide table: `q.0`, `q.1`, ... become the vector `q`, and `robot:q.0` one of the topic `robot`.

    Args:
        src: The file; its times are the time stamps.
        recorder: Where its rows go.
        options: How to read it.
        progress: Called now and then with the rows done and the rows in all.

    Raises:
        ForeignFileError: A cell is no number; says the line and the column.
    """
    report = ReadingProgress(src, progress)
    with opened(src) as file:
        header = HeaderLines(src, file)
        text = header.first("the row of column names")
        dialect = of_line(text, default=",")
        names = without_empty_end(dialect.split(text))[len(layout.COLUMNS) :]
        if not names:
            raise ForeignFileError(src, "there are no columns behind those of frame and time", header.line, 3)
        placements = _placements(names, options.topic or src.stem)
        cells = Cells(src, len(names) + len(layout.COLUMNS), dialect, on_bad=options.on_bad)
        cells.learn([*itertools.chain(*preview(file))])
        when, clue = Timing(options.start or 0.0), Clue(1, 0)
        first_s = row_times.first_stamp(clue, cells, file, when)
        when = row_times.not_below_zero(src, when, [first_s], is_asked=options.start is not None)
        topics = dict.fromkeys(placement.topic for placement in placements)
        # With several topics, a row belongs to those that have a number in it. A single topic has every row.
        tracks = TopicRows(src, recorder, placements, dict.fromkeys(topics, when.metadata), skip_empty=len(topics) > 1)
        for part in cells.read(file, header.line + 1):
            times = when.stamps(part.values[:, 0], part.values[:, 1])
            tracks.append_from(cells, times, part.values[:, 2:], part, 2)
            report.add(len(part.values), part.at)
    report.finish(cells.bad)


def _placements(names: Sequence[str], topic: str) -> list[Placement]:
    end = layout.TOPIC_END
    split = [name.partition(end) if end in name else (topic, end, name) for name in names]
    fields: dict[tuple[str, str], list[tuple[vector_names.Index, int]]] = {}
    for at, (of, _, name) in enumerate(split):
        label, index = vector_names.split(name)
        fields.setdefault((of, label), []).append((index, at))
    placements: list[Placement] = []
    for (of, label), entries in fields.items():
        shape = vector_names.whole_shape([index for index, _ in entries])
        if shape is not None:
            placements.append(Placement(of, tuple(label.split(".")), shape, tuple(at for _, at in entries)))
        else:  # numbers that are names
            placements += [Placement(of, (split[at][2],), (), (at,)) for _, at in entries]
    return placements
