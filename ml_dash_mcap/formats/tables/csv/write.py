"""Writes topics as CSV files: a line for each row, a column for each number."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

from ....inspect.topics import TopicInfo
from ....query.topic_part import TopicPart
from ....rows.table import Block
from ... import per_topic
from ...export_job import Job, RowCounter
from ...registry import NoOptions
from .. import write_passes
from . import cells
from .layout import CsvLayout

SUFFIX = ".csv"


def export(job: Job, options: NoOptions) -> Path:
    """Write one CSV file a topic, in UTF-8, `_ts` first, then the fields.

    Nested fields have dotted names; vectors are a column an element, `q.0`, `q.1`, and matrices `m.0.0`, `m.0.1`.
    `csv_cells` says what the values look like.

    Args:
        job: What to export.
        options: None.
    """
    return per_topic.write(job, SUFFIX, _write)


def stream(part: TopicPart, info: TopicInfo, out: BinaryIO) -> None:
    """Write one topic to an open file, which may be a pipe: the rows are read twice, for the header first."""
    layout = CsvLayout(info, part.columns)
    for block in part.blocks():
        layout.add(block)
    out.write(layout.header())
    for block in part.blocks():
        out.write(cells.lines(layout.cells(block)))


def _write(part: TopicPart, info: TopicInfo, path: Path, counter: RowCounter) -> None:
    layout = CsvLayout(info, part.columns)

    @contextlib.contextmanager
    def begin() -> Iterator[Callable[[Block], None]]:
        with path.open("wb") as file:
            file.write(layout.header())
            yield lambda block: _put(file, layout, block)

    write_passes.write(part.blocks, layout, begin, counter.add)


def _put(file: BinaryIO, layout: CsvLayout, block: Block) -> None:
    file.write(cells.lines(layout.cells(block)))
