"""A rosbag2 folder: which files it has, how they are compressed, and what its `metadata.yaml` says."""

from __future__ import annotations

import errno
import shutil
import tempfile
from collections.abc import Collection, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import zstandard

from ..errors import DamagedFileError, MissingRecordingError
from .bag_mcap import McapBag
from .bag_messages import Bag, Batch, Channel
from .bag_sqlite import SqliteBag

METADATA = "metadata.yaml"
INFORMATION = "rosbag2_bagfile_information"
_ZSTD = ".zstd"
_SUFFIXES = (".mcap", ".db3")


class Folder:
    """A folder, or one of its files without the others."""

    def __init__(self, path: Path) -> None:
        """Look at a folder.

        Raises:
            MissingRecordingError: A file is not there.
            DamagedFileError: Its `metadata.yaml` cannot be read.
        """
        self.path = path
        self.information = _information(path / METADATA) if path.is_dir() else {}

    @cached_property
    def files(self) -> list[Path]:
        """The files, in the order of recording: those that the metadata names, or else those that are there."""
        if not self.path.is_dir():
            return [self.path]
        named = [str(name) for name in self.information.get("relative_file_paths") or ()]
        if not named:
            there = [path for path in self.path.iterdir() if path.name.removesuffix(_ZSTD).endswith(_SUFFIXES)]
            return sorted(there, key=lambda path: _natural(path.name))
        files = [self.path / name for name in named]
        for file in files:
            inside = file.resolve().is_relative_to(self.path.resolve())
            if not inside or not file.is_file():
                what = "is named in metadata.yaml and missing" if inside else "lies outside the bag's folder"
                raise MissingRecordingError(errno.ENOENT, f"a file of the bag {what}", str(file))
        return files

    @property
    def custom(self) -> Mapping[str, str]:
        """What somebody wrote about the bag, by key."""
        found = self.information.get("custom_data")
        return found if isinstance(found, dict) else {}

    @property
    def is_compressed(self) -> bool:
        """Whether its files or messages are."""
        by_file = any(file.name.endswith(_ZSTD) for file in self.files)
        return by_file or bool(self.information.get("compression_mode"))


class FolderBag:
    """The files of a folder, opened one after the other."""

    def __init__(self, path: Path, *, salvages: bool = False) -> None:
        """Open the files once, to see what they have.

        Args:
            path: Of the folder, or of one of its files.
            salvages: Whether to leave out what is damaged in MCAP files, and note it in `losses`.

        Raises:
            MissingRecordingError: A file is not there.
            DamagedFileError: A file is damaged.
        """
        self._folder = Folder(path)
        self._salvages = salvages
        self.losses: list[str] = []
        self._unpacked: tempfile.TemporaryDirectory[str] | None = None
        self.custom = self._folder.custom
        self._channels: dict[Channel, None] = {}
        self.count = 0
        try:
            for bag in self._opened():
                self._channels.update(dict.fromkeys(bag.channels))
                self.count += bag.count
                if not self.custom and isinstance(bag, McapBag):
                    self.custom = _custom(bag.serialized_metadata)
        except BaseException:
            self.close()
            raise

    @property
    def channels(self) -> list[Channel]:
        """All channels."""
        return list(self._channels)

    def batches(self, wanted: Collection[Channel]) -> Iterator[Batch]:
        """Yield the messages of some channels, each channel's by time within each file."""
        for bag in self._opened():
            yield from bag.batches(wanted)
            self.losses += bag.losses

    def close(self) -> None:
        """Remove what was unpacked. May be called twice."""
        if self._unpacked is not None:
            self._unpacked.cleanup()
            self._unpacked = None

    def _opened(self) -> Iterator[Bag]:
        mode = str(self._folder.information.get("compression_mode") or "").lower()
        unpack = zstandard.ZstdDecompressor().decompress if mode == "message" else None
        for file in self._folder.files:
            name = file.name.removesuffix(_ZSTD)
            whole = self._decompressed(file) if file.name.endswith(_ZSTD) else file
            bag: Bag = McapBag(whole, salvages=self._salvages) if name.endswith(".mcap") else SqliteBag(whole, unpack)
            try:
                yield bag
            finally:
                bag.close()
            if whole != file:
                whole.unlink()

    def _decompressed(self, file: Path) -> Path:
        """Return a file's content in a temporary place, which has to hold one at a time."""
        if self._unpacked is None:
            self._unpacked = tempfile.TemporaryDirectory(prefix="ml_dash_mcap-")
        target = Path(self._unpacked.name) / file.name.removesuffix(_ZSTD)
        try:
            with file.open("rb") as packed, target.open("wb") as whole:
                shutil.copyfileobj(zstandard.ZstdDecompressor().stream_reader(packed), whole, 1 << 20)
        except zstandard.ZstdError as error:
            raise DamagedFileError(file, 0, f"it cannot be decompressed: {error}") from error
        return target


def _information(path: Path) -> dict[str, Any]:
    if not path.exists():
        return {}
    try:
        said = _parse(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise DamagedFileError(path, 0, f"it is no metadata of a bag: {error}") from error
    found = said.get(INFORMATION)
    return found if isinstance(found, dict) else {}


def _custom(text: str) -> Mapping[str, str]:
    try:
        said = _parse(text) if text else {}
    except ValueError:
        return {}
    found = said.get(INFORMATION, said)
    custom = found.get("custom_data") if isinstance(found, dict) else None
    return custom if isinstance(custom, dict) else {}


def _parse(text: str) -> dict[str, Any]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        said = YAML(typ="safe", pure=True).load(text)
    except YAMLError as error:
        raise ValueError(str(error).splitlines()[0]) from error
    if not isinstance(said, dict):
        raise ValueError("there is no mapping in it")
    return said


def _natural(name: str) -> tuple[int, str]:
    """Sort `bag_10` behind `bag_9`."""
    digits = "".join(letter for letter in name.removesuffix(_ZSTD).rpartition("_")[2] if letter.isdigit())
    return (int(digits) if digits else 0, name)
