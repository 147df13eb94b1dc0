"""The bytes of MCAP records (https://mcap.dev/spec#records), for everything but rows.

The record classes of the `mcap` package do the serialising; what is here adds the two that must be fast, and the
layout of a Message, which the journal and the chunk share.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, Footer, Header, McapRecord, Metadata, Schema

from ..file_names import BLOCK_OPCODE

MAGIC = b"\x89MCAP0\r\n"

MESSAGE_OPCODE = int(Opcode.MESSAGE)
MESSAGE_HEAD = 31
"""Bytes of a Message record before its payload: opcode, length, channel, sequence, log time, publish time."""
MESSAGE_LENGTH_EXCESS = 22
"""A Message record's length field counts this much more than its payload."""

pack_message_head = struct.Struct("<QHIQQ").pack
"""(length, channel id, sequence, log time, publish time) -> a Message record's head after its opcode."""

MESSAGE_HEAD_DTYPE = np.dtype(
    {
        "names": ["opcode", "length", "channel", "sequence", "log_time", "publish_time"],
        "formats": ["u1", "<u8", "<u2", "<u4", "<u8", "<u8"],
        "offsets": [0, 1, 9, 11, 15, 23],
        "itemsize": MESSAGE_HEAD,
    }
)

INDEX_ENTRY_DTYPE = np.dtype([("time", "<u8"), ("offset", "<u8")])
"""One entry of a MessageIndex record: log time (ns), offset in the uncompressed chunk."""


def to_bytes(*records: McapRecord) -> bytes:
    """Serialise records one after the other."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())


def header(library: str) -> bytes:
    """Return the bytes that a file begins with."""
    return MAGIC + to_bytes(Header(profile="", library=library))


def metadata(name: str, values: Mapping[str, str]) -> bytes:
    """Return a Metadata record."""
    return to_bytes(Metadata(name=name, metadata=dict(values)))


def schema(schema_id: int, name: str, data: bytes) -> bytes:
    """Return a Schema record of encoding `jsonschema`."""
    return to_bytes(Schema(id=schema_id, name=name, encoding="jsonschema", data=data))


def channel(channel_id: int, topic: str, metadata: Mapping[str, str]) -> bytes:
    """Return a Channel record of encoding `json`, with the schema of the same number."""
    return to_bytes(
        Channel(id=channel_id, schema_id=channel_id, topic=topic, message_encoding="json", metadata=dict(metadata))
    )


def data_end() -> bytes:
    """Return a DataEnd record; its checksum is left out, since schemas are rewritten in place."""
    return to_bytes(DataEnd(data_section_crc=0))


def footer(summary_start: int, summary_offset_start: int, summary_crc: int) -> bytes:
    """Return a Footer record."""
    return to_bytes(
        Footer(summary_start=summary_start, summary_offset_start=summary_offset_start, summary_crc=summary_crc)
    )


def chunk_head(
    start_ns: int, end_ns: int, uncompressed_size: int, crc: int, compression: str, compressed_size: int
) -> bytes:
    """Return a Chunk record up to its data (https://mcap.dev/spec#chunk-op0x06)."""
    name = compression.encode("ascii")
    body = struct.pack("<QQQII", start_ns, end_ns, uncompressed_size, crc, len(name))
    body += name + struct.pack("<Q", compressed_size)
    return struct.pack("<BQ", Opcode.CHUNK, len(body) + compressed_size) + body


def block_end(number: int) -> bytes:
    """Return the private record that follows a block's chunks."""
    return struct.pack("<BQQ", BLOCK_OPCODE, 8, number)


def message_index(channel_id: int, entries: np.ndarray) -> bytes:
    """Return a MessageIndex record (https://mcap.dev/spec#message-index-op0x07) of entries in `INDEX_ENTRY_DTYPE`."""
    array = entries.tobytes()
    return struct.pack("<BQHI", Opcode.MESSAGE_INDEX, len(array) + 6, channel_id, len(array)) + array
