"""Tells from the names of files which folders hold a run."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from fnmatch import fnmatch
from itertools import islice
from pathlib import Path

from ..file_names import ACTIVE_SUFFIX, DEFAULT_ROOTS, SEGMENT_SUFFIX, SESSION_GLOB
from .store import Store, StoredObject


def is_segment(name: str) -> bool:
    """Whether a file's name is that of an MCAP file, finished or in progress. Hidden files are not counted."""
    return name.removesuffix(ACTIVE_SUFFIX).endswith(SEGMENT_SUFFIX) and not name.startswith(".")


def holds_run(names: Iterable[str]) -> bool:
    """Whether a folder with these files holds a run: an MCAP file, or the session file of a recorder."""
    return any(is_segment(name) or is_session(name) for name in names)


def is_session(name: str) -> bool:
    """Whether a file's name is that of a session file, which a recorder keeps while it records."""
    return fnmatch(name, SESSION_GLOB)


def runs_below(root: Path, *, depth: int | None = None, most: int | None = None) -> Iterator[Path]:
    """Yield a folder and those below it that hold a run, sorted by path.

    Hidden folders are left out, except those that `Experiment` and `Session` record to by default.

    Args:
        root: Where to begin, hidden or not.
        depth: How many folders down to look; None for all.
        most: How many folders to look at; None for all.
    """
    for folder, names, files in islice(os.walk(root), most):
        level = len(Path(folder).relative_to(root).parts)
        # In place: os.walk goes down into the folders that are left in its list.
        names[:] = sorted(filter(_is_searched, names)) if depth is None or level < depth else []
        if holds_run(files):
            yield Path(folder)


def runs_in(store: Store, root: str) -> Iterator[tuple[str, list[StoredObject]]]:
    """Yield the folders of a store that hold a run, sorted by name, each with the objects that lie in it.

    Hidden folders are left out as `runs_below` leaves them out.

    Args:
        store: Where to look.
        root: The name of the folder where to begin, hidden or not; "" is the whole store.
    """
    by_folder: dict[str, list[StoredObject]] = {}
    for stored in store.list(root):
        by_folder.setdefault(stored.name.rpartition("/")[0], []).append(stored)
    # By the parts of the path, as `runs_below` sorts: as text, "a-b" would come before "a/b".
    for folder in sorted(by_folder, key=lambda folder: folder.split("/")):
        inside = by_folder[folder]
        below = folder.removeprefix(root).strip("/")
        is_searched = not below or all(map(_is_searched, below.split("/")))
        if is_searched and holds_run(stored.name.rpartition("/")[2] for stored in inside):
            yield folder, inside


def _is_searched(name: str) -> bool:
    return not name.startswith(".") or name in DEFAULT_ROOTS
