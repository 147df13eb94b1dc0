"""A small correct file, as a draft that a test can damage."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TypeVar

from mcap.records import (
    Attachment,
    Channel,
    McapRecord,
    Message,
    Metadata,
    Schema,
)

from tests.support.assemble import Draft, bundle
from tests.support.rules import problems

SHAPE = {"type": "object", "properties": {"q": {"type": "array", "items": {"type": "number"}}}}
SCHEMA = Schema(id=1, data=json.dumps(SHAPE).encode(), encoding="jsonschema", name="arm")
CHANNEL = Channel(id=1, topic="arm", message_encoding="json", metadata={}, schema_id=1)
NOTE = Metadata("ml_dash", {"prefix": "robot/run"})
PICTURE = Attachment(create_time=0, log_time=5, name="a.txt", media_type="text/plain", data=b"abc")

R = TypeVar("R", bound=McapRecord)


def row(time_ns: int, data: bytes = b'{"q":[1.5,null]}', *, channel_id: int = 1) -> Message:
    return Message(channel_id=channel_id, log_time=time_ns, data=data, publish_time=time_ns, sequence=0)


def draft(*inside: McapRecord) -> Draft:
    """A correct file of two chunks, an attachment and a metadata record; `inside` takes the place of the second chunk's records."""
    first = bundle([SCHEMA, CHANNEL, row(10), row(20)])
    return Draft([*first, PICTURE, NOTE, *bundle(inside or [row(15), row(30)])])


def the(kind: type[R], records: list[McapRecord]) -> R:
    """The first record of a kind."""
    return next(record for record in records if isinstance(record, kind))


def found(path: Path, file: Draft | bytes) -> list[str]:
    path = path / "file.mcap"
    path.write_bytes(file if isinstance(file, bytes) else file.finish())
    return problems(path)


def swap(records: list[McapRecord], old: McapRecord, *new: McapRecord) -> None:
    at = next(number for number, record in enumerate(records) if record is old)
    records[at : at + 1] = new
