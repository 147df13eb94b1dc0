"""The files of a recording, opened, while some of them may still be growing."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..errors import MissingRecordingError
from ..layout import ACTIVE_SUFFIX
from . import folder
from .file import File


class Segments:
    """Runs' folders and files. Any thread may read their files; one at a time refreshes.

    Attributes:
        files: In the order of writing.
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        """Open what is there.

        Args:
            paths: Of folders and files; no file is opened twice.

        Raises:
            MissingRecordingError: Nothing is.
            DamagedFileError: A file is no MCAP file, or a finished one is broken.
        """
        self._paths = list(paths)
        self.files: list[File] = []
        try:
            self.refresh()
        except BaseException:
            self.close()
            raise

    def refresh(self) -> bool:
        """Open files that are new, and go on with those that have grown or were renamed.

        Returns:
            Whether anything changed.
        """
        known = {_stem(file.path): file for file in self.files}
        files: list[File] = []
        changed = False
        for path in self._present():
            file = known.get(_stem(path))
            if file is not None and file.is_at(path):
                changed |= file.refresh(path)
                del known[_stem(path)]
            else:
                file = _open(path)
                changed = True
            files.append(file)
        for gone in known.values():
            gone.close()
        self.files = files
        return changed or bool(known)

    def close(self) -> None:
        """Close the files. May be called twice."""
        for file in self.files:
            file.close()

    def _present(self) -> list[Path]:
        return list(dict.fromkeys(file for path in self._paths for file in _present_at(path)))


def _present_at(path: Path) -> list[Path]:
    finished = _stem(path)
    if finished != path and not path.exists() and finished.exists():
        return [finished]  # the one file that was opened has been finished since
    return folder.segments(path)


def _open(path: Path) -> File:
    try:
        return File(path)
    except MissingRecordingError:
        if _stem(path) == path:
            raise
        return File(_stem(path))  # it was finished between listing and opening


def _stem(path: Path) -> Path:
    """Return the name that a segment has, or will have, when it is finished."""
    return path.with_name(path.name.removesuffix(ACTIVE_SUFFIX))
