"""The places of a recording's files: paths of this machine, or names in a store."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path, PurePath, PurePosixPath
from typing import Protocol, cast

from ..errors import MissingObjectError
from ..file_names import ACTIVE_SUFFIX
from ..mcap.records import MAGIC
from ..store.byte_source import ByteSource
from ..store.local_file import LocalFile, identity
from ..store.object_source import ObjectSource
from ..store.run_folders import is_segment
from ..store.safe_paths import folder_name
from ..store.store import Store, StoredObject
from . import recording_files

_MOST_OPENINGS = 16
"""So many objects are opened at once."""


class Places(Protocol):
    """The folders and files of a recording. Files may appear, grow and be renamed while they are read."""

    @property
    def is_one_file(self) -> bool:
        """Whether it is a single file, so that nothing is left if that file cannot be read."""

    def present(self, *, is_known: bool) -> list[Path]:
        """Return the files that are there now, in the order of writing, each once.

        Args:
            is_known: Whether a recording was there before, so that it is no error if there are no files now.

        Raises:
            MissingRecordingError: There is no recording.
        """

    def prepare(self, paths: Sequence[Path]) -> None:
        """Take note that some files will be opened next, so that what opening needs can be fetched at once."""

    def open(self, path: Path) -> ByteSource:
        """Open a file that is there. The caller closes the source."""

    def is_same(self, source: ByteSource, path: Path) -> bool:
        """Whether a path leads to the file that is open as `source`, which may have been renamed since."""


class LocalPlaces:
    """Folders and files of this machine."""

    def __init__(self, paths: Sequence[Path]) -> None:
        self._paths = list(paths)

    @property
    def is_one_file(self) -> bool:
        """Whether it is a single file."""
        return len(self._paths) == 1 and not self._paths[0].is_dir()

    def present(self, *, is_known: bool) -> list[Path]:
        """Return the files that are there now; see `Places.present`. Of several paths of one file, one is returned."""
        files = list(dict.fromkeys(file for path in self._paths for file in self._present_at(path, is_known)))
        if len(self._paths) == 1:
            return files
        # Backwards, because a dict keeps the last value of a key and the first path of a file is wanted.
        return list({identity(path) or path: path for path in reversed(files)}.values())[::-1]

    def _present_at(self, path: Path, is_known: bool) -> list[Path]:
        finished = finished_path(path)
        if finished != path and not path.exists() and finished.exists():
            return [finished]  # a file in progress was opened, and has been finished since
        return recording_files.segments(path, is_known=is_known)

    def prepare(self, paths: Sequence[Path]) -> None:
        """Do nothing: opening a file of this machine waits for nothing."""

    def open(self, path: Path) -> ByteSource:
        """Open a file. A file in progress stays open, because it will be renamed."""
        return LocalFile(path, stays_open=path.name.endswith(ACTIVE_SUFFIX))

    def is_same(self, source: ByteSource, path: Path) -> bool:
        """Whether a path leads to the file that is open."""
        return isinstance(source, LocalFile) and source.is_at(path)


class StoredPlaces:
    """Folders and objects of a store. They are only read: the leftovers of dead recorders are not recovered there."""

    is_one_file = False

    def __init__(self, store: Store, names: Sequence[str]) -> None:
        """Take the names, and list nothing yet.

        Args:
            store: Where the objects lie.
            names: Names of folders and objects, as `names_of` checked them.
        """
        self._store = store
        self._names = list(names)
        self._stored: dict[Path, StoredObject] = {}
        """The objects as they were listed last, by their labels."""
        self._prepared: dict[Path, ObjectSource] = {}

    def present(self, *, is_known: bool) -> list[Path]:
        """Return the objects that are there now; see `Places.present`."""
        listed = (stored for name in self._names for stored in self._present_at(name, is_known))
        self._stored = {label(stored.name): stored for stored in listed}
        return list(self._stored)

    def _present_at(self, name: str, is_known: bool) -> list[StoredObject]:
        listed = {PurePosixPath(stored.name).name: stored for stored in self._store.list(name, recursive=False)}
        names = recording_files.in_writing_order(listed)
        if names:
            return [listed[name] for name in names]
        try:
            stored = self._store.head(name) if name else None
        except MissingObjectError:
            stored = None
        self.is_one_file = stored is not None and len(self._names) == 1
        if stored is None and not is_known:
            recording_files.refuse_in_store(self._store, name, listed)
        if stored is not None and not is_segment(stored.name) and not self._is_mcap(stored):
            recording_files.refuse_format_in_store(self._store, name)
        return [] if stored is None else [stored]

    def _is_mcap(self, stored: StoredObject) -> bool:
        return self._store.read_ranges(stored, [(0, len(MAGIC))])[0] == MAGIC

    def prepare(self, paths: Sequence[Path]) -> None:
        """Fetch the beginnings and ends of several objects side by side: each waits for the network."""
        sources = {path: ObjectSource(self._store, self._stored[path]) for path in paths}
        if len(sources) > 1:
            with ThreadPoolExecutor(_MOST_OPENINGS, "ml_dash_mcap opening") as threads:
                list(threads.map(ObjectSource.prime, sources.values()))
        self._prepared = sources

    def open(self, path: Path) -> ByteSource:
        """Open the version of an object that was listed."""
        return self._prepared.pop(path)

    def is_same(self, source: ByteSource, path: Path) -> bool:
        """Whether the object is still the version that is open."""
        return isinstance(source, ObjectSource) and source.is_version(self._stored[path])


def names_of(given: Iterable[str | os.PathLike[str]]) -> list[str]:
    """Return the names of folders or objects in a store, checked. A relative path is one; Path() is the whole store.

    Raises:
        PrefixError: No store takes such a name.
        UsageError: It is neither text nor a path.
    """
    return [folder_name(_posix(name) if isinstance(name, os.PathLike) else name) for name in given]


def _posix(path: os.PathLike[str]) -> str:
    pure = PurePath(path)
    return pure.as_posix() if pure.parts else ""


def label(name: str) -> Path:
    """Return an object's name as a path, because files of recordings are named by paths.

    It is a pure path: code that looks for it on this machine's disk by mistake gets an error, and no other file.
    """
    return cast(Path, PurePosixPath(name))


def finished_path(path: Path) -> Path:
    """Return the path that a segment has, or will have, when it is finished."""
    return path.with_name(path.name.removesuffix(ACTIVE_SUFFIX)) if path.name.endswith(ACTIVE_SUFFIX) else path
