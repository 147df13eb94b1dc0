"""Rows as an MCAP file of their own."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .. import clock
from ..file_names import TRACK
from ..inspect import topic_schema
from ..mcap.chunk_writer import build_block, compressor
from ..mcap.file_writer import FileWriter
from ..mcap.message import CHUNK_BYTES, Connection, MessageBlock
from ..mcap.output import MemoryOutput
from ..mcap.records import Channel
from ..options import RecorderOptions
from ..query import counts, stored_messages, topic_messages, topic_rows
from ..query.file import File
from ..rows.encode import TIME_KEY
from ..rows.json_text import dumps, exact_as_read
from .topic_part import Row, Selection

_ANYTHING = {"type": "object"}


def render(selection: Selection) -> bytes:
    """Return a complete MCAP file, with its indexes, of a topic and time range.

    The rows of a track are merged and carry the schema of all segments; messages of other topics are copied as they
    are, unless only some columns are asked for. A topic that does not exist gives a file without channels.
    """
    writer = FileWriter(MemoryOutput())
    writer.begin()
    channels = counts.channels(selection.files, selection.topic)
    blocks: Iterator[MessageBlock] = iter(())
    if channels and (counts.kind(selection.files, selection.topic) == TRACK or selection.columns is not None):
        writer.add_connection(1, _connection_of_rows(selection, channels))
        blocks = _rows(selection)
    elif channels:
        blocks = _messages(selection, _register(writer, channels))
    compress = compressor(RecorderOptions())
    for block in stored_messages.joined(blocks, CHUNK_BYTES):
        writer.add_chunk(build_block(block, compress))
    writer.write_end()
    return writer.output.data()


def _connection_of_rows(selection: Selection, channels: list[tuple[File, Channel]]) -> Connection:
    file, channel = channels[-1]
    schema = file.index.schema_of(channel)
    name = schema.name if schema is not None else selection.topic
    merged = topic_schema.read(channels) or _ANYTHING
    metadata = {key: text for _, channel in channels for key, text in channel.metadata.items()}
    return Connection(selection.topic, name, "jsonschema", dumps(merged), "json", tuple(metadata.items()))


def _rows(selection: Selection) -> Iterator[MessageBlock]:
    """Encode rows, about as many at a time as a chunk has."""
    times_ns: list[int] = []
    payloads: list[bytes] = []
    size = count = 0
    for row in selection.rows():
        # No double is as near to the last time as 2**64, which is beyond it.
        times_ns.append(min(clock.to_nanoseconds(row[TIME_KEY]), topic_rows.LAST_NS))
        payloads.append(payload(row))
        size += len(payloads[-1])
        if size >= CHUNK_BYTES:
            yield _block(times_ns, payloads, count)
            count += len(payloads)
            times_ns, payloads, size = [], [], 0
    if payloads:
        yield _block(times_ns, payloads, count)


def _block(times_ns: list[int], payloads: list[bytes], first: int) -> MessageBlock:
    """Return rows as messages of channel 1 that are numbered from `first` on."""
    times = np.array(times_ns, np.uint64)
    sequences = np.arange(first, first + len(times)).astype(np.uint32)
    return MessageBlock(np.ones(len(times), np.int64), times, times, sequences, [*payloads])


def payload(row: Row) -> bytes:
    """Encode a row as the recorder does, `_ts` last."""
    try:
        encoded = dumps(row)
    except TypeError:  # it has bytes, or lone surrogates
        return exact_as_read(row)
    return exact_as_read(row) if b"null" in encoded else encoded  # orjson writes NaN as null


def _register(writer: FileWriter[MemoryOutput], channels: list[tuple[File, Channel]]) -> dict[tuple[str, int], int]:
    """Register each way in which the topic's messages are encoded; one channel if they all agree."""
    merged = topic_schema.read(channels)
    number_of: dict[tuple[str, str, str, bytes], int] = {}
    ids: dict[tuple[str, int], int] = {}
    for file, channel in channels:
        schema = file.index.schema_of(channel)
        name, encoding = (schema.name, schema.encoding) if schema is not None else (channel.topic, "")
        data = schema.data if schema is not None else b""
        if encoding == "jsonschema" and merged:
            data = dumps(merged)
        elif channel.message_encoding == "json" and not encoding:
            encoding, data = "jsonschema", dumps(_ANYTHING)
        key = (channel.message_encoding, name, encoding, data)
        if key not in number_of:
            number_of[key] = len(number_of) + 1
            kind = (name, encoding, data) if encoding else ("", "", b"")
            metadata = tuple(channel.metadata.items())
            connection = Connection(channel.topic, *kind, channel.message_encoding, metadata)
            writer.add_connection(number_of[key], connection)
        ids[(file.source.name, channel.id)] = number_of[key]
    return ids


def _messages(selection: Selection, ids: dict[tuple[str, int], int]) -> Iterator[MessageBlock]:
    start_ns, end_ns = topic_rows.to_ns_range(selection.low, selection.high)
    for batch in topic_messages.read(selection.files, selection.topic, start_ns, end_ns):
        channel_ids = np.array([ids[(origin.file.source.name, origin.channel.id)] for origin in batch.origins])
        channels = channel_ids[batch.origin_of]
        block = MessageBlock(channels, batch.times_ns, batch.published_ns, batch.sequences, [*batch.payloads])
        times_s = np.array(clock.to_seconds_each(batch.times_ns.tolist()))
        wanted = np.flatnonzero((times_s >= selection.low) & (times_s <= selection.high))
        yield from stored_messages.in_pieces(block.pick(wanted))
