"""Exports topics whose messages are ROS's already to a bag: as they are, or translated to the other generation."""

from __future__ import annotations

import math
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ... import clock
from ...codecs.ros import distros
from ...codecs.ros_channel import DIGEST_KEYS
from ...errors import ConversionError, ConversionWarning
from ...file_names import ABOUT_RECORD, BAG_RECORD
from ...mcap import stored_messages
from ...mcap.message import CHUNK_BYTES, Connection, MessageBlock, Payload
from ...mcap.records import Metadata
from ...query import topic_rows
from ...query.file import File
from ..export_job import Job
from .bag_metadata.information import BagInformation
from .bag_metadata.qos_profiles import LATCHING, OFFERED, is_latched, joined
from .bag_plan import Outlet

Convert = Callable[[Payload], Payload]


@dataclass(frozen=True, slots=True)
class BagOrigin:
    """The bag that messages came from, as the files describe it; empty for messages that were in no bag."""

    distro: str = ""
    version: int = 0
    """Of its metadata."""
    custom: Mapping[str, str] = field(default_factory=dict)
    """The custom data of the bag, by key."""
    digests: Mapping[str, str] = field(default_factory=dict)
    """Hashes of types by topic, where the bag's metadata have them and its files do not."""
    profiles: Mapping[str, str] = field(default_factory=dict)
    """QoS profiles by topic, likewise, as YAML."""


def topics(job: Job) -> list[str]:
    """Return the topics whose messages are ROS's, on all of their channels."""
    return [topic for topic in job.topics if _is_carried(job, topic)]


def _is_carried(job: Job, topic: str) -> bool:
    channels = job.stored(topic).channels
    return bool(channels) and all(channel.message_encoding in ("cdr", "ros1") for _, channel in channels)


def origin(job: Job) -> BagOrigin:
    """Return what the files and their folders state about the bag that they are from. The last statement counts."""
    distro, version = "", 0
    custom, digests, profiles = dict[str, str](), dict[str, str](), dict[str, str]()
    for stated, text in _stated(job):
        information = BagInformation.lenient(text)
        distro = stated or information.distro or distro
        version = information.version or version
        custom.update(information.custom)
        digests.update(information.digests)
        profiles.update(information.profiles)
    return BagOrigin(distro, version, custom, digests, profiles)


def _stated(job: Job) -> Iterator[tuple[str, str]]:
    """Yield the statements about the bag: a distribution and the text of a `metadata.yaml`; one may be empty."""
    by_folder: dict[Path, File] = {}
    for file in job.files:
        by_folder.setdefault(file.path.parent, file)
    for file in by_folder.values():
        beside = file.source.beside(distros.METADATA_FILE)
        if beside is not None:
            yield "", beside.decode(errors="replace")
    for file in job.files:
        for record in file.metadata():
            if record.name == BAG_RECORD:
                yield "", record.values.get(distros.METADATA_FILE, "")
            elif record.name == distros.RECORD:
                yield record.values.get(distros.DISTRO_KEY, ""), record.values.get(distros.TEXT_KEY, "")


class Carried:
    """Messages that go into a bag as they are, in the order in which they are stored."""

    def __init__(
        self, job: Job, names: list[str], origin: BagOrigin, *, is_ros1: bool = False, time_offset: float = 0.0
    ) -> None:
        """Look at the channels.

        Args:
            job: What is exported.
            names: Topics whose messages are ROS's.
            origin: What is known of the bag that they came from.
            is_ros1: Whether the bag is one of ROS 1.
            time_offset: Added to all times, in s.
        """
        self._job = job
        self._origin = origin
        self._is_ros1 = is_ros1
        self._offset_ns = round(time_offset * clock.NS_PER_S)
        self.outlets: list[Outlet] = []
        """Those of the bag, one a topic and type, or in ROS 1 one a connection."""
        self._numbers: list[dict[int, int]] = []
        """For each file, channel ids to the numbers of outlets."""
        self._converters: dict[int, Convert] = {}
        self._dropped: Counter[int] = Counter()
        numbers_by_channel: dict[object, int | None] = {}
        for file in job.files:
            numbers: dict[int, int] = {}
            repeated: Counter[Connection] = Counter()
            for channel_id, channel in stored_messages.channels(file).items():
                if channel.topic not in names:
                    continue
                # In ROS 1 two equal connections are two publishers and stay two, so equal ones are counted within a
                # file.
                key = (channel, repeated[channel]) if is_ros1 and channel.is_ros1 else _merged(channel)
                repeated[channel] += 1
                if key not in numbers_by_channel:
                    numbers_by_channel[key] = self._add(channel, len(self.outlets) + 1)
                number = numbers_by_channel[key]
                if number is not None:
                    numbers[channel_id] = number
                    self._add_profiles(number, channel)
            self._numbers.append(numbers)

    def blocks(self) -> Iterator[MessageBlock]:
        """Yield the messages, their channels numbered as the outlets.

        Raises:
            ConversionError: A time would lie before 0 with the offset.
        """
        low, high = self._job.low, self._job.high
        start_ns, end_ns = topic_rows.to_ns_range(low, high)
        for file, numbers in zip(self._job.files, self._numbers, strict=True):
            if numbers:
                for block in stored_messages.joined(
                    stored_messages.blocks(file, list(numbers), start_ns, end_ns), CHUNK_BYTES
                ):
                    part = self._prepared(_within(block, low, high), numbers)
                    if len(part):
                        yield part
        for number, count in self._dropped.items():
            outlet = next(candidate for candidate in self.outlets if candidate.number == number)
            self._warn(f"topic {outlet.topic!r}: {count} messages that are no {outlet.type} are left out")

    @property
    def files(self) -> list[File]:
        """Those that have messages for the bag."""
        return [file for file, numbers in zip(self._job.files, self._numbers, strict=True) if numbers]

    def _add_profiles(self, number: int, channel: Connection) -> None:
        """Add what a topic is offered with in another file to what is known of it."""
        outlet = self.outlets[number - 1]
        if outlet.carried is None or channel.is_ros1:
            return
        metadata, more = dict(outlet.carried.metadata), dict(channel.metadata).get(OFFERED, "")
        if more and more not in metadata.get(OFFERED, ""):
            metadata[OFFERED] = joined(metadata.get(OFFERED, ""), more)
            carried = replace(outlet.carried, metadata=tuple(metadata.items()))
            self.outlets[number - 1] = replace(outlet, carried=carried)

    def _add(self, channel: Connection, number: int) -> int | None:
        """Make an outlet of a channel; returns its number, or None for messages that the bag's generation lacks."""
        if not channel.is_ros1 and OFFERED not in dict(channel.metadata):
            profiles = self._origin.profiles.get(channel.topic, "")
            channel = replace(channel, metadata=(*channel.metadata, (OFFERED, profiles)))
        if channel.is_ros1 != self._is_ros1:
            try:
                channel = self._translated(channel, number)
            except ConversionError as error:
                self._warn(f"topic {channel.topic!r} is left out: {error}")
                return None
        metadata = dict(channel.metadata)
        digest = metadata.get(DIGEST_KEYS[self._is_ros1])
        if digest is None:
            digest = "" if self._is_ros1 else self._origin.digests.get(channel.topic, "")
        self.outlets.append(Outlet(number, channel.topic, channel.type, channel.text, digest, carried=channel))
        return number

    def _translated(self, channel: Connection, number: int) -> Connection:
        """Return a channel as the other generation of ROS has it.

        Raises:
            ConversionError: It cannot say what its messages are.
        """
        from .translate import translation

        if not channel.schema_encoding:
            raise ConversionError(f"nobody says what a message of type {channel.type!r} is made of")
        translated = translation(channel.type, channel.schema_encoding, channel.text, to_ros1=self._is_ros1)
        for change in translated.changes:
            self._warn(f"topic {channel.topic!r}: in ROS {1 if self._is_ros1 else 2}, {change}")
        self._converters[number] = translated.convert
        before = dict(channel.metadata)
        if self._is_ros1:
            metadata = {"topic": channel.topic, DIGEST_KEYS[True]: translated.digest}
            if is_latched(before.get(OFFERED, "")):
                metadata[LATCHING] = "1"
        else:
            metadata = {DIGEST_KEYS[False]: translated.digest}
            if LATCHING in before:
                metadata[LATCHING] = before[LATCHING]
        return Connection(
            channel.topic,
            translated.type,
            "ros1msg" if self._is_ros1 else "ros2msg",
            translated.text.encode(),
            "ros1" if self._is_ros1 else "cdr",
            tuple(metadata.items()),
        )

    def _prepared(self, block: MessageBlock, numbers: Mapping[int, int]) -> MessageBlock:
        block = block.renumbered(numbers)
        if self._offset_ns and len(block):
            block = replace(
                block, times_ns=self._shifted(block.times_ns), published_ns=self._shifted(block.published_ns)
            )
        wanted = self._converters.keys() & set(np.unique(block.channels).tolist())
        return self._converted(block) if wanted else block

    def _converted(self, block: MessageBlock) -> MessageBlock:
        payloads: list[Payload] = []
        kept: list[int] = []
        for at, (number, payload) in enumerate(zip(block.channels.tolist(), block.payloads, strict=True)):
            convert = self._converters.get(number)
            try:
                payloads.append(payload if convert is None else convert(payload))
            except ValueError:
                self._dropped[number] += 1
            else:
                kept.append(at)
        whole = block if len(kept) == len(block) else block.pick(np.array(kept, np.intp))
        return replace(whole, payloads=payloads)

    def _shifted(self, times_ns: np.ndarray) -> np.ndarray:
        moved = times_ns.astype(np.int64) + self._offset_ns
        if int(moved.min()) < 0:
            first = clock.to_seconds(int(times_ns[int(np.argmin(moved))]))
            raise ConversionError(
                f"a message at {first!r} s would lie before 0 with time_offset={self._offset_ns / 1e9!r}; pass another"
            )
        return moved.astype(np.uint64)

    def _warn(self, what: str) -> None:
        warnings.warn(what, ConversionWarning, stacklevel=6)


def foreign_metadata(file: File) -> list[Metadata]:
    """Return a file's metadata records that are neither ours nor rosbag2's."""
    return [
        record
        for record in file.metadata()
        if record.name != distros.RECORD and record.name.partition(".")[0] != ABOUT_RECORD
    ]


def warn_of_beside(files: list[File], where: str) -> None:
    """Warn of attachments and metadata records that the files hold, when the bag has no place for them."""
    names = [entry.name for file in files for _, entry in stored_messages.attachments(file)]
    names += [record.name for file in files for record in foreign_metadata(file)]
    if names:
        what = f"attachments and metadata records have no place in {where}: {', '.join(map(repr, names))}"
        warnings.warn(what, ConversionWarning, stacklevel=3)


def _merged(channel: Connection) -> Connection:
    """Return the channel without its metadata: a rosbag2 tells topics apart by name and type, not by their senders."""
    return replace(channel, metadata=())


def _within(block: MessageBlock, low: float, high: float) -> MessageBlock:
    """Return the messages of a time range in seconds, both ends included."""
    # The range is in seconds as users give it; comparing doubles again gives the same ends as `read` does.
    if low == -math.inf and high == math.inf:
        return block
    seconds = np.array(clock.to_seconds_each(block.times_ns.tolist()))
    keep = np.flatnonzero((seconds >= low) & (seconds <= high))
    return block if len(keep) == len(block) else block.pick(keep)
