"""The recordings below a folder, each at a glance."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from .errors import MissingRecordingError, RecorderError
from .file_names import SESSION_GLOB
from .inspect.runs import status_of
from .recording import Recording
from .store.run_folders import holds_run, runs_below
from .store.safe_paths import place
from .store.session_lock import SessionLock

_BAG_FILE = "metadata.yaml"
"""Says that a folder is a rosbag2."""


@dataclass(frozen=True, slots=True)
class CatalogEntry:
    """A recording at a glance."""

    path: Path
    """Its folder."""
    status: str
    """How the run ended: "completed", "failed" or "cancelled"; "died" if nobody said. "recording" while it is recorded.
    Where no run was: "finished", or "unfinished" if a file lacks its end. "damaged" if something cannot be read."""
    start: float | None = None
    """Time of the first message, in s; None without messages."""
    end: float | None = None
    """Time of the last message, in s; None without messages."""
    topics: int = 0
    """How many, without the library's own ones."""
    files: int = 0
    """How many MCAP files it is made of."""
    bytes: int = 0
    """Size of these on disk."""
    problem: str | None = None
    """What is damaged, in words."""

    @property
    def duration(self) -> float:
        """From the first message to the last, in s."""
        return 0.0 if self.start is None or self.end is None else self.end - self.start


def recordings(root: str | Path) -> Iterator[CatalogEntry]:
    """Yield the recordings in a folder and in the folders below it, sorted by path.

    Hidden folders are left out, but for `.dash` and `.dreamlake`, where runs are recorded by default. A folder with
    MCAP files in it is a recording. Opening one folds in what a crashed recorder left there.

    Args:
        root: The folder.

    Raises:
        MissingRecordingError: There is no such folder; also a FileNotFoundError.

    Example:
        >>> for entry in recordings(".dash"):
        ...     print(entry.path, entry.status, entry.duration)
    """
    folder = place(root, "root")
    if not folder.is_dir():
        raise MissingRecordingError(errno.ENOENT, "no folder here", str(root))
    return (_look_at(one) for one in runs_below(folder))


def is_recording(path: str | Path) -> bool:
    """Whether a path is a file, or a folder with MCAP files in it."""
    path = Path(path)
    return path.is_file() or (path.is_dir() and holds_run(os.listdir(path)))


def is_one_recording(path: str | Path) -> bool:
    """Whether a path is a file, a ROS bag, or a folder with MCAP files in it and in none of the folders below."""
    folder = place(path, "path")
    if folder.is_file() or (folder / _BAG_FILE).is_file():
        return True
    return is_recording(folder) and list(islice(runs_below(folder), 2)) == [folder]


def _look_at(folder: Path) -> CatalogEntry:
    try:
        with Recording(folder, on_damage="skip") as recording:
            size = sum(path.stat().st_size for path in recording.segments)
            problem = next((f"{loss.path.name}: {loss.what}" for loss in recording.losses if not loss.corrected), None)
            return CatalogEntry(
                folder,
                "damaged" if problem else run_status(recording),
                recording.start,
                recording.end,
                len(recording.topics),
                len(recording.segments),
                size,
                problem,
            )
    except (RecorderError, OSError) as error:
        if isinstance(error, MissingRecordingError):  # before its first rows
            return CatalogEntry(folder, "recording" if _is_recorded(folder) else "died")
        return CatalogEntry(folder, "damaged", problem=str(error))


def run_status(recording: Recording) -> str:
    """Return how a recording's run stands, or where there was none, its files: see `CatalogEntry.status`."""
    folder = recording.path if recording.path.is_dir() else recording.path.parent
    return status_of(recording.run.get("status"), is_recorded=_is_recorded(folder), is_finished=recording.finished)


def _is_recorded(folder: Path) -> bool:
    """Whether a recorder lives that records there."""
    return any(SessionLock.is_held(path) for path in folder.glob(SESSION_GLOB))
