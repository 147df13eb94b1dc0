"""What a file holds, and where."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from .losses import Loss
from .records import AttachmentEntry, Channel, Chunk, Header, MetadataEntry, Schema, Statistics


@dataclass(frozen=True, slots=True)
class Glance:
    """What is known of a file before its chunks are looked up; no checksum has verified it."""

    header: Header
    schemas: Mapping[int, Schema]
    channels: Mapping[int, Channel]
    metadata: tuple[MetadataEntry, ...]
    attachments: tuple[AttachmentEntry, ...]
    statistics: Statistics | None


@dataclass(frozen=True, slots=True)
class FileIndex:
    """A table of contents: from a finished file's summary, or from walking over its records."""

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
    """What was found broken and is left out."""
    statistics: Statistics | None = None

    def glance(self) -> Glance:
        """Return what is in it besides the chunks."""
        return Glance(self.header, self.schemas, self.channels, self.metadata, self.attachments, self.statistics)

    def channels_of(self, topic: str) -> dict[int, Channel]:
        """Return a topic's channels (our own files have one, others may have several)."""
        return {channel.id: channel for channel in self.channels.values() if channel.topic == topic}

    def schema_of(self, channel: Channel) -> Schema | None:
        """Return a channel's schema, if it has one."""
        return self.schemas.get(channel.schema_id)


def empty(path: str) -> FileIndex:
    """Return the index of a file that its recorder has only just created."""
    return FileIndex(path, Header("", ""), {}, {}, (), {}, (), (), finished=False, end=0)
