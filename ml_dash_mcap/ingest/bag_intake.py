"""Messages of a bag to the rows of a recorder."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

from .. import clock
from ..errors import ConversionWarning, DamagedFileError, EncodingError
from ..layout import MESSAGE
from ..lookup import not_found
from ..recorder import Recorder
from ..ros import decode, lossless, msg, restore
from ..ros.lossless import Message
from ..ros.unpack import unpack
from ..rows.encode import TIME_KEY
from ..topic import Topic
from .bag_messages import Bag, Batch, Channel

Row = dict[str, Any]

_CUSTOM_KEY = "ml_dash"


class Intake:
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
        """Open a topic of the recorder for each channel that is wanted.

        Args:
            src: Of the bag, for the errors.
            bag: Whose messages come.
            recorder: Where to.
            uses_header: Whether `_ts` is the header's stamp, for messages of others.
            wanted: Topics, by the bag's names or ours; None for all but the standard messages that we derived.
            definitions: Type to its definition, as text.
            skips_unknown: Whether to leave out types that nobody knows.

        Raises:
            EncodingError: A type is not known.
            NotFoundError: There is no such topic.
        """
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
        named = {channel: self._name(channel, message) for channel, message in own.items()}
        self._check(wanted, bag.channels, named)
        for channel in bag.channels:
            if wanted is not None and not {channel.topic, named.get(channel, channel.topic)} & set(wanted):
                self._adders[channel] = None
            elif channel in own:
                self._adders[channel] = self._own(channel, own[channel])
            elif wanted is None and channel.topic in derived and own:
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

    def _name(self, channel: Channel, message: Message) -> str:
        """Return what a topic of ours was called in its recording."""
        name = self._said.get("topics", {}).get(channel.topic) or message.about.get("topic")
        return name if isinstance(name, str) else channel.topic.removeprefix("/")

    @staticmethod
    def _check(wanted: Collection[str] | None, channels: Iterable[Channel], named: Mapping[Channel, str]) -> None:
        there = {channel.topic: None for channel in channels}
        there.update(dict.fromkeys(named.values()))
        for name in wanted or ():
            if name not in there:
                raise not_found("topic", name, there)

    def _own(self, channel: Channel, message: Message) -> Callable[[Batch], None]:
        """Return what takes messages that say all that our rows said."""
        name = self._name(channel, message)
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
        given = self._definitions.get(canonical(channel.type))
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


def canonical(name: str) -> str:
    """Return a type's name as `package/Name`, whether `msg` stood in between or not."""
    parts = name.split("/")
    return f"{parts[0]}/{parts[-1]}"
