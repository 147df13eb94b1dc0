"""Sums up a topic without reading its rows."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import orjson

from ..file_names import TOPIC_RECORD
from ..query import counts
from ..query.stored_topic import StoredTopic
from ..rows.dotted import flatten
from ..rows.plain_row import TIME_KEY
from ..rows.value_shapes import of_value
from . import field_shapes, message_fields, topic_schema
from .field_shapes import Field

_DESCRIBING = ("description", "tags", "metadata")


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """A topic at a glance."""

    name: str
    kind: str | None
    """"track", "log", "metric", "file" or "episode"; None in files that others wrote."""
    count: int
    """Rows, after merging those of one time stamp."""
    start: float | None
    """Time stamp of the first row, in s; None without rows."""
    end: float | None
    """Time stamp of the last row, in s; None without rows."""
    fields: Mapping[str, Field] = field(default_factory=dict)
    """Dotted field name to its type and shape, as the schema has it, or else as the first row has it; the lengths of
    lists in protobuf are those of the first row."""
    schema: Mapping[str, Any] = field(default_factory=dict)
    """The JSON Schema of the rows, merged over all segments; empty for messages of types in other languages."""
    encoding: str = "json"
    """How its messages are encoded: "json", "protobuf", "cbor", "cdr", "ros1", ..."""
    exact_fields: tuple[str, ...] = ()
    """Of rows in protobuf, the dotted names of values that some rows have in the text `_exact`, because no field of the
    message expresses them: None, empty and mixed lists, and the like. We read them where they were; other readers find
    them in that text. Empty in other encodings, and where every value has a field."""
    schema_name: str = ""
    """The type of its messages, such as "sensor_msgs/msg/JointState"; the topic's name in our own recordings."""
    description: str | None = None
    tags: tuple[str, ...] = ()
    metadata: Mapping[str, Any] = field(default_factory=dict)
    _measure: Callable[[], int] = field(default=int, repr=False, compare=False)

    @property
    def bytes(self) -> int:
        """How many bytes its messages take, uncompressed. Summed up from the message indexes when asked for."""
        return self._measure()

    @property
    def duration(self) -> float:
        """From the first row to the last, in s."""
        return 0.0 if self.start is None or self.end is None else self.end - self.start

    @property
    def rate(self) -> float:
        """Rows a second between the first and the last; 0.0 where that is undefined."""
        return (self.count - 1) / self.duration if self.duration > 0 else 0.0


def describe(topic: StoredTopic) -> tuple[str | None, tuple[str, ...], dict[str, Any]]:
    """Return a topic's description, tags and metadata; the values that were recorded last count."""
    stated: dict[str, str] = {}
    for _, channel in topic.channels:
        stated.update({key: text for key, text in channel.metadata.items() if key in _DESCRIBING})
    for file in topic.files:
        if not any(entry.name == TOPIC_RECORD for entry in file.glance.metadata):
            continue
        for record in file.metadata():
            if record.name == TOPIC_RECORD and record.values.get("topic") == topic.name:
                stated.update({key: text for key, text in record.values.items() if key in _DESCRIBING})
    tags = _loads(stated.get("tags", "[]"), [])
    metadata = _loads(stated.get("metadata", "{}"), {})
    return (
        stated.get("description"),
        tuple(str(tag) for tag in tags) if isinstance(tags, list) else (),
        metadata if isinstance(metadata, dict) else {},
    )


def info(topic: StoredTopic) -> TopicInfo:
    """Sum up a topic."""
    description, tags, metadata = describe(topic)
    channels = topic.channels
    schema = topic_schema.read(channels)
    described_fields, exact_fields = message_fields.read(channels)
    start, first_row = counts.first(topic)
    described = channels[-1][0].index.schema_of(channels[-1][1]) if channels else None
    return TopicInfo(
        name=topic.name,
        kind=topic.kind,
        count=counts.count(topic),
        start=start,
        end=None if start is None else counts.last_time(topic),
        fields=_fields(topic, topic_schema.fields(schema), described_fields, first_row),
        schema=schema,
        encoding=channels[-1][1].message_encoding if channels else "json",
        exact_fields=exact_fields,
        schema_name=described.name if described is not None else "",
        description=description,
        tags=tags,
        metadata=metadata,
        # Summing up reads all message indexes, so it is done when asked for, and once.
        _measure=functools.cache(lambda: counts.payload_bytes(StoredTopic(topic.files, topic.name))),
    )


def _fields(
    topic: StoredTopic, fields: dict[str, Field], open_fields: dict[str, Field], first_row: Mapping[str, Any] | None
) -> dict[str, Field]:
    """Return the fields of a topic.

    Args:
        topic: The topic.
        fields: As a JSON Schema has them.
        open_fields: As a descriptor has them, which leaves the first length of lists open.
        first_row: Completes what these leave open, and has those that they leave out.
    """
    fields = {**fields, **open_fields}
    if first_row is None:
        return fields
    is_inferred = bool(fields) and topic.kind is not None
    for name, value in flatten(first_row, TIME_KEY).items():
        if name == TIME_KEY or value is None:
            continue
        of_row = field_shapes.of_shape(of_value(value))
        differs = is_inferred and not _is_nested(value)  # from row to row, if the schema leaves it out
        if name in open_fields:
            fields[name] = field_shapes.completed(open_fields[name], of_row)
        else:
            fields.setdefault(name, Field("any") if differs else of_row)
    return fields


def _is_nested(value: Any) -> bool:
    """Whether a value is a list of lists or dicts, or an empty list, which an inferred schema cannot describe."""
    return isinstance(value, list) and all(isinstance(element, (list, dict)) for element in value)


def _loads(text: str | bytes, default: Any) -> Any:
    try:
        return orjson.loads(text)
    except orjson.JSONDecodeError:
        return default
