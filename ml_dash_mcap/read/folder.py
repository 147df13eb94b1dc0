"""Which files a recording is made of."""

from __future__ import annotations

import errno
import os
from itertools import islice
from pathlib import Path

from ..errors import MissingRecordingError
from ..layout import ACTIVE_SUFFIX, DEFAULT_ROOTS
from ..run_folders import is_segment, runs_below

_SEARCH_DEPTH = 4
_NAMED = 5


def segments(path: Path) -> list[Path]:
    """Return the files of a recording in the order of writing, the finished ones and those in progress.

    Args:
        path: A run's folder, or one file.

    Raises:
        MissingRecordingError: There is nothing at that path, or it is a folder whose recordings lie further down.
    """
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise MissingRecordingError(errno.ENOENT, f"no recording here{_hint(path)}", str(path))
    found: dict[str, Path] = {}
    for name in sorted(os.listdir(path)):  # "x.mcap" comes before "x.mcap.active" and wins
        stem = name.removesuffix(ACTIVE_SUFFIX)
        if is_segment(name):
            found.setdefault(stem, path / name)
    if not found:
        _refuse_parent(path)
    return [found[stem] for stem in sorted(found)]


def _hint(path: Path) -> str:
    """Return where the recording of that prefix is, if somebody gave a prefix for a path."""
    places = [Path(root) / path for root in DEFAULT_ROOTS if not path.is_absolute() and (Path(root) / path).is_dir()]
    return f"; did you mean {str(places[0])!r}?" if places else ""


def _refuse_parent(path: Path) -> None:
    """Raise if recordings lie further down: whoever opened this folder meant one of those."""
    below = _recordings_below(path)
    if below:
        named = ", ".join(below[:_NAMED]) + (", ..." if len(below) > _NAMED else "")
        raise MissingRecordingError(errno.ENOENT, f"no recording here, but in the folders below it: {named}", str(path))


def _recordings_below(path: Path) -> list[str]:
    below = (folder for folder in runs_below(path, depth=_SEARCH_DEPTH) if folder != path)
    return [folder.relative_to(path).as_posix() for folder in islice(below, _NAMED + 1)]
