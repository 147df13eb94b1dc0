"""Registers each topic of a recorder once, and gives it a number of its own."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from ..codecs import codec_table
from ..codecs.given.given_schema import GivenSchema
from ..errors import TopicError
from ..file_names import MESSAGE, TOPIC_RECORD, TRACK
from .channels import ChannelInfo
from .journal import Journal
from .metadata_texts import topic_texts, write_metadata

# Channel ids have 16 bits in MCAP, and schema id 0 means no schema.
_MAX_TOPICS = 65_535


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicAbout:
    """The description of a topic that is given when it is opened."""

    description: str | None = None
    tags: Iterable[str] | None = None
    metadata: Mapping[str, Any] | None = None
    """Replaces the metadata that was given before."""
    more: Mapping[str, Any] | None = None
    """Is added to the metadata."""
    schema: GivenSchema | None = None
    """The schema of the rows, with their codec; None to infer it. The rows of a track whose schema is given are
    messages, which never merge: what two rows make together need not fit the schema."""
    encoding: str | None = None
    """The encoding of the rows. None stands for the recorder's option for tracks, and for JSON for the other kinds."""

    @property
    def is_description(self) -> bool:
        """Whether anything but the schema is told."""
        return any(entry is not None for entry in (self.description, self.tags, self.metadata)) or bool(self.more)


class TopicRegistry:
    """The open topics by kind and name. Any thread may call any method."""

    def __init__(self, journal: Journal, encoding: str) -> None:
        """Begin without topics.

        Args:
            journal: Where they are registered.
            encoding: The encoding of the rows of tracks, unless a topic has another one.
        """
        self._encoding = encoding
        self.channels: dict[int, ChannelInfo] = {}
        """The topics by number, from 1."""
        self._journal = journal
        self._topics: dict[tuple[str, str], Any] = {}
        self._metadata: dict[tuple[str, str], dict[str, Any]] = {}
        """The metadata of topics, by kind and name."""
        self._numbers = itertools.count(1)
        self._topics_lock = threading.RLock()
        """Guards the dicts above while a topic is added."""

    def get(self, kind: str, name: str) -> Any:
        """Return an open topic, or None."""
        return self._topics.get((kind, name))

    def names(self, kind: str) -> list[str]:
        """Return the names of the open topics of a kind, sorted."""
        # A copy, because other threads may open topics while this iterates.
        return sorted(name for topic_kind, name in list(self._topics) if topic_kind == kind)

    def open(self, name: str, kind: str, make: Callable[[ChannelInfo], Any], about: TopicAbout) -> Any:
        """Return a topic, registering it first if it is new; it may be described again later.

        Args:
            name: Checked.
            kind: track, message, log, metric, file or episode.
            make: Makes the topic's object.
            about: The description of the topic.

        Raises:
            OptionError: Rows cannot be recorded in the topic's encoding.
            StateError: The recorder is closed, or this is a forked child, and there is something to be written.
        """
        key = (kind, name)
        if self._journal.is_shut:  # in a forked child the lock may be held by a thread of the parent, for ever
            if key not in self._topics or about.is_description:
                self._journal.check_open()
            return self._topics[key]
        with self._topics_lock:
            texts = self._texts(key, about)
            topic = self._topics.get(key)
            is_new = topic is None
            if is_new:
                info = self._register(self._info(name, kind, texts, about))
                # a signal handler may have opened the topic meanwhile; then this number has no rows
                topic = self._topics.setdefault(key, make(info))
            elif about.more or about.metadata:
                self._note_units_again(key)
        if texts and not is_new:
            write_metadata(self._journal, TOPIC_RECORD, {"topic": name, **texts})
        return topic

    def give_schema(self, channel: ChannelInfo, schema: GivenSchema) -> ChannelInfo:
        """Register a channel with a schema in the place of one that has no rows.

        Args:
            channel: Of the topic so far.
            schema: The schema of its rows.

        Returns:
            The channel of the topic's rows from now on.

        Raises:
            StateError: The recorder is closed, or this is a forked child.
        """
        self._journal.check_open()
        with self._topics_lock:
            # The journal goes on announcing the old channel; a segment announces only channels with rows.
            about = TopicAbout(schema=schema)
            return self._register(self._info(channel.topic, channel.kind, channel.metadata, about))

    def _info(self, name: str, kind: str, texts: Mapping[str, str], about: TopicAbout) -> ChannelInfo:
        """Return the channel of a new topic."""
        given, number = about.schema, next(self._numbers)
        if given is not None:
            kind = MESSAGE if kind == TRACK else kind
            return ChannelInfo(number, name, kind, texts, given.data, given.name or name, given.codec)
        default = self._encoding if kind in (TRACK, MESSAGE) else "json"
        codec = codec_table.to_record(default if about.encoding is None else about.encoding)
        codec = codec.for_channel(name, declare=partial(_redefine, self._journal, self.channels, number))
        codec.note_units(self._units((kind, name)))
        return ChannelInfo(number, name, kind, texts, codec=codec)

    def _note_units_again(self, key: tuple[str, str]) -> None:
        """Let the codec of an open topic know the units that were told later."""
        for info in list(self.channels.values()):
            if (info.kind, info.topic) == key and info.is_inferred and info.codec is not None:
                info.codec.note_units(self._units(key))

    def _units(self, key: tuple[str, str]) -> dict[str, str]:
        """Return the units of a topic's fields that are texts."""
        units = self._metadata.get(key, {}).get("units")
        if not isinstance(units, Mapping):
            return {}
        return {name: unit for name, unit in units.items() if isinstance(name, str) and isinstance(unit, str)}

    def _register(self, info: ChannelInfo) -> ChannelInfo:
        """Announce a channel in the journal."""
        if info.number > _MAX_TOPICS:
            raise TopicError(f"topic {info.topic!r}: a recording holds {_MAX_TOPICS} topics, and has them")
        self.channels[info.number] = info
        self._journal.register(info.number, info.schema_record(info.first_schema()), info.channel_record())
        return info

    def _texts(self, key: tuple[str, str], about: TopicAbout) -> dict[str, str]:
        metadata = about.metadata
        if about.more:
            metadata = {**(metadata if metadata is not None else self._metadata.get(key, {})), **about.more}
        texts = topic_texts(about.description, about.tags, metadata)
        if metadata is not None:
            self._metadata[key] = dict(metadata)
        return texts


# No method, because the writer thread holds the channels, and must not hold the topics.
def _redefine(journal: Journal, channels: Mapping[int, ChannelInfo], number: int, schema: bytes) -> bool:
    """Let the journal know a topic's wider schema; returns whether it has room for it."""
    return journal.redefine(number, channels[number].schema_record(schema))
