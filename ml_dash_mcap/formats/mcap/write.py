"""Writes a recording as a recording: a file for each of its files, with some topics, a time range, another encoding."""

from __future__ import annotations

import shutil
from collections.abc import Collection, Sequence
from pathlib import Path

from ...errors import UsageError
from ...file_names import ACTIVE_SUFFIX, OWN_TOPICS, SEGMENT_SUFFIX
from ...query.file import File
from ...query.recording_files import natural_order
from ..destination import fresh_file, fresh_folder
from ..export_job import Job, RestartableCounter
from .channel_plan import Codecs
from .file_copy import FileCopy, Window
from .mcap_options import McapWriteOptions

_FILES_FOLDER = "files"
"""In a run's folder: the files that were saved with it."""


def export(job: Job, options: McapWriteOptions) -> Path:
    """Write a recording; returns where it is.

    A destination with the suffix `.mcap` is one file, any other a folder. The library's own topics come along, unless
    topics were chosen, and so do all metadata and attachments.

    Raises:
        UsageError: Several files were to become one.
    """
    codecs = Codecs(job.files, options.encoding)
    topics = _topics(job)
    window = Window.of(job.low, job.high)
    counter = job.counter()
    if job.dest.suffix == SEGMENT_SUFFIX:
        if len(job.files) != 1:
            raise UsageError(f"{job.dest} is to be one file, and the recording has {len(job.files)}; name a folder")
        with fresh_file(job.dest) as path:
            FileCopy(job.files[0], path, topics, codecs, window).write(RestartableCounter(counter))
    else:
        with fresh_folder(job.dest) as folder:
            for file, name in zip(job.files, _names(job.files, job.dest.name), strict=True):
                FileCopy(file, folder / name, topics, codecs, window).write(RestartableCounter(counter))
            _copy_saved_files(job, folder)
    counter.finish()
    return job.dest


def _topics(job: Job) -> Collection[str]:
    names = set(job.topics)
    if job.has_all_topics:
        names |= {
            name for file in job.files for name in file.index.glance.channels_by_topic if name.startswith(OWN_TOPICS)
        }
    return names


def _names(files: Sequence[File], prefix: str) -> list[str]:
    """Return the names of the copies: those of the files, or numbers if these would not be read in the same order."""
    names = [file.path.name.removesuffix(ACTIVE_SUFFIX) for file in files]
    if len({*names}) == len(names) and sorted(names, key=natural_order) == names:
        return names
    return [f"{prefix}_{number:06d}{SEGMENT_SUFFIX}" for number in range(1, len(names) + 1)]


def _copy_saved_files(job: Job, folder: Path) -> None:
    """Copy the files that were saved with a run of this machine, if all of it is wanted."""
    if job.is_whole and job.files:
        saved = job.files[0].path.parent / _FILES_FOLDER
        if saved.is_dir():
            shutil.copytree(saved, folder / _FILES_FOLDER)
