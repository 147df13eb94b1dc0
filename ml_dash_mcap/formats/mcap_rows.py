"""Renders rows as an MCAP file of their own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from .. import clock
from ..codecs import json
from ..codecs.codec import Codec
from ..codecs.decode import codec_of
from ..inspect import topic_schema
from ..mcap import stored_messages
from ..mcap.chunk_writer import PackedChunk, build_block, compressor
from ..mcap.file_output import MemoryOutput
from ..mcap.file_writer import FileWriter
from ..mcap.message import CHUNK_BYTES, Connection, MessageBlock
from ..mcap.records import Channel
from ..options import RecorderOptions
from ..query import topic_messages, topic_rows
from ..query.file import File
from ..query.stored_topic import LAST_NS
from ..query.topic_part import TopicPart
from ..rows.json_text import dumps
from ..rows.plain_row import TIME_KEY

_ANYTHING = {"type": "object"}


def render(part: TopicPart) -> bytes:
    """Return a complete MCAP file, with its indexes, of a topic and time range.

    The rows of a track are merged and carry the schema of all segments; messages of other topics are copied as they
    are, unless only some columns are asked for. A topic that does not exist gives a file without channels.
    """
    writer = FileWriter(MemoryOutput())
    writer.begin()
    channels = part.stored.channels
    if channels and (part.stored.is_track or part.columns is not None):
        codec = _codec(channels)
        # The schema of some encodings is known when all rows are encoded, and stands before them.
        chunks = list(_packed(_rows(part, codec)))
        writer.add_connection(1, _connection_of_rows(part, channels, codec))
        _add(writer, chunks)
    elif channels:
        _add(writer, _packed(_messages(part, _register(writer, channels))))
    writer.write_end()
    return writer.output.data()


def _packed(blocks: Iterator[MessageBlock]) -> Iterator[PackedChunk]:
    compress = compressor(RecorderOptions())
    for block in stored_messages.joined(blocks, CHUNK_BYTES):
        yield build_block(block, compress)


def _add(writer: FileWriter[MemoryOutput], chunks: Iterable[PackedChunk]) -> None:
    for chunk in chunks:
        writer.add_chunk(chunk)


def _codec(channels: list[tuple[File, Channel]]) -> Codec:
    """Return the codec that the rows were recorded with; that of JSON where there are several, or none that encodes."""
    file, channel = channels[-1]
    codec = codec_of(channel) if len({channel.message_encoding for _, channel in channels}) == 1 else None
    if not isinstance(codec, Codec):
        return json.CODEC
    schema = file.index.schema_of(channel)
    return codec.for_channel(channel.topic, schema.data if schema is not None else b"")


def _connection_of_rows(part: TopicPart, channels: list[tuple[File, Channel]], codec: Codec) -> Connection:
    file, channel = channels[-1]
    schema = file.index.schema_of(channel)
    if codec.follows_shapes:
        name = schema.name if schema is not None else part.topic
        text = dumps(topic_schema.read(channels) or _ANYTHING)
    else:
        name, text = codec.schema_name(part.topic), codec.schema(None, part.topic)
    metadata = {key: text for _, channel in channels for key, text in channel.metadata.items()}
    return Connection(part.topic, name, codec.schema_encoding, text, codec.message_encoding, tuple(metadata.items()))


def _rows(part: TopicPart, codec: Codec) -> Iterator[MessageBlock]:
    """Encode rows, about as many at a time as a chunk has."""
    times_ns: list[int] = []
    payloads: list[bytes] = []
    size = count = 0
    for row in part.rows():
        # The double nearest to the last time is 2**64 ns, which MCAP cannot hold.
        times_ns.append(min(clock.to_nanoseconds(row[TIME_KEY]), LAST_NS))
        payloads.append(codec.encode_read(row))
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


def _messages(part: TopicPart, ids: dict[tuple[str, int], int]) -> Iterator[MessageBlock]:
    start_ns, end_ns = topic_rows.to_ns_range(part.start, part.end)
    skip, most = part.start_index, LAST_NS if part.limit is None else part.limit
    for batch in topic_messages.read(part.stored, start_ns, end_ns):
        channel_ids = np.array([ids[(origin.file.source.name, origin.channel.id)] for origin in batch.origins])
        channels = channel_ids[batch.origin_of]
        block = MessageBlock(channels, batch.times_ns, batch.published_ns, batch.sequences, [*batch.payloads])
        times_s = np.array(clock.to_seconds_each(batch.times_ns.tolist()))
        in_range = np.flatnonzero((times_s >= part.start) & (times_s <= part.end))
        wanted = in_range[skip : skip + most]
        skip, most = max(skip - len(in_range), 0), most - len(wanted)
        yield from stored_messages.in_pieces(block.pick(wanted))
