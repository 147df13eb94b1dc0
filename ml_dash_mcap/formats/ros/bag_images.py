"""Finds the image files that rows name, for messages that hold the images."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from ...errors import OptionError
from ...query.file import File
from .messages.lossless import MessageField

_FILES = "files"
"""The folder in a run's one that `Experiment.files` saves to."""

_FILE_BYTES = 100_000_000
"""Larger files are no images."""

_PORTION_BYTES = 16_000_000
"""Rows are converted in portions whose images have about so many bytes."""


class Images:
    """Finds images by the paths that rows have."""

    def __init__(self, folders: Sequence[Path]) -> None:
        """Look in folders.

        Args:
            folders: Where a path that is not absolute may begin, the likeliest first.
        """
        self._folders = folders

    def load(self, name: str) -> bytes:
        """Return the bytes of a file.

        Raises:
            ValueError: It is not there, or cannot be read; the message says so.
        """
        try:
            path = self._find(name)
            if path is None:
                places = ", ".join(map(str, self._folders))
                where = "" if Path(name).is_absolute() else f" in {places}; embed_images= takes the folder"
                raise ValueError(f"names {name!r}, and there is no such file{where}")
            if path.stat().st_size > _FILE_BYTES:
                raise ValueError(f"names {str(path)!r}, which has more than {_FILE_BYTES // 1_000_000} MB")
            return path.read_bytes()
        except OSError as error:
            raise ValueError(f"names {name!r}, which cannot be read: {error.strerror}") from error

    def fitting(self, rows: Sequence[dict[str, Any]], ways: Iterable[Sequence[MessageField]]) -> int:
        """Return how many rows can be converted at once so that not too many images are in memory: at least one.

        Args:
            rows: Some.
            ways: To each of the fields with paths, from the row inwards.
        """
        total = 0
        keys = [[field.key for field in way] for way in ways]
        for number, row in enumerate(rows):
            total += sum(self._size(_value(row, way)) for way in keys)
            if total > _PORTION_BYTES and number:
                return number
        return len(rows)

    def _find(self, name: str) -> Path | None:
        if "\0" in name or not name:
            return None
        return next((path for path in (folder / name for folder in self._folders) if path.is_file()), None)

    def _size(self, name: Any) -> int:
        try:
            path = self._find(name) if isinstance(name, str) else None
            return path.stat().st_size if path is not None else 0
        except OSError:
            return 0


def images(embed: bool | str | Path, files: Sequence[File]) -> Images | None:
    """Return where the images of a recording are; None if they are not to be embedded.

    Args:
        embed: True for beside the recording and in its folder of files; or the folder that paths begin at.
        files: Of the recording.

    Raises:
        OptionError: It is neither, or there is no such folder.
    """
    if embed is False:
        return None
    if embed is True:
        local = (file.path for file in files if isinstance(file.path, Path))  # images in a store are not looked for
        beside = list(dict.fromkeys(path.parent for path in local))
        return Images([place for folder in beside for place in (folder, folder / _FILES)])
    if not isinstance(embed, (str, Path)) or not Path(embed).is_dir():
        raise OptionError(f"embed_images={embed!r}: pass True, or the folder that the paths of images begin at")
    return Images([Path(embed)])


def _value(row: Any, keys: Iterable[str]) -> Any:
    for key in keys:
        row = row.get(key) if isinstance(row, dict) else None
    return row
