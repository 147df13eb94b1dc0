"""Lists the recordings below a folder, each with its status, its time and its size."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from .errors import MissingRecordingError, RecorderError
from .file_names import SESSION_GLOB
from .inspect.runs import status_of
from .query.places import label, names_of
from .recording import Recording
from .store.local import LocalFolder
from .store.run_folders import holds_run, runs_below, runs_in
from .store.safe_paths import place
from .store.session_lock import SessionLock
from .store.store import Store, check_store

_BAG_FILE = "metadata.yaml"
"""The file that makes a folder a ROS 2 bag."""


@dataclass(frozen=True, slots=True)
class CatalogEntry:
    """A recording at a glance."""

    path: Path
    """Its folder; in a store, its name as a PurePosixPath."""
    status: str
    """How the run ended: "completed", "failed" or "cancelled"; "died" if no end is recorded; "recording" until then.
    Without a run: "finished", or "unfinished" if a file lacks its end. "damaged" if something cannot be read."""
    start: float | None = None
    """Time of the first message, in s; None if there is none."""
    end: float | None = None
    """Time of the last message, in s; None if there is none."""
    topics: int = 0
    """How many topics there are, without those of the library itself."""
    files: int = 0
    """How many MCAP files there are."""
    bytes: int = 0
    """The size of the files."""
    problem: str | None = None
    """A description of the damage; None without damage."""

    @property
    def duration(self) -> float:
        """From the first message to the last, in s."""
        return 0.0 if self.start is None or self.end is None else self.end - self.start


def recordings(root: str | Path, *, store: Store | None = None, recover: bool = True) -> Iterator[CatalogEntry]:
    """Yield the recordings in a folder and in the folders below it, sorted by path.

    Hidden folders are left out, but for `.dash` and `.dreamlake`, where runs are recorded by default. A folder with
    MCAP files in it is a recording.

    Args:
        root: The folder.
        store: Where it lies; `root` is a name in it then, "" for all of it. None for this machine.
        recover: Whether to make whole first what dead recorders left there; see `Recording`.

    Raises:
        MissingRecordingError: There is no such folder; also a FileNotFoundError.
        UsageError: `store` is no store; also a TypeError.

    Example:
        >>> for entry in recordings(".dash"):
        ...     print(entry.path, entry.status, entry.duration)
    """
    check_store(store)
    if store is not None and not isinstance(store, LocalFolder):
        [prefix] = names_of([root])
        return _in_store(store, prefix)
    folder = place(root, "root") if store is None else store.path_of(*names_of([root]))
    if not folder.is_dir():
        raise MissingRecordingError(errno.ENOENT, "no folder here", str(root))
    return (_look_at(below, _size_on_disk, recover=recover) for below in runs_below(folder))


def _in_store(store: Store, prefix: str) -> Iterator[CatalogEntry]:
    """Yield the recordings in a folder of a store."""
    for folder, inside in runs_in(store, prefix):
        sizes = {label(stored.name): stored.size for stored in inside}
        yield _look_at(label(folder), sizes.__getitem__, store=store)


def is_recording(path: str | Path) -> bool:
    """Whether a path is a file, or a folder with MCAP files in it."""
    path = Path(path)
    return path.is_file() or (path.is_dir() and holds_run(os.listdir(path)))


def is_one_recording(path: str | Path) -> bool:
    """Whether a path is a file, a ROS bag, or a folder with MCAP files in it and in none of the folders below."""
    folder = place(path, "path")
    if folder.is_file() or (folder / _BAG_FILE).is_file():
        return True
    # Two are enough to know; below a folder of all runs there may be thousands.
    return is_recording(folder) and list(islice(runs_below(folder), 2)) == [folder]


def _look_at(
    folder: Path, size_of: Callable[[Path], int], *, store: Store | None = None, recover: bool = True
) -> CatalogEntry:
    try:
        with Recording(folder, store=store, recover=recover, on_damage="skip") as recording:
            problem = next((f"{loss.path.name}: {loss.what}" for loss in recording.losses if not loss.corrected), None)
            return CatalogEntry(
                folder,
                "damaged" if problem else run_status(recording),
                recording.start,
                recording.end,
                len(recording.topics),
                len(recording.segments),
                sum(map(size_of, recording.segments)),
                problem,
            )
    except (RecorderError, OSError) as error:
        if isinstance(error, MissingRecordingError):  # it has no file yet, because no row was written
            is_recorded = store is None and _is_recorded(folder)
            return CatalogEntry(folder, "recording" if is_recorded else "died")
        return CatalogEntry(folder, "damaged", problem=str(error))


def _size_on_disk(path: Path) -> int:
    return path.stat().st_size


def run_status(recording: Recording) -> str:
    """Return the status of a recording, as `CatalogEntry.status` has it."""
    is_recorded = recording.store is None and _is_recorded(recording.path)
    return status_of(recording.run.get("status"), is_recorded=is_recorded, is_finished=recording.finished)


def _is_recorded(path: Path) -> bool:
    """Whether a recorder lives that records in a folder, or in that of a file."""
    folder = path if path.is_dir() else path.parent
    return any(SessionLock.is_held(path) for path in folder.glob(SESSION_GLOB))
