"""The open files of a recording, of which some may still be written to."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ..codecs import decoding as decodings
from ..codecs.decoding import Decoding
from ..errors import DamagedFileError, MissingRecordingError
from ..mcap.limits import DEFAULT, Limits
from ..mcap.losses import Loss, Losses
from .file import File
from .places import Places, finished_path


class Segments:
    """The open files of a recording. Any thread may read them; only one thread at a time may refresh or close.

    Attributes:
        files: The chosen files, in the order of writing.
        all: All of them, in the order of writing.
    """

    def __init__(
        self,
        places: Places,
        limits: Limits = DEFAULT,
        *,
        salvages: bool = False,
        decoding: Decoding = decodings.DEFAULT,
    ) -> None:
        """Open the files that are there.

        Args:
            places: Where the files lie.
            limits: How much memory reading a file may take.
            salvages: Whether to leave out damaged parts, and note them, rather than to raise. A file that is no MCAP
                file is left out too, unless it is the only one.
            decoding: How messages become rows.

        Raises:
            MissingRecordingError: There are none.
            DamagedFileError: A file is no MCAP file, or a finished one is broken.
        """
        self._places = places
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
        """The damage that was met so far, and left out."""
        return [*self._refused.all(), *(loss for file in self.files for loss in file.losses)]

    def choose(self, is_chosen: Callable[[File], bool]) -> None:
        """Keep only some of all files in `files`, now and after each refresh."""
        self._is_chosen = is_chosen
        self.files = [file for file in self.all if is_chosen(file)]

    def refresh(self) -> bool:
        """Open new files, read what was written since, follow files that were renamed, and close those that are gone.

        Returns:
            Whether anything changed.
        """
        present = self._places.present(is_known=self._is_opened)
        kept = self._still_there(present)
        new = [path for path in present if path not in kept]
        self._places.prepare(new)
        self._refused.clear()
        has_grown = [file.refresh(path) for path, file in kept.items()]
        opened = {path: file for path in new if (file := self._open(path)) is not None}
        gone = set(self.all) - set(kept.values())
        for file in gone:
            file.close()
        files = kept | opened
        self.all = [files[path] for path in present if path in files]
        self.files = [file for file in self.all if self._is_chosen(file)]
        return any(has_grown) or bool(opened) or bool(gone)

    def _still_there(self, present: list[Path]) -> dict[Path, File]:
        """Return the open files that are still there, by the paths that they have now."""
        by_name = {finished_path(file.path): file for file in self.all}
        pairs = ((path, by_name.get(finished_path(path))) for path in present)
        return {path: file for path, file in pairs if file is not None and self._places.is_same(file.source, path)}

    def close(self) -> None:
        """Close the files. May be called twice."""
        for file in self.all:
            file.close()

    def _open(self, path: Path) -> File | None:
        try:
            return self._open_there(path)
        except DamagedFileError as error:
            if self._places.is_one_file or not self._salvages:
                raise
            self._refused.add(path, Loss(path, error.offset, error.what, None))
            return None

    def _open_there(self, path: Path) -> File:
        try:
            source = self._places.open(path)
        except MissingRecordingError:
            if finished_path(path) == path:
                raise
            path = finished_path(path)  # it was finished between listing and opening
            source = self._places.open(path)
        return File(path, self._limits, source=source, salvages=self._salvages, decoding_=self._decoding)
