"""Writes exports with a file for each topic: a folder of them, or one file if the destination is named like one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

from ..errors import UsageError
from ..inspect.topics import TopicInfo
from ..query.topic_part import TopicPart
from .destination import fresh_file, fresh_folder, names_of, refuse_existing
from .export_job import Job, RowCounter

Put: TypeAlias = Callable[[TopicPart, TopicInfo, Path, RowCounter], None]
"""Writes one topic to a path, and adds its rows to the counter."""


def write(job: Job, suffix: str, put: Put) -> Path:
    """Write the topics of a job, and return its destination.

    Args:
        job: What to export.
        suffix: Of the files, such as ".parquet".
        put: Writes one topic.

    Raises:
        DestinationExistsError: Something is at the destination; nothing was read.
        UsageError: The destination is named like one file, but there are several topics.
    """
    refuse_existing(job.dest)
    if job.dest.suffix.lower() != suffix:
        with fresh_folder(job.dest) as folder:
            _each(job, {topic: folder / name for topic, name in names_of(job.topics, suffix).items()}, put)
        return job.dest
    if len(job.topics) != 1:
        raise UsageError(
            f"{str(job.dest)!r} names one file, but there are {len(job.topics)} topics; name one of them, or a folder"
        )
    with fresh_file(job.dest) as path:
        _each(job, dict.fromkeys(job.topics, path), put)
    return job.dest


def _each(job: Job, paths: dict[str, Path], put: Put) -> None:
    counter = job.counter()
    for topic, path in paths.items():
        put(job.part(topic), job.topics[topic], path, counter)
    counter.finish()
