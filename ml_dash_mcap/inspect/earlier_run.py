"""Finds the clock of the latest run in a folder, which the next run must not mix with its own."""

from __future__ import annotations

import datetime
from pathlib import Path

from .. import clock
from ..errors import RecorderError
from ..file_names import OWN_TOPICS, SEGMENT_SUFFIX
from ..query.file import File
from . import run_metadata

_MOST_FILES = 16
"""So many files are opened at most: a file that holds only logs tells nothing."""

_LATE_S = 60.0
"""Rows that end so long before their file was begun, in seconds, are not of the time at which they were recorded."""


def own_clock_until(folder: Path) -> float | None:
    """Return where the times of the latest tracks in a folder end, in s, if the wall clock did not show them then.

    Those of a simulation, or of a recording that was played back, are likely to come again in the next run. Wall-clock
    times do not. Looks at the last files.
    """
    paths = sorted(folder.glob(f"*{SEGMENT_SUFFIX}"), key=lambda path: path.name, reverse=True)
    for path in paths[:_MOST_FILES]:
        try:
            span = _tracks_span(path)
        except (RecorderError, OSError):  # reading the file raises this again
            continue
        if span is not None:
            begun_s, end_s = span
            return end_s if not clock.is_epoch_like(end_s) or end_s < begun_s - _LATE_S else None
    return None


def _tracks_span(path: Path) -> tuple[float, float] | None:
    """Return when a file of ours was begun and where its times end, in s; None without messages on a user's topic."""
    file = File(path)
    try:
        metadata = file.about()
        counts = file.index.message_counts
        users = [id_ for id_, channel in file.index.channels.items() if not channel.topic.startswith(OWN_TOPICS)]
        if "run" not in metadata or not any(counts.get(id_) for id_ in users):
            return None
        ends = [clock.to_seconds(end_ns) for _, end_ns in run_metadata.spans([file])]
        return (_begun_s(metadata.get("start", "")), max(ends)) if ends else None
    finally:
        file.close()


def _begun_s(text: str) -> float:
    """Return a time of ISO 8601 in s; 0 where it is none."""
    try:
        return datetime.datetime.fromisoformat(text).timestamp()
    except ValueError:
        return 0.0
