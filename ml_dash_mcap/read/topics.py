"""A topic at a glance, without reading its rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import orjson

from ..layout import TOPIC_RECORD
from . import counts, schemas
from .file import File

_DESCRIBING = ("description", "tags", "metadata")


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """A topic at a glance."""

    name: str
    kind: str | None
    """"track", "log", "metric" or "file"; None in files that others wrote."""
    count: int
    """Rows, after merging those of one time stamp."""
    start: float | None
    """Time stamp of the first row, in s; None without rows."""
    end: float | None
    """Time stamp of the last row, in s; None without rows."""
    fields: Mapping[str, str] = field(default_factory=dict)
    """Dotted field name to its type as the schema has it: "number", "integer", "string", "boolean", "bytes", and
    these with "[]" for lists. Fields that the schema cannot express (matrices, mixed types) are not here."""
    schema: Mapping[str, Any] = field(default_factory=dict)
    """The JSON Schema, merged over all segments; empty for other schema encodings."""
    encoding: str = "json"
    """How its messages are encoded."""
    description: str | None = None
    tags: tuple[str, ...] = ()
    metadata: Mapping[str, Any] = field(default_factory=dict)

    @property
    def duration(self) -> float:
        """From the first row to the last, in s."""
        return 0.0 if self.start is None or self.end is None else self.end - self.start

    @property
    def rate(self) -> float:
        """Rows a second between the first and the last; 0.0 where that is undefined."""
        return (self.count - 1) / self.duration if self.duration > 0 else 0.0


def describe(files: Sequence[File], topic: str) -> tuple[str | None, tuple[str, ...], dict[str, Any]]:
    """Return a topic's description, tags and metadata: what was said last counts."""
    said: dict[str, str] = {}
    for _, channel in counts.channels(files, topic):
        said.update({key: text for key, text in channel.metadata.items() if key in _DESCRIBING})
    for file in files:
        if not any(entry.name == TOPIC_RECORD for entry in file.index.metadata):
            continue
        for record in file.metadata():
            if record.name == TOPIC_RECORD and record.values.get("topic") == topic:
                said.update({key: text for key, text in record.values.items() if key in _DESCRIBING})
    tags = _loads(said.get("tags", "[]"), [])
    metadata = _loads(said.get("metadata", "{}"), {})
    return (
        said.get("description"),
        tuple(str(tag) for tag in tags) if isinstance(tags, list) else (),
        metadata if isinstance(metadata, dict) else {},
    )


def info(files: Sequence[File], topic: str) -> TopicInfo:
    """Sum up a topic."""
    description, tags, metadata = describe(files, topic)
    found = counts.channels(files, topic)
    merged = schemas.read(found)
    start, end = counts.time_range(files, topic)
    return TopicInfo(
        name=topic,
        kind=counts.kind(files, topic),
        count=counts.count(files, topic),
        start=start,
        end=end,
        fields=schemas.field_types(merged),
        schema=merged,
        encoding=found[-1][1].message_encoding if found else "json",
        description=description,
        tags=tags,
        metadata=metadata,
    )


def _loads(text: str | bytes, default: Any) -> Any:
    try:
        return orjson.loads(text)
    except orjson.JSONDecodeError:
        return default
