"""The schemas, channels and messages of a data section, in the order in which a reader meets them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from tests.support import row_types, strict_json, viewer_schema
from tests.support.records import Channel, Message, Record, Schema


@dataclass(slots=True)
class Definitions:
    """What has been defined so far; the first record of an id counts."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    shapes: dict[int, object] = field(default_factory=dict)
    """The decoded JSON Schema by schema id."""
    channels: dict[int, Channel] = field(default_factory=dict)
    topics: dict[str, Channel] = field(default_factory=dict)


def problems(records: Iterable[Record]) -> Iterator[str]:
    """Every violation in the schemas, channels and messages of a data section.

    Args:
        records: the records of the data section, those in chunks in the place of their chunk.
    """
    known = Definitions()
    for record in records:
        if isinstance(record, Schema):
            yield from _schema_problems(record, known)
        elif isinstance(record, Channel):
            yield from _channel_problems(record, known)
        elif isinstance(record, Message):
            yield from _message_problems(record, known)


def _schema_problems(schema: Schema, known: Definitions) -> Iterator[str]:
    if schema.id in known.schemas:
        yield _repetition(schema, known.schemas[schema.id], f"schema {schema.id}")
        return
    known.schemas[schema.id] = schema
    if schema.id == 0:
        yield f"{schema.where} has the id 0, which is reserved."
    if not schema.encoding or not schema.data:
        yield f"{schema.where} ({schema.name!r}) is no schema: encoding {schema.encoding!r}, {len(schema.data)} bytes of data."
    elif schema.encoding == "jsonschema":
        yield from _shape_problems(schema, known)


def _shape_problems(schema: Schema, known: Definitions) -> Iterator[str]:
    try:
        shape = strict_json.parse(schema.data)
    except ValueError as error:
        yield f"{schema.where} ({schema.name!r}) is not valid JSON: {error}."
        return
    known.shapes[schema.id] = shape
    for violation in viewer_schema.violations(shape):
        yield f"{schema.where} ({schema.name!r}) loses its topic: {violation}."


def _channel_problems(channel: Channel, known: Definitions) -> Iterator[str]:
    if channel.id in known.channels:
        yield _repetition(channel, known.channels[channel.id], f"channel {channel.id}")
        return
    known.channels[channel.id] = channel
    if channel.topic in known.topics:
        other = known.topics[channel.topic]
        yield f"{channel.where} is a second channel of the topic {channel.topic!r}, after channel {other.id} at byte {other.offset}."
    known.topics.setdefault(channel.topic, channel)
    if not channel.message_encoding:
        yield f"{channel.where} ({channel.topic!r}) has no message encoding."
    yield from _schema_of_channel_problems(channel, known.schemas)


def _schema_of_channel_problems(channel: Channel, schemas: dict[int, Schema]) -> Iterator[str]:
    schema = schemas.get(channel.schema_id)
    if channel.schema_id == 0:
        yield f"{channel.where} ({channel.topic!r}) has no schema."
    elif schema is None:
        yield f"{channel.where} ({channel.topic!r}) has the unknown schema {channel.schema_id}; no Schema before it has this id."
    elif channel.message_encoding == "json" and schema.encoding != "jsonschema":
        yield f"{channel.where} ({channel.topic!r}) holds json, but its schema's encoding is {schema.encoding!r}."


def _repetition(record: Record, first: Record, name: str) -> str:
    word = "repeats" if record.content == first.content else "contradicts"
    return f"{record.where} {word} {name}, already defined by the {first.where}."


def _message_problems(message: Message, known: Definitions) -> Iterator[str]:
    if message.chunk is None:
        yield f"{message.where} is outside a chunk, where no index can find it."
    if message.publish_time != message.log_time:
        yield f"{message.where} has publish_time {message.publish_time} and log_time {message.log_time}; they must be equal."
    channel = known.channels.get(message.channel_id)
    if channel is None:
        yield f"{message.where} is on channel {message.channel_id}, which no Channel before it defines."
    elif channel.message_encoding == "json":
        yield from _row_problems(message, channel, known.shapes.get(channel.schema_id))


def _row_problems(message: Message, channel: Channel, shape: object) -> Iterator[str]:
    try:
        row = strict_json.parse(message.data)
    except ValueError as error:
        yield f"{message.where} ({channel.topic!r}) is not valid JSON: {error}."
        return
    if not isinstance(row, dict):
        yield f"{message.where} ({channel.topic!r}) is JSON, but not an object."
        return
    for mismatch in row_types.mismatches(row, shape):
        yield f"{message.where} ({channel.topic!r}) does not match its schema: {mismatch}."
