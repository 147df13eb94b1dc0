"""The files of a recording, opened, while some of them may still be growing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from ..codecs import decoding as decodings
from ..codecs.decoding import Decoding
from ..errors import DamagedFileError, MissingRecordingError
from ..file_names import ACTIVE_SUFFIX
from ..mcap.limits import DEFAULT, Limits
from ..mcap.losses import Loss, Losses
from ..store.file_source import identity
from . import recording_files
from .file import File


class Segments:
    """Runs' folders and files. Any thread may read their files; one at a time refreshes.

    Attributes:
        files: In the order of writing, those that were chosen.
        all: All that are there.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        limits: Limits = DEFAULT,
        *,
        salvages: bool = False,
        decoding: Decoding = decodings.DEFAULT,
    ) -> None:
        """Open what is there.

        Args:
            paths: Of folders and files; no file is opened twice.
            limits: For what is read of a file.
            salvages: Whether to leave out what is damaged, and note it, rather than to raise; also a file that is no
                MCAP file, unless it is the only one that was asked for.
            decoding: How messages become rows.

        Raises:
            MissingRecordingError: Nothing is.
            DamagedFileError: A file is no MCAP file, or a finished one is broken.
        """
        self._paths = list(paths)
        self._limits = limits
        self._salvages = salvages
        self._decoding = decoding
        self._refused = Losses()
        self._is_chosen: Callable[[File], bool] = lambda file: True
        self.all: list[File] = []
        self.files: list[File] = []
        self._is_opened = False
        try:
            self.refresh()
            self._is_opened = True
        except BaseException:
            self.close()
            raise

    @property
    def losses(self) -> list[Loss]:
        """What was found damaged so far, and left out."""
        return [*self._refused.all(), *(loss for file in self.files for loss in file.losses)]

    def choose(self, is_chosen: Callable[[File], bool]) -> None:
        """Leave only some of the files in `files`, now and after each refresh."""
        self._is_chosen = is_chosen
        self.files = [file for file in self.all if is_chosen(file)]

    def refresh(self) -> bool:
        """Open files that are new, and go on with those that have grown or were renamed.

        Returns:
            Whether anything changed.
        """
        known = {_stem(file.path): file for file in self.all}
        files: list[File] = []
        changed = False
        self._refused.clear()
        for path in self._present():
            file = known.get(_stem(path))
            if file is not None and file.is_at(path):
                changed |= file.refresh(path)
                del known[_stem(path)]
            else:
                file = self._open(path)
                changed |= file is not None
            if file is not None:
                files.append(file)
        for gone in known.values():
            gone.close()
        self.all = files
        self.files = [file for file in files if self._is_chosen(file)]
        return changed or bool(known)

    def close(self) -> None:
        """Close the files. May be called twice."""
        for file in self.all:
            file.close()

    def _present(self) -> list[Path]:
        found = list(dict.fromkeys(file for path in self._paths for file in self._present_at(path)))
        if len(self._paths) == 1:
            return found
        return list({identity(path) or path: path for path in reversed(found)}.values())[::-1]

    def _present_at(self, path: Path) -> list[Path]:
        finished = _stem(path)
        if finished != path and not path.exists() and finished.exists():
            return [finished]  # the one file that was opened has been finished since
        return recording_files.segments(path, is_known=self._is_opened)

    def _open(self, path: Path) -> File | None:
        try:
            return self._open_there(path)
        except DamagedFileError as error:
            is_all = len(self._paths) == 1 and not self._paths[0].is_dir()
            if is_all or not self._salvages:
                raise
            self._refused.add(path, Loss(path, error.offset, error.what, None))
            return None

    def _open_there(self, path: Path) -> File:
        try:
            return File(path, self._limits, salvages=self._salvages, decoding_=self._decoding)
        except MissingRecordingError:
            if _stem(path) == path:
                raise
            # finished between listing and opening
            return File(_stem(path), self._limits, salvages=self._salvages, decoding_=self._decoding)


def _stem(path: Path) -> Path:
    """Return the name that a segment has, or will have, when it is finished."""
    return path.with_name(path.name.removesuffix(ACTIVE_SUFFIX)) if path.name.endswith(ACTIVE_SUFFIX) else path
