"""Rows as an MCAP file of their own."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from io import BytesIO
from typing import TYPE_CHECKING
from zlib import crc32

from .. import clock
from ..file_names import TRACK
from ..inspect import topic_schema
from ..mcap import records
from ..mcap.record_fields import Fields
from ..mcap.records import Channel, Opcode
from ..query import counts, topic_messages, topic_rows
from ..query.file import File
from ..rows.encode import TIME_KEY
from ..rows.json_text import dumps, exact_as_read
from ..version import LIBRARY
from .topic_part import Row, Selection

if TYPE_CHECKING:
    from mcap.writer import Writer

_ANYTHING = {"type": "object"}
_FOOTER = struct.Struct("<BQQQ")


def render(selection: Selection) -> bytes:
    """Return a complete MCAP file, with its indexes, of a topic and time range.

    The rows of a track are merged and carry the schema of all segments; messages of other topics are copied as they
    are, unless only some columns are asked for. A topic that does not exist gives a file without channels.
    """
    from mcap.writer import Writer

    output = BytesIO()
    writer = Writer(output)
    writer.start(profile="", library=LIBRARY)
    found = counts.channels(selection.files, selection.topic)
    if found:
        if counts.kind(selection.files, selection.topic) == TRACK or selection.columns is not None:
            _add_rows(writer, selection, found)
        else:
            _add_messages(writer, selection, found)
    writer.finish()
    return without_empty_groups(output.getvalue())


def _add_rows(writer: Writer, selection: Selection, found: list[tuple[File, Channel]]) -> None:
    file, channel = found[-1]
    described = file.index.schema_of(channel)
    schema = topic_schema.read(found) or _ANYTHING
    name = described.name if described is not None else selection.topic
    schema_id = writer.register_schema(name, "jsonschema", dumps(schema))
    said = {key: text for _, one in found for key, text in one.metadata.items()}
    channel_id = writer.register_channel(selection.topic, "json", schema_id, said)
    for sequence, row in enumerate(selection.rows()):
        time_ns = min(clock.to_nanoseconds(row[TIME_KEY]), topic_rows.LAST_NS)  # no double is as near to it as 2**64
        writer.add_message(channel_id, time_ns, payload(row), time_ns, sequence)


def payload(row: Row) -> bytes:
    """Encode a row as the recorder does, `_ts` last."""
    try:
        encoded = dumps(row)
    except TypeError:  # it has bytes, or lone surrogates
        return exact_as_read(row)
    return exact_as_read(row) if b"null" in encoded else encoded  # orjson writes NaN as null


def _add_messages(writer: Writer, selection: Selection, found: list[tuple[File, Channel]]) -> None:
    ids = _register(writer, found)
    for channel_id, time_ns, published_ns, sequence, data in _messages(selection, ids):
        writer.add_message(channel_id, time_ns, data, published_ns, sequence)


def _register(writer: Writer, found: list[tuple[File, Channel]]) -> dict[tuple[str, int], int]:
    """Register each way in which the topic's messages are encoded; one channel if they all agree."""
    merged = topic_schema.read(found)
    known: dict[tuple[str, str, str, bytes], int] = {}
    ids: dict[tuple[str, int], int] = {}
    for file, channel in found:
        schema = file.index.schema_of(channel)
        name, encoding = (schema.name, schema.encoding) if schema is not None else (channel.topic, "")
        data = schema.data if schema is not None else b""
        if encoding == "jsonschema" and merged:
            data = dumps(merged)
        elif channel.message_encoding == "json" and not encoding:
            encoding, data = "jsonschema", dumps(_ANYTHING)
        key = (channel.message_encoding, name, encoding, data)
        if key not in known:
            schema_id = writer.register_schema(name, encoding, data) if encoding else 0
            known[key] = writer.register_channel(
                channel.topic, channel.message_encoding, schema_id, dict(channel.metadata)
            )
        ids[(file.source.name, channel.id)] = known[key]
    return ids


def _messages(selection: Selection, ids: dict[tuple[str, int], int]) -> Iterator[tuple[int, int, int, int, bytes]]:
    start_ns, end_ns = topic_rows.to_ns_range(selection.low, selection.high)
    for batch in topic_messages.read(selection.files, selection.topic, start_ns, end_ns):
        channel_ids = [ids[(origin.file.source.name, origin.channel.id)] for origin in batch.origins]
        for which, time_ns, published_ns, sequence, data in zip(
            batch.origin_of.tolist(),
            batch.times_ns.tolist(),
            batch.published_ns.tolist(),
            batch.sequences.tolist(),
            batch.payloads,
            strict=True,
        ):
            if selection.low <= clock.to_seconds(time_ns) <= selection.high:
                yield channel_ids[which], time_ns, published_ns, sequence, data


def without_empty_groups(data: bytes) -> bytes:
    """Take out the summary offsets of groups without records, which `mcap doctor` objects to and the package writes."""
    footer_at = len(data) - len(records.MAGIC) - records.FOOTER_BYTES
    footer = records.footer(Fields(data, "", 0, footer_at + records.PREFIX_BYTES))
    offsets = memoryview(data)[footer.summary_offset_start : footer_at]
    kept: list[bytes] = []
    for _, at, fields in records.split(offsets, "", 0):
        fields.raw(1 + 8)  # the group's opcode and start
        if fields.u64():
            kept.append(bytes(offsets[at : fields.at]))
    summary = data[footer.summary_start : footer.summary_offset_start] + b"".join(kept)
    offsets_at = footer.summary_offset_start if kept else 0
    head = _FOOTER.pack(
        Opcode.FOOTER, records.FOOTER_BYTES - records.PREFIX_BYTES, footer.summary_start if summary else 0, offsets_at
    )
    crc = crc32(head, crc32(summary))
    return b"".join((data[: footer.summary_start], summary, head, crc.to_bytes(4, "little"), records.MAGIC))
