"""Opens a recording: recovers what a dead recorder left and converts other formats before files open."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from .codecs.decoding import Decoding
from .errors import MissingRecordingError
from .file_names import SESSION_FILE, SESSION_GLOB
from .formats import registry
from .mcap.limits import Limits
from .query.open_files import Segments
from .query.places import LocalPlaces, Places, StoredPlaces, label, names_of
from .store.local import LocalFolder
from .store.safe_paths import place
from .store.session_lock import SessionLock
from .store.store import Store, check_store


@dataclass(frozen=True, slots=True)
class OpeningOptions:
    """How a recording is opened."""

    recover: bool
    """Whether to make whole first what a dead recorder left, which writes into its folder."""
    salvages: bool
    """Whether to leave out what is damaged rather than to raise."""
    limits: Limits
    decoding: Decoding
    foreign: Mapping[str, Any]
    """Options of other formats; each format takes those that it has."""


@dataclass(frozen=True, slots=True)
class Opened:
    """The open files of a recording."""

    paths: list[Path]
    """The paths that the caller gave; in a store, pure paths."""
    segments: Segments
    store: Store | None
    """Where the files lie; None on this machine."""
    converted: list[TemporaryDirectory[str]] = field(default_factory=list)
    """Temporary folders with recordings that were converted from other formats."""

    def is_recorded(self, run: str) -> bool:
        """Whether the recorder of a run lives."""
        if self.store is not None:
            return False
        folders = {path if path.is_dir() else path.parent for path in self.paths}
        return any(SessionLock.is_held(folder / SESSION_FILE.format(session=run)) for folder in folders)

    def close(self) -> None:
        """Close the files, and remove the temporary folders. May be called twice."""
        self.segments.close()
        _remove(self.converted)


def open_recording(
    given: str | os.PathLike[str] | Iterable[str | os.PathLike[str]], store: Store | None, options: OpeningOptions
) -> Opened:
    """Open the files of a recording.

    Args:
        given: The path of a folder or a file, or several paths; with a store, names in it.
        store: Where they lie; None for this machine.
        options: How to open them.

    Raises:
        MissingRecordingError: There is no recording.
        DamagedFileError: A file is no MCAP file, or a finished one is broken.
        FormatError: A file in the store is of another format.
        UsageError: `store` is no store.
    """
    check_store(store)
    named = list(given) if isinstance(given, Iterable) and not isinstance(given, str) else [given]
    if not named:
        raise MissingRecordingError(errno.ENOENT, "an empty list of files is no recording", "")
    if store is None:
        return _open_local([place(path, "path") for path in named], options)
    names = names_of(named)
    if isinstance(store, LocalFolder):
        return _open_local([store.path_of(name) for name in names], options)
    return Opened([label(name) for name in names], _segments(StoredPlaces(store, names), options), store)


def _open_local(paths: list[Path], options: OpeningOptions) -> Opened:
    converted: list[TemporaryDirectory[str]] = []
    if options.recover:
        for path in paths:
            _recover(path)
    try:
        files = [file for path in paths for file in _as_mcap(path, options, converted)]
        return Opened(paths, _segments(LocalPlaces(files), options), None, converted)
    except BaseException:
        _remove(converted)
        raise


def _segments(places: Places, options: OpeningOptions) -> Segments:
    return Segments(places, options.limits, salvages=options.salvages, decoding=options.decoding)


def _recover(folder: Path) -> None:
    """Write the rows that a dead recorder left in its journal into files of the recording."""
    if folder.is_dir() and next(folder.glob(SESSION_GLOB), None) is not None:
        # Imported only after a crash: it brings the writer along.
        from .recovery import recover_folder

        recover_folder(folder)


def _as_mcap(path: Path, options: OpeningOptions, converted: list[TemporaryDirectory[str]]) -> list[Path]:
    """Return paths of MCAP files: the path itself, or those of a temporary recording if it is in another format."""
    if not registry.may_be_foreign(path):
        return [path]
    from .formats import readers

    files = readers.read_as_it_is(path)
    if files is not None:
        return files
    folder = readers.as_folder(path, salvages=options.salvages, **options.foreign)
    converted.append(folder)
    return [Path(folder.name)]


def _remove(folders: list[TemporaryDirectory[str]]) -> None:
    while folders:
        folders.pop().cleanup()
