"""The index of an MCAP file: its schemas, channels, chunks, metadata and attachments, and where they lie."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, wraps
from typing import ParamSpec, TypeVar

from .losses import Loss
from .records import AttachmentEntry, Channel, Chunk, Header, MetadataEntry, Schema, Statistics

OWN_LIBRARY = "ml_dash_mcap"
"""The library name in the headers of our files. In one chunk they have no two rows of one topic and time stamp."""


class ReindexedError(Exception):
    """A file's index was wrong about where things lie and was replaced: a plan made from it has to be made again."""


P = ParamSpec("P")
T = TypeVar("T")


def replanned(work: Callable[P, T]) -> Callable[P, T]:
    """Repeat a function if an index that it used was wrong; the index of a file is replaced once at most."""

    @wraps(work)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> T:
        while True:
            try:
                return work(*args, **kwargs)
            except ReindexedError:
                continue

    return wrapper


@dataclass(frozen=True)  # no slots: what is looked up by topic is kept, for a file may have thousands of channels
class Glance:
    """The contents of a file without its chunks, read at a glance. No checksum has verified them."""

    header: Header
    schemas: Mapping[int, Schema]
    channels: Mapping[int, Channel]
    metadata: tuple[MetadataEntry, ...]
    attachments: tuple[AttachmentEntry, ...]
    statistics: Statistics | None

    @cached_property
    def channels_by_topic(self) -> dict[str, dict[int, Channel]]:
        """The channels of each topic, by id: our own files have one a topic, others may have several."""
        by_topic: dict[str, dict[int, Channel]] = {}
        for channel in self.channels.values():
            by_topic.setdefault(channel.topic, {})[channel.id] = channel
        return by_topic


@dataclass(frozen=True)
class FileIndex:
    """A table of contents: from a finished file's summary, or from a scan of its records."""

    path: str
    header: Header
    schemas: Mapping[int, Schema]
    channels: Mapping[int, Channel]
    chunks: Sequence[Chunk]
    """In the order of the file."""
    message_counts: Mapping[int, int]
    """Channel to its number of messages."""
    metadata: tuple[MetadataEntry, ...]
    attachments: tuple[AttachmentEntry, ...]
    finished: bool
    """Whether the file has its end: footer and closing magic."""
    end: int
    """Where the last whole record of the data section ends, in bytes."""
    losses: tuple[Loss, ...] = ()
    """Damage that is left out, and wrong entries that are corrected."""
    statistics: Statistics | None = None
    by_summary: bool = False
    """Whether a summary says all this, rather than the records themselves."""
    doubtful: bool = False
    """Whether the summary says how many messages there are in two ways that differ: only they themselves can tell."""
    schema_places: Mapping[int, tuple[int, int]] = field(default_factory=dict)
    """Where the Schema records lie that a scan met, by schema: where each starts, and how long its content is."""
    size: int = 0
    """The place where a finished file's closing magic ends, in bytes. Other bytes may follow."""

    @property
    def is_ours(self) -> bool:
        """Whether this library's recorder wrote it, as its header says."""
        return self.header.library.startswith(OWN_LIBRARY)

    @cached_property
    def glance(self) -> Glance:
        """The contents besides the chunks."""
        return Glance(self.header, self.schemas, self.channels, self.metadata, self.attachments, self.statistics)

    def channels_of(self, topic: str) -> Mapping[int, Channel]:
        """Return a topic's channels by id; none if the file does not have it."""
        return self.glance.channels_by_topic.get(topic, {})

    def schema_of(self, channel: Channel) -> Schema | None:
        """Return a channel's schema, if it has one."""
        return self.schemas.get(channel.schema_id)


def empty(path: str) -> FileIndex:
    """Return the index of a file that its recorder has only just created."""
    return FileIndex(path, Header("", ""), {}, {}, (), {}, (), (), finished=False, end=0)
