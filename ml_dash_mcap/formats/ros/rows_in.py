"""Turns the messages of a bag into rows of a recorder."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ... import clock
from ...capture.topic_registry import TopicAbout
from ...codecs import decode
from ...codecs.encoded_channel import Decoder
from ...codecs.ros.unpack import unpack
from ...errors import DamagedFileError
from ...file_names import MESSAGE, TRACK
from ...mcap.message import Connection
from ...mcap.records import Channel, Schema
from ...query.time_order import TOLERANCE_NS
from ...recorder import Recorder, open_topic
from ...rows.plain_row import TIME_KEY
from ...suggestions import not_found
from .bag_contents import Bag, ConnectionBatch
from .bag_types import Types
from .message_topic import MessageTopic
from .messages import lossless_definitions, restore
from .messages.lossless import Message

Row = dict[str, Any]

_CUSTOM_KEY = "ml_dash"


class Origins:
    """Which channels of a bag are topics that this library exported, and which are standard messages made of them."""

    def __init__(self, bag: Bag) -> None:
        """Look at a bag's definitions, and at what its metadata say."""
        self.metadata = _metadata(bag.custom)
        self.own: dict[Connection, Message] = {}
        """The channels that our export wrote for rows, and the messages that they have."""
        self._derived: set[str] = set(self.metadata.get("derived", {}))
        for channel in bag.channels:
            message = (
                lossless_definitions.parse(channel.type, channel.text)
                if lossless_definitions.MARK in channel.text
                else None
            )
            if message is not None:
                self.own[channel] = message
                self._derived.update(message.about.get("derived", ()))

    def is_derived(self, channel: Connection) -> bool:
        """Whether a channel has standard messages that were derived from the rows of one of our topics."""
        return bool(self.own) and channel not in self.own and channel.topic in self._derived

    def name(self, channel: Connection) -> str:
        """Return what a topic is called in the recording."""
        message = self.own.get(channel)
        if message is None:
            return channel.topic
        name = self.metadata.get("topics", {}).get(channel.topic) or message.about.get("topic")
        return name if isinstance(name, str) else channel.topic.removeprefix("/")

    def chosen(self, channels: Iterable[Connection], wanted: Collection[str] | None) -> set[Connection]:
        """Return the channels of some topics, by the bag's names or ours; by default all that are not derived.

        Raises:
            NotFoundError: There is no such topic.
        """
        channels = list(channels)
        if wanted is None:
            return {channel for channel in channels if not self.is_derived(channel)}
        names = dict.fromkeys(name for channel in channels for name in (channel.topic, self.name(channel)))
        for name in wanted:
            if name not in names:
                raise not_found("topic", name, names)
        return {channel for channel in channels if {channel.topic, self.name(channel)} & set(wanted)}


class Intake:
    """Takes batches of messages and appends them as rows."""

    def __init__(
        self,
        src: Path,
        recorder: Recorder,
        origins: Origins,
        types: Types,
        wanted: Iterable[Connection],
        uses_header: bool,
        salvages: bool = False,
    ) -> None:
        """Open a topic of the recorder for each channel that is wanted.

        Args:
            src: Of the bag, for the errors.
            recorder: Where to.
            origins: Which channels are ours.
            types: What is known of the bag's types.
            wanted: Channels whose messages become rows.
            uses_header: Whether `_ts` is the header's stamp, for messages of others.
            salvages: Whether to leave out messages that are not what their type says, and note them in `losses`.

        Raises:
            EncodingError: A type is unknown, and `on_unknown` is "raise".
        """
        self._src = src
        self._recorder = recorder
        self._origins = origins
        self._types = types
        self._uses_header = uses_header
        self._salvages = salvages
        self.losses: list[str] = []
        """Descriptions of the damaged messages that were left out so far."""
        self._adders: dict[Connection, Callable[[ConnectionBatch], None]] = {}
        for channel in wanted:
            self._adders[channel] = (
                self._own(channel, origins.own[channel]) if channel in origins.own else self._foreign(channel)
            )
        if origins.metadata.get("params") and any(channel in origins.own for channel in self._adders):
            recorder.set_parameters(origins.metadata["params"])

    @property
    def wanted(self) -> set[Connection]:
        """The channels whose messages become rows."""
        return set(self._adders)

    def add(self, batch: ConnectionBatch) -> None:
        """Take some messages. With `salvages`, damaged ones are left out and the others taken.

        Raises:
            DamagedFileError: A message is not what its type says; then none is taken.
        """
        try:
            self._adders[batch.channel](batch)
        except DamagedFileError as error:
            if not self._salvages:
                raise
            if len(batch.payloads) == 1:
                self.losses.append(str(error))
                return
            # Halving finds the damaged messages in few calls while the intact ones are still read by columns.
            middle = len(batch.payloads) // 2
            for part in (slice(0, middle), slice(middle, None)):
                self.add(ConnectionBatch(batch.channel, batch.times_ns[part], batch.payloads[part]))

    def _own(self, channel: Connection, message: Message) -> Callable[[ConnectionBatch], None]:
        """Return the function that takes messages which our export made of the rows of a track."""
        name = self._origins.name(channel)
        stated = {**message.about, **self._origins.metadata.get("about", {}).get(name, {})}
        about = {
            "description": stated.get("description"),
            "tags": stated.get("tags") or None,
            "metadata": stated.get("metadata") or None,
        }
        if stated.get("kind", TRACK) != TRACK:
            messages = open_topic(self._recorder, name, MESSAGE, MessageTopic, TopicAbout(**about))
            return self._own_messages(channel, message, messages)
        topic = self._recorder.topic(name, **about)
        definitions = lossless_definitions.describe(message, channel.type.split("/")[0], is_ros1=channel.is_ros1)

        def add(batch: ConnectionBatch) -> None:
            with self._named(batch):
                column = unpack(definitions, batch.payloads, is_ros1=channel.is_ros1)
                plain = restore.plain(message, column)
                if plain is None:
                    topic.append_batch(restore.rows(message, column))
                else:
                    topic.append_columns(_ts=column["ts"], **plain)

        return add

    def _own_messages(
        self, channel: Connection, message: Message, topic: MessageTopic
    ) -> Callable[[ConnectionBatch], None]:
        """Return the function that takes messages which our export made of messages: each keeps its time."""
        definitions = lossless_definitions.describe(message, channel.type.split("/")[0], is_ros1=channel.is_ros1)

        def add(batch: ConnectionBatch) -> None:
            with self._named(batch):
                rows = restore.rows(message, unpack(definitions, batch.payloads, is_ros1=channel.is_ros1))
                pairs = zip(rows, batch.times_ns, strict=True)
                times_ns = [_unshifted(row[TIME_KEY], time_ns) for row, time_ns in pairs]
            topic.append_at(rows, times_ns)

        return add

    def _foreign(self, channel: Connection) -> Callable[[ConnectionBatch], None]:
        """Return the function that takes messages of others, each as a row of its own."""
        decode_one: Decoder | None = None
        topic = open_topic(self._recorder, channel.topic, MESSAGE, MessageTopic)

        def add(batch: ConnectionBatch) -> None:
            nonlocal decode_one
            if decode_one is None:
                decode_one = self._decoder(channel)
            rows, times_ns = [], []
            for time_ns, payload in zip(batch.times_ns, batch.payloads, strict=True):
                with self._named(ConnectionBatch(channel, [time_ns], [payload])):
                    row = decode_one(payload)
                if row is not None:
                    times_ns.append((_stamp(row) if self._uses_header else 0) or time_ns)
                    rows.append(row)
            topic.append_at(rows, times_ns)

        return add

    @contextmanager
    def _named(self, batch: ConnectionBatch) -> Iterator[None]:
        """Turn a `ValueError` about messages that do not match their type into an error that names the messages."""
        try:
            yield
        except ValueError as error:
            topic, first_ns, last_ns = batch.channel.topic, batch.times_ns[0], batch.times_ns[-1]
            which = f"the message of topic {topic!r} at {first_ns} ns"
            if len(batch.times_ns) > 1:
                which = f"a message of topic {topic!r} from {first_ns} ns to {last_ns} ns"
            raise DamagedFileError(self._src, 0, f"{which} is no {batch.channel.type}: {error}") from error

    def _decoder(self, channel: Connection) -> Decoder:
        described = self._types.described(channel)
        if self._types.is_unknown(channel):
            self._types.name_unknown(channel)
        schema = Schema(1, described.type, described.schema_encoding, described.definition)
        record = Channel(1, 1, channel.topic, channel.message_encoding, dict(channel.metadata))
        return decode.decoder(record, schema, self._types.decoding, lambda: self._types.likely)


def _metadata(custom: Mapping[str, str]) -> dict[str, Any]:
    """Return what our export wrote about the bag."""
    try:
        metadata = json.loads(custom.get(_CUSTOM_KEY, "{}"))
    except (TypeError, ValueError):
        return {}
    is_ours = isinstance(metadata, dict) and all(isinstance(metadata.get(key, {}), dict) for key in ("topics", "about"))
    return metadata if is_ours else {}


def _unshifted(time_s: float, time_ns: int) -> int:
    """Return the time, in ns, of a message whose bag was perhaps exported with another offset than its own."""
    # The row has its own time as a double; the message's time is exact but may be moved by the export's time_offset.
    return time_ns if abs(time_s * clock.NS_PER_S - time_ns) <= TOLERANCE_NS else clock.to_nanoseconds(time_s)


def _stamp(row: Row) -> int:
    """Return the header's stamp, in ns; 0 without one."""
    header = row.get("header")
    stamp = header.get("stamp") if isinstance(header, dict) else None
    if not isinstance(stamp, dict):
        return 0
    # ROS 2 calls the parts sec and nanosec, ROS 1 secs and nsecs.
    sec, nsec = stamp.get("sec", stamp.get("secs")), stamp.get("nanosec", stamp.get("nsecs"))
    if not isinstance(sec, int) or not isinstance(nsec, int) or sec < 0:
        return 0
    return sec * clock.NS_PER_S + nsec
