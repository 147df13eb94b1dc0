"""The layout of ROS 1 bags, shared by reader and writer (http://wiki.ros.org/Bags/Format/2.0).

A bag is a list of records. A record is a header of named fields and some data, each behind its size.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from struct import Struct
from typing import NamedTuple

import numpy as np

from .... import clock

MAGIC = b"#ROSBAG V"
VERSION = b"2.0\n"

BAG_HEADER_BYTES = 4096
"""The size of the bag's header with its padding. The fixed size allows to write it again when the end is known."""

INDEX_VERSION = 1

LENGTH = Struct("<I")
"""The size that stands before a header, a field or data, in bytes."""

ENTRY = np.dtype([("sec", "<u4"), ("nsec", "<u4"), ("offset", "<u4")])
"""An entry of an index behind a chunk: the time of a message, and the place of its record in the chunk's content."""

_COUNT = np.dtype([("connection", "<u4"), ("count", "<u4")])
"""The number of a chunk's messages on one connection."""


class Op(IntEnum):
    """Kinds of records, by the value of their field `op`."""

    MESSAGE = 2
    BAG = 3
    INDEX = 4
    CHUNK = 5
    CHUNK_INFO = 6
    CONNECTION = 7

    @property
    def value_bytes(self) -> bytes:
        """The value as the field has it."""
        return bytes([self])


MESSAGE_OP = b"op=" + Op.MESSAGE.value_bytes

MESSAGE_HEAD = np.dtype(
    [
        ("length", "<u4"),
        ("op", "u1", 8),
        ("conn_key", "u1", 9),
        ("conn", "<u4"),
        ("time_key", "u1", 9),
        ("sec", "<u4"),
        ("nsec", "<u4"),
        ("size", "<u4"),
    ]
)
"""The head of a message as we write it. Other writers may put the fields in another order."""

Fields = Mapping[str, bytes]
"""The fields of a record's header, by name."""


class BrokenRecordError(Exception):
    """A record is not what it should be; the message says what it is."""


class BagHeader(NamedTuple):
    """The first record: where the index lies and what is in it."""

    index_place: int
    connections: int
    chunks: int

    def record(self) -> bytes:
        """Return the record, padded."""
        numbers = {"index_pos": u64(self.index_place), "conn_count": u32(self.connections)}
        header = fields_bytes({"op": Op.BAG.value_bytes, **numbers, "chunk_count": u32(self.chunks)})
        padding = BAG_HEADER_BYTES - 2 * LENGTH.size - len(header)
        return u32(len(header)) + header + u32(padding) + b" " * padding

    @classmethod
    def parse(cls, fields: Fields) -> BagHeader:
        """Read the record's header."""
        return cls(number(fields, "index_pos", 8), number(fields, "conn_count", 4), number(fields, "chunk_count", 4))


class ChunkHeader(NamedTuple):
    """Before the packed content of a chunk."""

    compression: str
    size: int
    """Of the content, in bytes."""

    def record(self, packed: bytes) -> bytes:
        """Return the record of a chunk."""
        return record(Op.CHUNK, {"compression": self.compression.encode(), "size": u32(self.size)}, packed)

    @classmethod
    def parse(cls, fields: Fields) -> ChunkHeader:
        """Read the record's header."""
        return cls(text(fields, "compression"), number(fields, "size", 4))


class IndexHeader(NamedTuple):
    """Before the entries of one connection's messages in a chunk."""

    connection: int
    messages: int

    def record(self, entries: bytes) -> bytes:
        """Return the record of an index."""
        numbers = {"conn": u32(self.connection), "count": u32(self.messages)}
        return record(Op.INDEX, {"ver": u32(INDEX_VERSION), **numbers}, entries)

    @classmethod
    def parse(cls, fields: Fields) -> IndexHeader:
        """Read the record's header."""
        return cls(number(fields, "conn", 4), number(fields, "count", 4))


class ChunkInfo(NamedTuple):
    """The entry of a chunk in the bag's index."""

    place: int
    counts: Mapping[int, int]
    """Connections to their messages in it."""
    first_ns: int = 0
    last_ns: int = 0

    def record(self) -> bytes:
        """Return the record."""
        times = {"start_time": _time(self.first_ns), "end_time": _time(self.last_ns)}
        fields = {"ver": u32(INDEX_VERSION), "chunk_pos": u64(self.place), **times, "count": u32(len(self.counts))}
        return record(Op.CHUNK_INFO, fields, np.array([*self.counts.items()], _COUNT).tobytes())

    @classmethod
    def parse(cls, fields: Fields, data: bytes) -> ChunkInfo:
        """Read the record, but for its times, which nobody needs."""
        place = number(fields, "chunk_pos", 8)
        pairs = np.frombuffer(data[: len(data) // _COUNT.itemsize * _COUNT.itemsize], _COUNT).tolist()
        counts = dict(pairs)
        if len(data) % _COUNT.itemsize or not len(counts) == len(pairs) == number(fields, "count", 4):
            raise BrokenRecordError(f"what its index says of the chunk at byte {place} contradicts itself")
        return cls(place, counts)


def record(op: Op, fields: Mapping[str, bytes], data: bytes) -> bytes:
    """Return a record."""
    header = fields_bytes({"op": op.value_bytes, **fields})
    return b"".join((u32(len(header)), header, u32(len(data)), data))


def fields_bytes(fields: Mapping[str, bytes]) -> bytes:
    """Return fields as a header has them."""
    texts = [name.encode() + b"=" + value for name, value in fields.items()]
    return b"".join(u32(len(text)) + text for text in texts)


def parse_fields(data: bytes) -> dict[str, bytes]:
    """Return the fields of a record's header.

    Raises:
        BrokenRecordError: There is something else.
    """
    fields, at = {}, 0
    while at < len(data):
        size = int.from_bytes(data[at : at + LENGTH.size], "little")
        at += LENGTH.size
        name, separator, value = data[at : at + size].partition(b"=")
        at += size
        if at > len(data) or not separator:
            raise BrokenRecordError("a record's header is broken")
        fields[lenient_text(name)] = value
    return fields


def field(fields: Fields, name: str, size: int | None = None) -> bytes:
    """Return a field of a header.

    Raises:
        BrokenRecordError: It is missing, or has another size than it must have.
    """
    value = fields.get(name)
    if value is None or (size is not None and len(value) != size):
        raise BrokenRecordError(f"a record's header has no proper {name!r}")
    return value


def number(fields: Fields, name: str, size: int) -> int:
    """Return a field that is a number of so many bytes."""
    return int.from_bytes(field(fields, name, size), "little")


def text(fields: Fields, name: str) -> str:
    """Return a field that is a text."""
    return lenient_text(field(fields, name))


def lenient_text(value: bytes) -> str:
    """Return a text. Bytes that are not UTF-8 become U+FFFD."""
    return value.decode("utf-8", "replace")


def u32(value: int) -> bytes:
    """Return a number in 4 bytes."""
    return LENGTH.pack(value)


def u64(value: int) -> bytes:
    """Return a number in 8 bytes."""
    return value.to_bytes(8, "little")


def _time(time_ns: int) -> bytes:
    seconds, nanoseconds = divmod(time_ns, clock.NS_PER_S)
    return u32(seconds) + u32(nanoseconds)
