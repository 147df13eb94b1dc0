"""Recordings in the recorder's layout, written with the plain `mcap` package's parts: the readers' other side."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

from mcap.records import Channel, Header, McapRecord, Message, Metadata, Schema

from tests.support.assemble import MAGIC, Draft, bundle, written

Row = dict[str, Any]
Rows = Sequence[Row]
"""Rows with `_ts`, in the order of writing."""

OURS = "ml_dash_mcap 0.0.0"
"""The library that our recorder names in a header."""


def ns(seconds: float) -> int:
    """Round a double to nanoseconds, exactly."""
    return int(Fraction(seconds) * 10**9 + Fraction(1, 2))


def payload(row: Row) -> bytes:
    """A row as JSON, its `_ts` last."""
    fields = {name: value for name, value in row.items() if name != "_ts"}
    return json.dumps({**fields, "_ts": row["_ts"]}, separators=(",", ":")).encode()


def draft(
    chunks: Iterable[Mapping[str, Rows]],
    *,
    kinds: Mapping[str, str | None] | None = None,
    schemas: Mapping[str, Mapping[str, Any]] | None = None,
    described: Mapping[str, Mapping[str, str]] | None = None,
    metadata: Sequence[tuple[str, dict[str, str]]] = (),
    library: str = OURS,
) -> Draft:
    """A segment: schemas and channels outside the chunks, before the first chunk that needs them.

    Args:
        chunks: For each chunk, topic to rows.
        kinds: Topic to kind; "track" by default, None for a channel that does not say.
        schemas: Topic to JSON Schema.
        described: Topic to further channel metadata.
        metadata: Records, at the start of the file.
        library: For the header.
    """
    data: list[McapRecord] = [Metadata(name, values) for name, values in metadata]
    ids: dict[str, int] = {}
    for topics in chunks:
        messages: list[McapRecord] = []
        for topic, rows in topics.items():
            if topic not in ids:
                ids[topic] = len(ids) + 1
                kind = (kinds or {}).get(topic, "track")
                about = {**({} if kind is None else {"kind": kind}), **(described or {}).get(topic, {})}
                schema = json.dumps((schemas or {}).get(topic, {"type": "object"})).encode()
                data.append(Schema(id=ids[topic], data=schema, encoding="jsonschema", name=topic))
                data.append(Channel(ids[topic], topic, "json", about, ids[topic]))
            messages += [message(row, ids[topic], number) for number, row in enumerate(rows)]
        data += bundle(messages) if messages else []
    return Draft(data, header=Header("", library))


def message(row: Row, channel_id: int = 1, sequence: int = 0) -> Message:
    """A row as a message at its time."""
    return Message(channel_id, ns(row["_ts"]), payload(row), ns(row["_ts"]), sequence)


def unfinished(drafted: Draft) -> bytes:
    """A segment that is being recorded: its data section so far, without an end."""
    return MAGIC + written([drafted.header, *drafted.data])


def finished(drafted: Draft) -> bytes:
    """A segment with its end."""
    return drafted.summarise().finish()


def save(path: Path, chunks: Iterable[Mapping[str, Rows]], **how: Any) -> Path:
    """Write a segment; one whose name ends with `.active` gets no end."""
    drafted = draft(chunks, **how)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(unfinished(drafted) if path.name.endswith(".active") else finished(drafted))
    return path
