"""MCAP bytes packed by hand, right or deliberately wrong: nothing here checks anything."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Mapping

MAGIC = b"\x89MCAP0\r\n"


def record(opcode: int, content: bytes, length: int | None = None) -> bytes:
    """A record; `length` is what it says of itself, if that is not so."""
    return struct.pack("<BQ", opcode, len(content) if length is None else length) + content


def text(value: str | bytes, length: int | None = None) -> bytes:
    """A text with its length before it."""
    data = value if isinstance(value, bytes) else value.encode()
    return struct.pack("<I", len(data) if length is None else length) + data


def numbers(values: Mapping[int, int]) -> bytes:
    """A map of 2-byte integers to 8-byte integers."""
    return struct.pack("<I", 10 * len(values)) + b"".join(struct.pack("<HQ", *pair) for pair in values.items())


def header(library: str = "tests") -> bytes:
    """The start of a file."""
    return MAGIC + record(1, text("") + text(library))


def schema(number: int = 1, data: bytes = b'{"type":"object"}') -> bytes:
    """A Schema record."""
    return record(3, struct.pack("<H", number) + text("t") + text("jsonschema") + text(data))


def channel(number: int = 1, topic: str = "t", encoding: str = "json", metadata: bytes = text(b"")) -> bytes:
    """A Channel record."""
    return record(4, struct.pack("<HH", number, 1) + text(topic) + text(encoding) + metadata)


def message(number: int, time_ns: int, payload: bytes, *, length: int | None = None) -> bytes:
    """A Message record; `length` is what it says of itself, if that is not so."""
    return record(5, struct.pack("<HIQQ", number, 0, time_ns, time_ns) + payload, length)


def chunk(
    data: bytes,
    compression: str = "",
    *,
    size: int | None = None,
    crc: int = 0,
    times: tuple[int, int] = (1, 100),
    length: int | None = None,
) -> bytes:
    """A Chunk record of bytes that are compressed already.

    Args:
        data: The records, compressed.
        compression: How.
        size: What it says its uncompressed size is; that of `data` by default.
        crc: Of the records; 0 for none.
        times: What it says its first and last log times are.
        length: What it says the length of `data` is.
    """
    head = struct.pack("<QQQI", *times, len(data) if size is None else size, crc) + text(compression)
    return record(6, head + struct.pack("<Q", len(data) if length is None else length) + data)


def message_index(number: int, entries: Iterable[tuple[int, int]]) -> bytes:
    """A MessageIndex record of (time, offset) pairs."""
    packed = b"".join(struct.pack("<QQ", *entry) for entry in entries)
    return record(7, struct.pack("<H", number) + text(packed))


def chunk_index(
    offset: int,
    length: int,
    *,
    indexes: Mapping[int, int] | None = None,
    index_length: int = 0,
    compression: str | bytes = "",
    sizes: tuple[int, int] = (0, 0),
    times: tuple[int, int] = (1, 100),
) -> bytes:
    """A ChunkIndex record; `sizes` are compressed and uncompressed."""
    return record(
        8,
        struct.pack("<QQQQ", *times, offset, length)
        + numbers(indexes or {})
        + struct.pack("<Q", index_length)
        + text(compression)
        + struct.pack("<QQ", *sizes),
    )


def metadata(name: str = "n", values: bytes = text(b""), length: int | None = None) -> bytes:
    """A Metadata record."""
    return record(12, text(name) + values, length)


def metadata_index(offset: int, length: int) -> bytes:
    """A MetadataIndex record."""
    return record(13, struct.pack("<QQ", offset, length) + text("n"))


def attachment_index(offset: int, length: int, size: int = 0) -> bytes:
    """An AttachmentIndex record."""
    return record(10, struct.pack("<QQQQQ", offset, length, 1, 1, size) + text("a") + text("x"))


def summary_offset(opcode: int, start: int, length: int) -> bytes:
    """A SummaryOffset record."""
    return record(14, struct.pack("<BQQ", opcode, start, length))


def statistics(
    counts: Mapping[int, int], *, chunks: int = 1, attachments: int = 0, records: int = 0, messages: int | None = None
) -> bytes:
    """A Statistics record."""
    total = sum(counts.values()) if messages is None else messages
    return record(11, struct.pack("<QHIIIIQQ", total, 1, 1, attachments, records, chunks, 1, 100) + numbers(counts))


def footer(start: int, offsets_at: int = 0, crc: int = 0) -> bytes:
    """The end of a file."""
    return record(2, struct.pack("<QQI", start, offsets_at, crc)) + MAGIC


def file(data: bytes, summary: bytes = b"", offsets: bytes = b"") -> bytes:
    """A finished file: `data` from the magic on, without its DataEnd. The summary's checksum is right."""
    data += record(15, bytes(4))
    start = len(data) if summary else 0
    at = len(data) + len(summary) if offsets else 0
    crc = zlib.crc32(summary + offsets + footer(start, at)[: -len(MAGIC) - 4])
    return data + summary + offsets + footer(start, at, crc)
