"""Writes a wide CSV table: a column for every number of some topics."""

from __future__ import annotations

import csv
import io
from pathlib import Path

from ....errors import ConversionError
from ...destination import fresh_file, refuse_existing
from ...export_job import Job
from .. import take_clock as rates
from ..table_text import TableText, numbers
from ..take import OutgoingTake
from ..take_contents import every_number
from ..take_options import MocapWriteOptions
from . import layout


def write(job: Job, options: MocapWriteOptions) -> Path:
    """Write `frame,time,q.0,...`; several topics have their name before each column, `robot:q.0`.

    The time is `_ts` itself. Without a rate, each time stamp of any of the topics is a row. Fields that are no numbers
    are not in it.

    Raises:
        ConversionError: The topics have no numbers, or a field changes its size.
    """
    refuse_existing(job.dest)
    columns = [column for topic in job.topics for column in every_number(job, topic)]
    topics = dict.fromkeys(column.topic for column in columns)
    if not columns:
        names = ", ".join(map(repr, job.topics)) or "none"
        raise ConversionError(f"there are no numbers in the topics ({names}); export them with format='csv' or 'jsonl'")
    clock = rates.find(job, topics, options.rate, needs_even=False)
    take = OutgoingTake(job, options, list(columns), clock)
    header = io.StringIO()
    labels = [
        f"{column.topic}{layout.TOPIC_END}{column.name}" if len(topics) > 1 else column.name for column in columns
    ]
    csv.writer(header, lineterminator="\n").writerow([*layout.COLUMNS, *labels])
    text = TableText(end="\n", decimals=options.decimals)
    with fresh_file(job.dest) as path, path.open("wb") as file:
        file.write(header.getvalue().encode())
        for window in take.windows():
            times = numbers(window.times + clock.origin)  # exact: see frames.exact_origin
            heads = [b"%d,%b" % pair for pair in zip(window.frames.tolist(), times, strict=True)]
            file.write(text.rows(heads, window.values))
    return job.dest
