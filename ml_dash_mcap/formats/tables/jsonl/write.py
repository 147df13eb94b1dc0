"""Writes topics as files of JSON lines."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

from ....inspect.topics import TopicInfo
from ....query.topic_part import TopicPart
from ....rows.plain_row import TIME_KEY
from ... import per_topic
from ...export_job import Job, RowCounter
from ...registry import NoOptions
from . import text as jsonl

SUFFIX = ".jsonl"

_COUNTED_ROWS = 1000


def export(job: Job, options: NoOptions) -> Path:
    """Write one file a topic, with the lines of `read(format="jsonl")`, each with a newline at its end.

    Args:
        job: What to export.
        options: None.
    """
    return per_topic.write(job, SUFFIX, _write)


def stream(part: TopicPart, info: TopicInfo, out: BinaryIO) -> None:
    """Write one topic's lines to an open file or pipe."""
    for row in part.flat_rows(TIME_KEY):
        out.write(jsonl.line(row) + b"\n")


def _write(part: TopicPart, info: TopicInfo, path: Path, counter: RowCounter) -> None:
    with path.open("wb") as file:
        done = 0
        for row in part.flat_rows(TIME_KEY):
            file.write(jsonl.line(row) + b"\n")
            done += 1
            if done % _COUNTED_ROWS == 0:
                counter.add(_COUNTED_ROWS)
        counter.add(done % _COUNTED_ROWS)
