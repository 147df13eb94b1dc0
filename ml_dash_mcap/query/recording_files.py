"""Tells which files of a folder make a recording, and explains why a folder holds none."""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Iterable, Sequence
from itertools import islice
from pathlib import Path
from typing import NoReturn

from ..errors import FormatError, MissingRecordingError, StorageError
from ..file_names import ACTIVE_SUFFIX, DEFAULT_ROOTS
from ..store.run_folders import is_segment, is_session, runs_below, runs_in
from ..store.store import Store

_NUMBER = re.compile(r"([0-9]+)")

_SEARCH_DEPTH = 4
_MOST_FOLDERS = 5000
"""So many folders are searched for runs that the error message names; that takes some tenths of a second."""
_NAMED = 5
"""An error message names so many runs or files."""
_NOT_READ_THERE = "bags and tables in a store are not read: copy them to this machine first"


def segments(path: Path, *, is_known: bool = False) -> list[Path]:
    """Return the files of a recording in the order of writing, finished or in progress.

    A run that has just begun has none yet. The session file of its recorder tells its folder from others.

    Args:
        path: A run's folder, or one file.
        is_known: Whether the folder was that of a run before, so that a folder without files is no error.

    Raises:
        MissingRecordingError: There is nothing at that path, or the folder holds no run; the message names runs in the
            folders below it.
        StorageError: The folder cannot be read.
    """
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise MissingRecordingError(errno.ENOENT, f"no recording here{_hint(path)}", str(path))
    names = _names(path)
    ordered = in_writing_order(names)
    if not ordered and not is_known and not any(map(is_session, names)):
        advice = "a recording is a folder with .mcap files in it, one .mcap file, or a bag or table of others"
        _refuse(str(path), names, _recordings_below(path), "it is empty", advice)
    return [path / name for name in ordered]


def in_writing_order(names: Iterable[str]) -> list[str]:
    """Return the names of segments among the names of a folder's files, in the order of writing."""
    by_stem: dict[str, str] = {}
    for name in sorted(filter(is_segment, names)):  # "x.mcap" comes before "x.mcap.active" and wins
        by_stem.setdefault(name.removesuffix(ACTIVE_SUFFIX), name)
    return [by_stem[stem] for stem in sorted(by_stem, key=natural_order)]


def refuse_in_store(store: Store, prefix: str, names: Iterable[str]) -> NoReturn:
    """Raise MissingRecordingError, because a folder of a store holds no run. The message names runs below it."""
    runs = (folder.removeprefix(f"{prefix}/") for folder, _ in runs_in(store, prefix))
    what = "in a store, a recording is a folder with .mcap files in it, or one .mcap file"
    present = list(names)
    advice = f"{what}; {_NOT_READ_THERE}" if present else what
    _refuse(f"{store.url}/{prefix}", present, list(islice(runs, _NAMED + 1)), "there is nothing", advice)


def refuse_format_in_store(store: Store, name: str) -> NoReturn:
    """Raise FormatError, because an object is no MCAP file."""
    raise FormatError(f"{store.url}/{name} is no MCAP file, and {_NOT_READ_THERE}")


def _names(path: Path) -> list[str]:
    """Return the names of the files and folders in a folder.

    Raises:
        StorageError: The folder cannot be read.
    """
    try:
        return os.listdir(path)
    except OSError as error:
        raise StorageError(error.errno, f"cannot be read: {error.strerror}", str(path)) from error


def _hint(path: Path) -> str:
    """Return a hint at the recording of that prefix, for a caller who gave a prefix in the place of a path."""
    places = [Path(root) / path for root in DEFAULT_ROOTS if not path.is_absolute() and (Path(root) / path).is_dir()]
    return f"; did you mean {str(places[0])!r}?" if places else ""


def natural_order(name: str) -> tuple[list[tuple[int, str]], str]:
    """Return a key that sorts `bag_10` behind `bag_9`. Names whose numbers have the same length sort like text."""
    parts = _NUMBER.split(name)
    return [(int(part) if at % 2 else 0, "" if at % 2 else part) for at, part in enumerate(parts)], name


def _refuse(place: str, names: Sequence[str], below: Sequence[str], empty: str, advice: str) -> NoReturn:
    """Raise MissingRecordingError for a folder without a run. The message names runs that the caller may have meant.

    Args:
        place: Of the folder.
        names: Of the files and folders in it.
        below: Runs in the folders below it.
        empty: What the message says where there are no names.
        advice: What a recording is.
    """
    if below:
        raise MissingRecordingError(
            errno.ENOENT, f"no recording here, but in the folders below it: {_listed(below)}", place
        )
    there = f"it has {_listed(sorted(names))}" if names else empty
    raise MissingRecordingError(errno.ENOENT, f"no recording here, and {there}; {advice}", place)


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:_NAMED]) + (", ..." if len(names) > _NAMED else "")


def _recordings_below(path: Path) -> list[str]:
    below = (folder for folder in runs_below(path, depth=_SEARCH_DEPTH, most=_MOST_FOLDERS) if folder != path)
    return [folder.relative_to(path).as_posix() for folder in islice(below, _NAMED + 1)]
