"""What the latest run in a folder says to the next one."""

from __future__ import annotations

from pathlib import Path

from .. import clock
from ..errors import RecorderError
from ..layout import OWN_TOPICS, SEGMENT_SUFFIX
from . import about, written
from .file import File

_MOST_FILES = 16
"""So many files are opened at most: one that holds logs only tells nothing."""


def simulated_until(folder: Path) -> float | None:
    """Return where the times of the latest tracks in a folder end, in s, if they are near 0; looks at the last files.

    The times of a simulation are likely to begin there again in the next run. Wall-clock times do not come again.
    """
    paths = sorted(folder.glob(f"*{SEGMENT_SUFFIX}"), key=lambda path: path.name, reverse=True)
    for path in paths[:_MOST_FILES]:
        try:
            end_s = _tracks_end(path)
        except (RecorderError, OSError):  # whoever reads the file is told
            continue
        if end_s is not None:
            return None if clock.is_epoch_like(end_s) else end_s
    return None


def _tracks_end(path: Path) -> float | None:
    """Return when a file of ours ends, in s; None where no topic of a user has messages in it."""
    file = File(path)
    try:
        if written.run_of(file) is None:
            return None
        counts = file.index.message_counts
        if not any(counts.get(id_) for id_, one in file.index.channels.items() if not one.topic.startswith(OWN_TOPICS)):
            return None
        return max((clock.to_seconds(end_ns) for _, end_ns in about.spans([file])), default=None)
    finally:
        file.close()
