"""Opens ROS bags of both generations as recordings."""

from __future__ import annotations

import warnings
from collections.abc import Collection
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from ...codecs.decoding import decoding
from ...codecs.ros import distros
from ...errors import ConversionWarning, DamagedFileError, StorageError
from ...file_names import SEGMENT_SUFFIX
from ...mcap.limits import DEFAULT, Limits
from ...mcap.message import Connection
from ...options import RecorderOptions
from ...recorder import Recorder
from .. import file_signs
from ..file_start import FileStart
from ..registry import Progress
from . import bag_folder
from .bag_contents import Bag, BagFile, batches
from .bag_folder import FolderBag
from .bag_mcap import read as bag_mcap
from .bag_metadata.information import BagInformation
from .bag_options import RosbagReadOptions
from .bag_types import Types
from .carry_in import Carrier
from .messages import lossless_definitions
from .rows_in import Intake, Origins


def read_as_it_is(path: Path) -> list[Path] | None:
    """Return the files of a bag, in the order of recording, if they can be read like any MCAP file.

    None for what has to be unpacked or copied first, and for bags that this library exported: their topics come back as
    the rows that they were.
    """
    folder = bag_folder.Folder(path)
    files = folder.files
    if not files or any(file.suffix != SEGMENT_SUFFIX for file in files) or folder.information.compression_mode:
        return None
    for file in files:
        try:
            bag = bag_mcap.McapBag(file, salvages=True)
        except DamagedFileError:  # reading the file reports the damage, or leaves the file out
            continue
        try:
            if any(lossless_definitions.MARK in channel.text for channel in bag.channels.values()):
                return None
            inside = BagInformation.lenient(bag.about.get(distros.TEXT_KEY, ""))
            is_packed = inside.compression_mode and not bag.is_carried
            if is_packed or (not folder.information and bag_folder.starts_as_zstd(bag)):
                return None
            # One file with messages is enough: all files of a bag were written by the same recorder.
            if bag.count:
                break
        finally:
            bag.close()
    folder.warn_of_unnamed()
    return files


def carry(src: Path, folder: Path, prefix: str, options: RosbagReadOptions, progress: Progress | None) -> None:
    """Make a recording of a bag.

    Its messages stay what they are: their bytes, times, types and definitions, in ROS's own encoding. Topics that we
    exported come back as the rows that they were.

    Args:
        src: A ROS 1 bag, a rosbag2 folder, or one file of such a folder.
        folder: Of the recording; it is there.
        prefix: Of the recording.
        options: How to read it.
        progress: Called now and then with the messages done and the messages in all.

    Raises:
        DamagedFileError: The bag is damaged.
        MissingRecordingError: A file of it is missing.
        EncodingError: A type is not known, or broken; the message names it.
        NotFoundError: There is no such topic.
        StorageError: A file cannot be read.
        OptionError: An option has a value that it cannot have.
    """
    wanted = None if options.topics is None else list(options.topics)
    how = decoding(options.definitions, options.on_unknown)
    salvages = options.on_damage == "skip"
    try:
        bag = _open(src, salvages, options.limits or DEFAULT)
        try:
            types = Types(how, distros.likely(bag.distro, bag.version))
            _Conversion(src, bag, folder, prefix, types, options, progress).run(wanted)
        finally:
            bag.close()
    except OSError as error:
        if isinstance(error, StorageError):
            raise
        raise StorageError(error.errno, f"cannot be read: {error.strerror}", str(error.filename or src)) from error


class _Conversion:
    """One bag on its way into a folder: some channels as they are, some as rows."""

    def __init__(
        self,
        src: Path,
        bag: Bag,
        folder: Path,
        prefix: str,
        types: Types,
        options: RosbagReadOptions,
        progress: Progress | None,
    ) -> None:
        self._src = src
        self._bag = bag
        self._folder = folder
        self._prefix = prefix
        self._types = types
        self._options = options
        self._makes_all_rows = options.encoding not in (None, "ros") or options.time == "header"
        self._progress = progress
        self._done = 0

    def run(self, wanted: Collection[str] | None) -> None:
        """Copy or translate the messages of some topics."""
        origins = Origins(self._bag)
        carried, rows = self._divided(origins, wanted)
        makes_rows = bool(rows) or self._makes_all_rows
        keeps_all_files = bool(carried) or not makes_rows
        folder, prefix = self._folder, self._prefix
        carrier = Carrier(self._src, self._bag, folder, prefix, self._types, carried, keeps_all_files=keeps_all_files)
        with ExitStack() as stack:
            intake = None
            if makes_rows:
                recorder = stack.enter_context(Recorder(folder, self._recorder_options(), prefix=prefix))
                ordered = [channel for channel in self._bag.channels if channel in rows]
                uses_header, salvages = self._options.time == "header", self._options.on_damage == "skip"
                intake = Intake(self._src, recorder, origins, self._types, ordered, uses_header, salvages)
            for file in self._bag.files():
                for count in carrier.copy(file):
                    self._add(count)
                if intake is not None and rows:
                    for batch in batches(file, intake.wanted):
                        intake.add(batch)
                        self._add(len(batch.times_ns))
                _warn_of_losses(file, intake)
        if self._progress is not None and self._done < self._bag.count:  # some were not wanted
            self._progress(self._bag.count, self._bag.count)

    def _divided(
        self, origins: Origins, wanted: Collection[str] | None
    ) -> tuple[Collection[Connection], Collection[Connection]]:
        """Return the channels whose messages stay as they are, and those whose messages become rows."""
        keeps_all = self._options.encoding == "ros" and wanted is None
        chosen = set(self._bag.channels) if keeps_all else origins.chosen(self._bag.channels, wanted)
        if self._types.decoding.on_unknown == "skip":
            chosen -= self._left_out(chosen)
        if self._makes_all_rows:
            return set(), chosen
        rows = set() if self._options.encoding == "ros" else chosen & origins.own.keys()
        return chosen - rows, rows

    def _recorder_options(self) -> RecorderOptions:
        options, encoding = RecorderOptions.from_environment(), self._options.encoding
        return options if encoding in (None, "ros") else replace(options, encoding=encoding)

    def _add(self, count: int) -> None:
        self._done += count
        if self._progress is not None:
            self._progress(self._done, self._bag.count)

    def _left_out(self, channels: Collection[Connection]) -> set[Connection]:
        unknown = {channel for channel in channels if self._types.is_unknown(channel)}
        for channel in sorted(unknown, key=lambda channel: channel.topic):
            what = f"topic {channel.topic!r} of type {channel.type!r}: nobody knows what its messages are made of"
            warnings.warn(f"{what}; it is left out", ConversionWarning, stacklevel=7)
        return unknown


def _warn_of_losses(file: BagFile, intake: Intake | None) -> None:
    """Warn of what was left out of a file, and of what it states wrongly about itself."""
    for loss in [*file.losses, *(intake.losses if intake is not None else ())]:
        warnings.warn(f"{loss}; it is left out", ConversionWarning, stacklevel=6)
    if intake is not None:
        intake.losses.clear()
    for correction in file.corrections:
        warnings.warn(f"{correction}; nothing is lost by it", ConversionWarning, stacklevel=6)


def _open(path: Path, salvages: bool, limits: Limits) -> Bag:
    if path.is_file() and file_signs.rosbag1(FileStart(path)):
        from .bag_ros1.read import Ros1Bag

        return Ros1Bag(path, salvages=salvages)
    return FolderBag(path, salvages=salvages, limits=limits)
