"""ROS bags of both generations as recordings."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path

from ..errors import ConversionWarning, OptionError, StorageError, UsageError
from ..recorder import Recorder
from ..ros import msg
from . import bag_folder, bag_mcap
from .bag_folder import FolderBag
from .bag_intake import Intake, canonical
from .bag_messages import Bag

Progress = Callable[[int, int], object]

_ROS1_MAGIC = b"#ROSBAG V"
_HEAD = 64


def detect(path: Path) -> str | None:
    """Return "rosbag1" or "rosbag2" if a bag is at a path, else None."""
    if path.is_dir():
        metadata = path / bag_folder.METADATA
        try:
            if metadata.is_file() and bag_folder.INFORMATION in metadata.read_text(encoding="utf-8", errors="replace"):
                return "rosbag2"
        except OSError:
            return None
        return "rosbag2" if any(_is_of_folder(one) for one in path.iterdir()) else None
    head = _head(path)
    if head.startswith(_ROS1_MAGIC) or path.suffix == ".bag":
        return "rosbag1"
    return "rosbag2" if path.suffix == ".db3" or _is_ros2(head) else None


def _is_of_folder(path: Path) -> bool:
    """Whether a file, in a folder without metadata, is one of a bag."""
    if path.name.endswith((".db3", ".db3.zstd")):
        return True
    return path.suffix == ".mcap" and _is_ros2(_head(path))


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(_HEAD)
    except OSError:
        return b""


def _is_ros2(head: bytes) -> bool:
    """Whether a file begins as MCAP with the profile "ros2"."""
    return head.startswith(bag_mcap.MAGIC) and head[17:25] == b"\x04\0\0\0ros2"


def is_read_as_it_is(path: Path) -> bool:
    """Whether a bag's files can be read like any MCAP file, and give the rows that a conversion would give."""
    if path.is_file():
        files = [path]
    else:
        folder = bag_folder.Folder(path)
        if folder.is_compressed:
            return False
        files = folder.files
        if any(file.parent != path for file in files) or set(files) != set(path.glob("*.mcap")):
            return False
    if not files or any(file.suffix != ".mcap" for file in files):
        return False
    bag = bag_mcap.McapBag(files[0], salvages=True)
    try:
        return not any(msg.MARK in channel.text for channel in bag.channels)
    finally:
        bag.close()


def record(
    src: Path,
    recorder: Recorder,
    *,
    progress: Progress | None = None,
    time: str = "log",
    topics: Iterable[str] | None = None,
    definitions: Mapping[str, str | Path] | None = None,
    on_unknown: str = "raise",
    on_damage: str = "raise",
) -> None:
    """Append a bag's messages to a recorder.

    Topics that we exported come back as the rows that they were. Those of others become rows with the message's
    fields: nested messages are dicts, `uint8[]` such as images is bytes; none of them are merged.

    Args:
        src: A ROS 1 bag, a rosbag2 folder, or one file of such a folder.
        recorder: Where to.
        progress: Called now and then with the messages done and the messages in all.
        time: What `_ts` is for messages of others: "log", when they were recorded, or "header", their header's stamp
            where they have one that is not 0.
        topics: Names of the bag's topics, or those that they had in the recording that it was made of; None for all but
            the standard messages that we derived.
        definitions: Type to its definition, or the `.msg` file with it, for bags that do not have them.
        on_unknown: What happens to a topic whose type nobody knows: "raise", or "skip" to leave it out with a warning.
        on_damage: What happens if an MCAP file is cut or damaged: "raise", or "skip" to take what can be read, with a
            warning. Other files are refused.

    Raises:
        DamagedFileError: The bag is damaged.
        MissingRecordingError: A file of it is missing.
        EncodingError: A type is not known, or broken; the message names it.
        NotFoundError: There is no such topic.
        StorageError: A file cannot be read.
        OptionError: An option has a value that it cannot have.
    """
    for name, value, known in (
        ("time", time, ("log", "header")),
        ("on_unknown", on_unknown, ("raise", "skip")),
        ("on_damage", on_damage, ("raise", "skip")),
    ):
        if value not in known:
            raise OptionError(f"{name}={value!r}: it must be {known[0]!r} or {known[1]!r}")
    if isinstance(topics, str):
        raise UsageError(f"topics={topics!r}: pass a list of topics, such as topics=[{topics!r}]")
    wanted = None if topics is None else list(topics)
    texts = _texts(definitions)
    try:
        _record(src, recorder, progress, time == "header", wanted, texts, on_unknown == "skip", on_damage == "skip")
    except OSError as error:
        if isinstance(error, StorageError):
            raise
        raise StorageError(error.errno, f"cannot be read: {error.strerror}", str(error.filename or src)) from error


def _record(
    src: Path,
    recorder: Recorder,
    progress: Progress | None,
    uses_header: bool,
    wanted: Collection[str] | None,
    definitions: Mapping[str, str],
    skips_unknown: bool,
    salvages: bool,
) -> None:
    bag = _open(src, salvages)
    try:
        intake = Intake(src, bag, recorder, uses_header, wanted, definitions, skips_unknown)
        done = 0
        for batch in bag.batches(intake.wanted):
            intake.add(batch)
            done += len(batch.times_ns)
            if progress is not None:
                progress(done, bag.count)
        if progress is not None and done < bag.count:  # some were not wanted
            progress(bag.count, bag.count)
        for loss in bag.losses:
            warnings.warn(f"{loss}; it is left out", ConversionWarning, stacklevel=3)
    finally:
        bag.close()


def _open(path: Path, salvages: bool) -> Bag:
    if path.is_file() and detect(path) == "rosbag1":
        from .bag_ros1 import Ros1Bag

        return Ros1Bag(path)
    return FolderBag(path, salvages=salvages)


def _texts(definitions: Mapping[str, str | Path] | None) -> dict[str, str]:
    if definitions is not None and not isinstance(definitions, Mapping):
        raise OptionError(f"definitions={definitions!r}: pass a dict of types and their definitions")
    found = {}
    for name, text in (definitions or {}).items():
        if not isinstance(name, str) or not isinstance(text, (str, Path)):
            raise OptionError(f"definitions of {name!r}: pass its text, or the Path of its .msg file, not {text!r}")
        try:
            found[canonical(name)] = text.read_text(encoding="utf-8") if isinstance(text, Path) else text
        except (OSError, UnicodeDecodeError) as error:
            raise OptionError(f"definitions of {name!r}: {text} cannot be read: {error}") from error
    return found
