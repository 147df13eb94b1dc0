"""What mcap's own reader finds in a run's folder, so that our reader never vouches for our writer alone."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cbor2
from mcap.reader import McapReader, make_reader
from mcap.records import Channel, Schema

from tests.support import proto_rows

Row = dict[str, Any]


def segments(folder: Path) -> list[Path]:
    """The finished segments, in the order of writing."""
    return sorted(folder.glob("*.mcap"))


def rows(folder: Path) -> dict[str, list[Row]]:
    """By topic, the rows as they are in the files, those of each segment in time order."""
    return {topic: [row for _, row in listed] for topic, listed in timed_rows(folder).items()}


def timed_rows(folder: Path) -> dict[str, list[tuple[int, Row]]]:
    """By topic, the rows as they are in the files, each behind the log time of its message, in ns."""
    found: dict[str, list[tuple[int, Row]]] = {}
    for reader in _readers(folder):
        for schema, channel, message in reader.iter_messages(log_time_order=True):
            found.setdefault(channel.topic, []).append((message.log_time, _row(schema, channel, message.data)))
    return found


def _row(schema: Schema | None, channel: Channel, payload: bytes) -> Row:
    if channel.message_encoding == "protobuf":
        assert schema is not None
        return proto_rows.row_of(schema.data, schema.name, payload)
    row: Row = {"json": json.loads, "cbor": cbor2.loads}[channel.message_encoding](payload)
    return row


def payloads(folder: Path) -> Iterator[tuple[str, bytes]]:
    """The topic and the bytes of every message."""
    for reader in _readers(folder):
        for _, channel, message in reader.iter_messages():
            yield channel.topic, message.data


def chunk_starts(segment: Path) -> list[int]:
    """Where in a segment its chunks start, in bytes."""
    with _open(segment) as reader:
        summary = reader.get_summary()
    assert summary is not None
    return sorted(index.chunk_start_offset for index in summary.chunk_indexes)


def merged(folder: Path) -> dict[str, dict[float, Row]]:
    """By topic and time stamp, the rows as a user should see them: those of one time stamp are one."""
    found: dict[str, dict[float, Row]] = {}
    for topic, listed in rows(folder).items():
        times = found.setdefault(topic, {})
        for row in listed:
            times.setdefault(row["_ts"], {}).update(row)
    return found


def counts(folder: Path) -> dict[str, int]:
    """By topic of the user's, how many rows there are after merging."""
    return {topic: len(times) for topic, times in merged(folder).items() if not topic.startswith("ml_dash/")}


def metadata(folder: Path, name: str) -> list[dict[str, str]]:
    """The values of all metadata records of a name, in the order of writing."""
    records = (record for reader in _readers(folder) for record in reader.iter_metadata())
    return [dict(record.metadata) for record in records if record.name == name]


def channel(folder: Path, topic: str) -> tuple[Channel, Schema]:
    """The channel of a topic in the last segment that has it, with its schema."""
    found: list[tuple[Channel, Schema]] = []
    for reader in _readers(folder):
        summary = reader.get_summary()
        assert summary is not None
        found += [(one, summary.schemas[one.schema_id]) for one in summary.channels.values() if one.topic == topic]
    return found[-1]


def _readers(folder: Path) -> Iterator[McapReader]:
    for path in segments(folder):
        with _open(path) as reader:
            yield reader


@contextmanager
def _open(path: Path) -> Iterator[McapReader]:
    with path.open("rb") as file:
        yield make_reader(file, validate_crcs=True)
