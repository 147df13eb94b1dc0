"""A rosbag2 folder: its files, their compression, and the contents of its `metadata.yaml`."""

from __future__ import annotations

import errno
import shutil
import tempfile
import warnings
from collections.abc import Callable, Iterator
from functools import cached_property, partial
from pathlib import Path, PurePosixPath

import zstandard

from ...codecs.ros.distros import DISTRO_KEY, METADATA_FILE, TEXT_KEY
from ...errors import ConversionWarning, DamagedFileError, EncodingError, MissingRecordingError
from ...file_names import SEGMENT_SUFFIX
from ...mcap.limits import DEFAULT, Limits
from ...mcap.message import Connection
from .bag_contents import BagFile
from .bag_mcap.read import McapBag
from .bag_metadata.information import NOTHING, BagInformation
from .bag_sqlite.layout import SUFFIX as SQLITE_SUFFIX
from .bag_sqlite.read import SqliteBag

ZSTD = ".zstd"
_SUFFIXES = (SEGMENT_SUFFIX, SQLITE_SUFFIX)
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


class Folder:
    """A folder, or one of its files without the others."""

    def __init__(self, path: Path) -> None:
        """Look at a folder.

        Raises:
            MissingRecordingError: A file is not there.
            DamagedFileError: Its `metadata.yaml` cannot be read.
        """
        self.path = path
        self.information = _information(path / METADATA_FILE) if path.is_dir() else NOTHING

    @cached_property
    def files(self) -> list[Path]:
        """The files, in the order of recording: those that the metadata names, or else those that are there."""
        if not self.path.is_dir():
            return [self.path]
        named = self._names()
        if not named:
            return self._present()
        paths = [self._named(name) for name in named]
        return list({path.resolve(): path for path in reversed(paths)}.values())[::-1]

    @property
    def unnamed(self) -> list[str]:
        """Names of files of a bag that are beside those that the metadata names."""
        if not self.path.is_dir() or not self._names():
            return []
        named = {path.name.removesuffix(ZSTD) for path in self.files}
        return [path.name for path in self._present() if path.name.removesuffix(ZSTD) not in named]

    def warn_of_unnamed(self) -> None:
        """Warn of files that are not read because the metadata does not name them."""
        if self.unnamed:
            what = f"{METADATA_FILE} does not name {', '.join(self.unnamed)}; what is in there is not read"
            warnings.warn(f"{self.path}: {what}", ConversionWarning, stacklevel=6)

    def _present(self) -> list[Path]:
        there = [path for path in self.path.iterdir() if path.name.removesuffix(ZSTD).endswith(_SUFFIXES)]
        return sorted(there, key=lambda path: _natural(path.name))

    def _names(self) -> list[str]:
        """Return the names of the files that the metadata lists.

        Raises:
            DamagedFileError: It is no list of names.
        """
        try:
            return self.information.file_names
        except ValueError as error:
            raise DamagedFileError(self.path / METADATA_FILE, 0, str(error)) from error

    def _named(self, name: str) -> Path:
        """Return a file that the metadata names.

        Up to version 2 the names start with the folder's own one, which may be another today; and some versions of
        rosbag2 say in the metadata of compressed files what they are called without, or with, `.zstd`.
        """
        candidates = [self.path / name]
        if ".." not in PurePosixPath(name).parts:
            candidates.append(self.path / PurePosixPath(name).name)
        for file in candidates:
            other = file.with_name(file.name.removesuffix(ZSTD) if file.name.endswith(ZSTD) else file.name + ZSTD)
            for path in (file, other):
                # The metadata of a bag from outside must not make us read a file outside of its folder.
                if path.is_file() and path.resolve().is_relative_to(self.path.resolve()):
                    return path
        inside = candidates[0].resolve().is_relative_to(self.path.resolve())
        what = "is named in metadata.yaml and missing" if inside else "lies outside the bag's folder"
        raise MissingRecordingError(errno.ENOENT, f"a file of the bag {what}", str(candidates[0]))

    @property
    def text(self) -> str:
        """The whole `metadata.yaml`; empty if there is none."""
        path = self.path / METADATA_FILE
        return path.read_text(encoding="utf-8", errors="replace") if self.information else ""


class FolderBag:
    """The files of a folder, opened one after the other."""

    format = "rosbag2"

    def __init__(self, path: Path, *, salvages: bool = False, limits: Limits = DEFAULT) -> None:
        """Open the files once, to see what they have.

        Args:
            path: Of the folder, or of one of its files.
            salvages: Whether to leave out what is damaged, and note it in the files' `losses`.
            limits: For what is read of its MCAP files.

        Raises:
            MissingRecordingError: A file is not there.
            DamagedFileError: A file is damaged.
            EncodingError: Its messages are compressed by something else than zstd.
        """
        self.folder = Folder(path)
        self._salvages = salvages
        self._limits = limits
        self._unpacked: tempfile.TemporaryDirectory[str] | None = None
        information = self.folder.information
        self.custom = information.custom
        self.distro = information.distro
        self.text = self.folder.text
        """The whole `metadata.yaml`; empty if there is none."""
        self.version = information.version
        self._mode = information.compression_mode
        compression = information.compression_format
        if self._mode == "message" and compression not in ("", "zstd"):
            raise EncodingError(f"{path}: its messages are compressed by {compression!r}; only zstd is known here")
        channels: dict[Connection, None] = {}
        self.count = 0
        self._closed_files: dict[Path, Exception] = {}
        """Files that cannot be opened, which are left out."""
        try:
            for file in self.files():
                channels.update(dict.fromkeys(file.channels.values()))
                self.count += file.count
                self._look(file)
            self._name_closed_files()
            self.folder.warn_of_unnamed()
        except BaseException:
            self.close()
            raise
        self.channels = list(channels)

    def files(self) -> Iterator[BagFile]:
        """Open the files one after the other; each is closed when the next one is asked for."""
        for path in self.folder.files:
            if path in self._closed_files:
                continue
            try:
                file = self._open(path)
            except (DamagedFileError, OSError) as error:
                if not self._salvages:
                    raise
                self._closed_files[path] = error
                continue
            try:
                yield file
            finally:
                file.close()
            self._remove_unpacked(path)

    def _open(self, path: Path) -> BagFile:
        whole = self._decompressed(path) if path.name.endswith(ZSTD) else path
        open_file: Callable[..., BagFile] = SqliteBag
        if whole.name.endswith(SEGMENT_SUFFIX):
            open_file = partial(McapBag, limits=self._limits)
        try:
            return open_file(whole, is_packed=self._mode == "message", salvages=self._salvages, shown=path)
        except DamagedFileError as error:
            self._remove_unpacked(path)
            raise DamagedFileError(path, error.offset, error.what) from error

    def _remove_unpacked(self, path: Path) -> None:
        if self._unpacked is not None:
            (Path(self._unpacked.name) / path.name.removesuffix(ZSTD)).unlink(missing_ok=True)

    def _name_closed_files(self) -> None:
        """Warn of the files that are left out, or raise if there is no other."""
        errors = list(self._closed_files.values())
        if errors and len(errors) == len(self.folder.files):
            raise errors[0]
        for error in errors:
            warnings.warn(f"{error}; the file is left out", ConversionWarning, stacklevel=6)

    def close(self) -> None:
        """Remove what was unpacked. May be called twice."""
        if self._unpacked is not None:
            self._unpacked.cleanup()
            self._unpacked = None

    def _look(self, file: BagFile) -> None:
        """Take from a file the facts about the bag that its folder does not state."""
        if isinstance(file, McapBag):
            distro, text = file.about.get(DISTRO_KEY, ""), file.about.get(TEXT_KEY, "")
        else:
            assert isinstance(file, SqliteBag)
            distro, text = file.distro, file.information
        information = BagInformation.lenient(text)
        self.distro = self.distro or distro or information.distro
        self.version = self.version or information.version
        if not (isinstance(file, McapBag) and file.is_carried):
            self._mode = self._mode or information.compression_mode
        self.custom = self.custom or information.custom
        if not self._mode and not self.folder.information and starts_as_zstd(file):
            self._mode = "message"

    def _decompressed(self, file: Path) -> Path:
        """Unpack a file to a temporary place, which has to hold one file at a time."""
        if self._unpacked is None:
            self._unpacked = tempfile.TemporaryDirectory(prefix="ml_dash_mcap-")
        target = Path(self._unpacked.name) / file.name.removesuffix(ZSTD)
        try:
            with file.open("rb") as packed, target.open("wb") as whole:
                # Unpacked to disk: a file of a bag may be larger than the memory, and SQLite needs a real file.
                shutil.copyfileobj(zstandard.ZstdDecompressor().stream_reader(packed), whole, 1 << 20)
        except zstandard.ZstdError as error:
            raise DamagedFileError(file, 0, f"it cannot be decompressed: {error}") from error
        return target


def starts_as_zstd(file: BagFile) -> bool:
    """Whether messages are compressed one by one, in a folder whose metadata was never written.

    Its first message tells: no CDR message starts as zstd does.
    """
    first = next(file.blocks(file.channels.keys()), None) if file.count else None
    return first is not None and bytes(first.payloads[0][:4]) == _ZSTD_MAGIC


def _information(path: Path) -> BagInformation:
    if not path.exists():
        return NOTHING
    try:
        return BagInformation.parse(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise DamagedFileError(path, 0, f"it is no metadata of a bag: {error}") from error


def _natural(name: str) -> tuple[int, str]:
    """Sort `bag_10` behind `bag_9`."""
    digits = "".join(letter for letter in name.removesuffix(ZSTD).rpartition("_")[2] if letter.isdigit())
    return (int(digits) if digits else 0, name)
