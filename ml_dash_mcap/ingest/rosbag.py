"""ROS bags of both generations as recordings."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

from .. import clock
from ..errors import ConversionWarning, DamagedFileError, EncodingError, OptionError
from ..layout import MESSAGE
from ..recorder import Recorder
from ..ros import decode, lossless, msg, restore
from ..ros.lossless import Message
from ..ros.unpack import unpack
from ..rows.encode import TIME_KEY
from ..topic import Topic
from . import bag_folder, bag_mcap, bag_sqlite
from .bag_folder import FolderBag
from .bag_messages import Bag, Batch, Channel

Progress = Callable[[int, int], object]
Row = dict[str, Any]

_CUSTOM_KEY = "ml_dash"
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
        return "rosbag2" if any(one.name.endswith((".db3", ".db3.zstd")) for one in path.iterdir()) else None
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError:
        return None
    if head.startswith(_ROS1_MAGIC):
        return "rosbag1"
    if head.startswith(bag_sqlite.MAGIC) and path.suffix == ".db3":
        return "rosbag2"
    return "rosbag2" if head.startswith(bag_mcap.MAGIC) and head[17:25] == b"\x04\0\0\0ros2" else None


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
    bag = bag_mcap.McapBag(files[0])
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
        topics: Names of the bag's topics; None for all.
        definitions: Type to its definition, or the `.msg` file with it, for bags that do not have them.
        on_unknown: What happens to a topic whose type nobody knows: "raise", or "skip" to leave it out with a warning.

    Raises:
        DamagedFileError: The bag is damaged.
        MissingRecordingError: A file of it is missing.
        EncodingError: A type is not known, or broken; the message names it.
        OptionError: An option has a value that it cannot have.
    """
    for name, value, known in (("time", time, ("log", "header")), ("on_unknown", on_unknown, ("raise", "skip"))):
        if value not in known:
            raise OptionError(f"{name}={value!r}: it must be {known[0]!r} or {known[1]!r}")
    wanted = None if topics is None else set(topics)
    bag = _open(src)
    try:
        intake = _Intake(src, bag, recorder, time == "header", wanted, _texts(definitions), on_unknown == "skip")
        done = 0
        for batch in bag.batches(intake.wanted):
            intake.add(batch)
            done += len(batch.times_ns)
            if progress is not None:
                progress(done, bag.count)
        if progress is not None and done < bag.count:  # some were not wanted
            progress(bag.count, bag.count)
    finally:
        bag.close()


def _open(path: Path) -> Bag:
    if path.is_file():
        with path.open("rb") as file:
            if file.read(len(_ROS1_MAGIC)) == _ROS1_MAGIC:
                from .bag_ros1 import Ros1Bag

                return Ros1Bag(path)
    return FolderBag(path)


def _texts(definitions: Mapping[str, str | Path] | None) -> dict[str, str]:
    found = {}
    for name, text in (definitions or {}).items():
        found[_canonical(name)] = text.read_text(encoding="utf-8") if isinstance(text, Path) else text
    return found


def _canonical(name: str) -> str:
    parts = name.split("/")
    return f"{parts[0]}/{parts[-1]}"


class _Intake:
    """Takes batches of messages and appends them as rows."""

    def __init__(
        self,
        src: Path,
        bag: Bag,
        recorder: Recorder,
        uses_header: bool,
        wanted: Collection[str] | None,
        definitions: Mapping[str, str],
        skips_unknown: bool,
    ) -> None:
        self._src = src
        self._recorder = recorder
        self._uses_header = uses_header
        self._definitions = definitions
        self._skips_unknown = skips_unknown
        self._adders: dict[Channel, Callable[[Batch], None] | None] = {}
        self._said = _said(bag.custom)
        if self._said.get("params"):
            recorder.set_parameters(self._said["params"])
        derived: set[str] = set(self._said.get("derived", {}))
        own: dict[Channel, Message] = {}
        for channel in bag.channels:
            message = msg.parse(channel.type, channel.text) if msg.MARK in channel.text else None
            if message is not None:
                own[channel] = message
                derived.update(message.about.get("derived", ()))
        for channel in bag.channels:
            if wanted is not None and channel.topic not in wanted:
                self._adders[channel] = None
            elif channel in own:
                self._adders[channel] = self._own(channel, own[channel])
            elif channel.topic in derived and own:
                self._adders[channel] = None
            else:
                self._adders[channel] = self._foreign(channel)

    @property
    def wanted(self) -> set[Channel]:
        """The channels whose messages become rows."""
        return {channel for channel, adder in self._adders.items() if adder is not None}

    def add(self, batch: Batch) -> None:
        """Take some messages."""
        adder = self._adders[batch.channel]
        assert adder is not None  # it is a wanted one
        adder(batch)

    def _own(self, channel: Channel, message: Message) -> Callable[[Batch], None]:
        """Return what takes messages that say all that our rows said."""
        name = self._said.get("topics", {}).get(channel.topic) or message.about.get("topic")
        name = name if isinstance(name, str) else channel.topic.removeprefix("/")
        said = {**message.about, **self._said.get("about", {}).get(name, {})}
        topic = self._recorder.topic(
            name,
            description=said.get("description"),
            tags=said.get("tags") or None,
            metadata=said.get("metadata") or None,
        )
        type_ = lossless.struct(message, channel.type.split("/")[0], is_ros1=channel.is_ros1)

        def add(batch: Batch) -> None:
            try:
                column = unpack(type_, batch.payloads, is_ros1=channel.is_ros1)
                plain = restore.plain(message, column)
                rows = restore.rows(message, column) if plain is None else []
            except ValueError as error:
                what = f"a message of topic {channel.topic!r} from {batch.times_ns[0]} ns on is no {channel.type}"
                raise DamagedFileError(self._src, 0, f"{what}: {error}") from error
            if plain is None:
                topic.append_batch(rows)
            else:
                topic.append_columns(_ts=column["ts"], **plain)

        return add

    def _foreign(self, channel: Channel) -> Callable[[Batch], None] | None:
        """Return what takes messages of others; None if their type is not known and that is allowed."""
        try:
            decode_one = self._decoder(channel)
        except EncodingError as error:
            what = f"topic {channel.topic!r} of type {channel.type!r}: {error}"
            if not self._skips_unknown:
                raise EncodingError(
                    f"{what}; pass definitions={{{channel.type!r}: <its .msg text>}}, or on_unknown='skip' to leave it"
                    " out"
                ) from error
            warnings.warn(f"{what}; it is left out", ConversionWarning, stacklevel=2)
            return None
        topic = self._recorder._open(channel.topic, MESSAGE, Topic)

        def add(batch: Batch) -> None:
            rows = []
            for time_ns, payload in zip(batch.times_ns, batch.payloads, strict=True):
                try:
                    row = decode_one(payload)
                except ValueError as error:
                    what = f"the message of topic {channel.topic!r} at {time_ns} ns is no {channel.type}"
                    raise DamagedFileError(self._src, 0, f"{what}: {error}") from error
                stamp = _stamp(row) if self._uses_header else 0
                row[TIME_KEY] = clock.to_seconds(stamp or time_ns)
                rows.append(row)
            topic.append_batch(rows)

        return add

    def _decoder(self, channel: Channel) -> Callable[[bytes], Row]:
        encoding, text = channel.encoding, channel.text
        given = self._definitions.get(_canonical(channel.type))
        if given is not None:
            encoding, text = ("ros1msg" if channel.is_ros1 else "ros2msg"), given
        elif not text:
            from ..ros import stores

            encoding, text = "ros2msg", stores.known(channel.type)
        return decode.decoder(channel.type, encoding, text, is_ros1=channel.is_ros1)


def _said(custom: Mapping[str, str]) -> dict[str, Any]:
    """Return what our export wrote about the bag."""
    try:
        found = json.loads(custom.get(_CUSTOM_KEY, "{}"))
    except (TypeError, ValueError):
        return {}
    is_ours = isinstance(found, dict) and all(isinstance(found.get(key, {}), dict) for key in ("topics", "about"))
    return found if is_ours else {}


def _stamp(row: Row) -> int:
    """Return the header's stamp, in ns; 0 without one."""
    header = row.get("header")
    stamp = header.get("stamp") if isinstance(header, dict) else None
    if not isinstance(stamp, dict):
        return 0
    sec, nsec = stamp.get("sec", stamp.get("secs")), stamp.get("nanosec", stamp.get("nsecs"))
    if not isinstance(sec, int) or not isinstance(nsec, int) or sec < 0:
        return 0
    return sec * clock.NS_PER_S + nsec
