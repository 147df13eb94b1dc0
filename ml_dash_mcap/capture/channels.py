"""What is fixed about a topic when it is opened: its number, kind, metadata, and its schema if it is not inferred."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ..file_names import KIND_KEY
from ..mcap.records import CHANNEL, SCHEMA, Channel, Schema
from ..rows import schema as schemas


@dataclass(frozen=True, slots=True)
class ChannelInfo:
    """A topic of a recorder; its channel and its schema have the same number in every segment."""

    number: int
    """Channel id and schema id, from 1."""
    topic: str
    kind: str
    """track, log, metric or file; only the rows of tracks merge."""
    metadata: Mapping[str, str] = field(default_factory=dict)
    """The channel's metadata besides its kind."""
    schema: Mapping[str, Any] | None = None
    """None: inferred from the rows."""
    schema_name: str | None = None
    """None: the topic's name."""

    def channel_record(self) -> bytes:
        """Return the Channel record."""
        metadata = {KIND_KEY: self.kind, **self.metadata}
        return CHANNEL.pack(Channel(self.number, self.number, self.topic, "json", metadata))

    def schema_record(self, schema: Mapping[str, Any] | None, reserve: int = 0) -> bytes:
        """Return the Schema record; its text is padded to `reserve` bytes."""
        said = schema or self.schema or {"type": "object", "title": self.topic}
        data = schemas.to_bytes(dict(said), reserve)
        return SCHEMA.pack(Schema(self.number, self.schema_name or self.topic, "jsonschema", data))
