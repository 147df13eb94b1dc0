"""A ROS 1 bag (http://wiki.ros.org/Bags/Format/2.0), read a chunk at a time."""

from __future__ import annotations

import bz2
import os
import struct
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import lz4.frame
import numpy as np
import numpy.typing as npt

from ..errors import DamagedFileError
from .bag_messages import Batch, Channel, Collector

MAGIC = b"#ROSBAG V"
_VERSION = b"2.0\n"

_BAG, _CHUNK, _CONNECTION, _MESSAGE, _INDEX, _CHUNK_INFO = 3, 5, 7, 2, 4, 6
"""The records' op codes."""

_HEADER_BYTES = 1 << 24
"""A record's header may have so many, and"""
_RECORD_BYTES = 1 << 30
"""a record, or a chunk that is unpacked, so many."""

_ENTRY = np.dtype([("sec", "<u4"), ("nsec", "<u4"), ("offset", "<u4")])
_LENGTH = struct.Struct("<I")
_MESSAGE_OP = b"op=" + bytes([_MESSAGE])

Fields = Mapping[str, bytes]


class _Chunk(NamedTuple):
    """What a bag's index says of a chunk."""

    start: tuple[int, int]
    """Of its first message, s and ns."""
    place: int
    counts: Mapping[int, int]
    """Connection to its messages."""


class _BrokenError(Exception):
    """A record is not what it should be; the message says what it is."""


class Ros1Bag:
    """An opened ROS 1 bag. Memory holds its index of chunks, and one chunk."""

    custom: Mapping[str, str] = {}
    """Such bags have no place for it."""

    def __init__(self, path: Path) -> None:
        """Open a bag.

        Raises:
            DamagedFileError: It is no ROS 1 bag, is cut, or has no index.
        """
        self._path = path
        self.losses: list[str] = []
        self._file = path.open("rb")
        try:
            self._size = os.fstat(self._file.fileno()).st_size
            self._channels: dict[int, Channel] = {}
            self._chunks: list[_Chunk] = []
            self._read_index()
        except _BrokenError as error:
            self.close()
            raise DamagedFileError(path, 0, f"this ROS 1 bag cannot be read: {error}") from error
        except BaseException:
            self.close()
            raise

    @property
    def channels(self) -> list[Channel]:
        """All channels."""
        return list(self._channels.values())

    @property
    def count(self) -> int:
        """Messages in all."""
        return sum(sum(chunk.counts.values()) for chunk in self._chunks)

    def batches(self, wanted: Collection[Channel]) -> Iterator[Batch]:
        """Yield the messages of some channels, the chunks by their first time, and within them each channel's by time.

        Raises:
            DamagedFileError: A chunk cannot be read.
        """
        collector = Collector()
        numbers = {number for number, channel in self._channels.items() if channel in wanted}
        for chunk in sorted(self._chunks, key=lambda one: (one.start, one.place)):
            if not numbers & chunk.counts.keys():
                continue
            try:
                found = self._messages(chunk, numbers)
            except (_BrokenError, ValueError, OverflowError) as error:
                what = f"the chunk at byte {chunk.place} of this ROS 1 bag cannot be read: {error}"
                raise DamagedFileError(self._path, chunk.place, what) from error
            for time_ns, number, payload in found:
                channel = self._channels[number]
                yield from collector.add(channel.topic, channel, time_ns, payload)
        yield from collector.rest()

    def close(self) -> None:
        """Close the file. May be called twice."""
        self._file.close()

    def _read_index(self) -> None:
        head = self._file.read(len(MAGIC) + len(_VERSION))
        if head != MAGIC + _VERSION:
            what = f"its version is {head[len(MAGIC) :].strip()!r}, not 2.0" if head.startswith(MAGIC) else f"{head!r}"
            raise _BrokenError(f"it starts with {what}")
        fields, _ = self._record(_BAG)
        if fields.get("encryptor"):
            raise _BrokenError(f"it is encrypted, by {fields['encryptor'].decode(errors='replace')!r}")
        place, connections, chunks = (
            _number(fields, name, size) for name, size in (("index_pos", 8), ("conn_count", 4), ("chunk_count", 4))
        )
        if not self._file.tell() <= place <= self._size:
            raise _BrokenError("it has no index: it was cut, or is still being written; `rosbag reindex` makes one")
        self._file.seek(place)
        for _ in range(connections):
            fields, data = self._record(_CONNECTION)
            self._channels[_number(fields, "conn", 4)] = _channel(fields, _parsed(data))
        for _ in range(chunks):
            fields, data = self._record(_CHUNK_INFO)
            pairs = np.frombuffer(data[: len(data) // 8 * 8], "<u4").reshape(-1, 2).tolist()
            start = struct.unpack("<II", _field(fields, "start_time", 8))
            self._chunks.append(_Chunk(start, _number(fields, "chunk_pos", 8), dict(pairs)))

    def _record(self, op: int) -> tuple[Fields, bytes]:
        """Read the next record, which must be of a kind."""
        fields = _parsed(self._sized(_HEADER_BYTES))
        if fields.get("op") != bytes([op]):
            raise _BrokenError(f"a record before byte {self._file.tell()} is not what the index says")
        return fields, self._sized(_RECORD_BYTES)

    def _sized(self, most: int) -> bytes:
        head = self._file.read(4)
        size = _LENGTH.unpack(head)[0] if len(head) == 4 else self._size
        if size > most or size > self._size - self._file.tell():
            raise _BrokenError(f"it ends, after {self._size} bytes, before its records do; `rosbag reindex` may help")
        return self._file.read(size)

    def _messages(self, chunk: _Chunk, numbers: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        """Return the messages of some connections in a chunk, by time."""
        if chunk.place > self._size:
            raise _BrokenError("the file ends before it")
        self._file.seek(chunk.place)
        fields, packed = self._record(_CHUNK)
        data = _unpacked(packed, _field(fields, "compression"), _number(fields, "size", 4))
        found = []
        for _ in chunk.counts:
            fields, entries = self._record(_INDEX)
            number = _number(fields, "conn", 4)
            if number in numbers:
                found.append(
                    (number, np.frombuffer(entries[: len(entries) // _ENTRY.itemsize * _ENTRY.itemsize], _ENTRY))
                )
        if not found:
            return iter(())
        whole = np.concatenate([entries for _, entries in found])
        owners = np.repeat([number for number, _ in found], [len(entries) for _, entries in found])
        times: npt.NDArray[np.int64] = whole["sec"].astype(np.int64) * 1_000_000_000 + whole["nsec"]
        order = np.lexsort((whole["offset"], times))
        places = whole["offset"][order].tolist()
        payloads = [_payload(data, place) for place in places]
        return zip(times[order].tolist(), owners[order].tolist(), payloads, strict=True)


def _payload(data: bytes, at: int) -> bytes:
    """Return the message whose record starts somewhere in a chunk."""
    try:
        (head,) = _LENGTH.unpack_from(data, at)
        start = at + 8 + head
        (size,) = _LENGTH.unpack_from(data, start - 4)
    except struct.error as error:
        raise _BrokenError(f"a message at byte {at} of it lies behind its end") from error
    if start + size > len(data) or _MESSAGE_OP not in data[at : start - 4]:
        raise _BrokenError(f"there is no whole message at byte {at} of it")
    return data[start : start + size]


def _unpacked(packed: bytes, compression: bytes, size: int) -> bytes:
    """Return a chunk's content.

    Raises:
        _BrokenError: It is not so many bytes, or in a compression that is not known.
    """
    if size > _RECORD_BYTES:
        raise _BrokenError(f"it is {size} bytes, of {_RECORD_BYTES} at most")
    unpack = _UNPACKERS.get(compression)
    if unpack is None:
        raise _BrokenError(f"its compression is {compression!r}, which is not known")
    try:
        data = unpack(packed, size + 1)
    except (OSError, RuntimeError, EOFError) as error:
        raise _BrokenError(str(error)) from error
    if len(data) != size:
        raise _BrokenError(f"it is not the {size} bytes that it says")
    return data


def _bz2(packed: bytes, most: int) -> bytes:
    return bz2.BZ2Decompressor().decompress(packed, most)


def _lz4(packed: bytes, most: int) -> bytes:
    data: bytes = lz4.frame.LZ4FrameDecompressor().decompress(packed, most)
    return data


_UNPACKERS: Mapping[bytes, Callable[[bytes, int], bytes]] = {
    b"none": lambda packed, _: packed,
    b"bz2": _bz2,
    b"lz4": _lz4,
}


def _channel(fields: Fields, said: Fields) -> Channel:
    package, _, name = _text(said, "type").partition("/")
    return Channel(  # definitions may have comments in any encoding
        _text(fields, "topic"),
        f"{package}/msg/{name}",
        "ros1msg",
        _field(said, "message_definition").decode("utf-8", "replace"),
        is_ros1=True,
    )


def _parsed(data: bytes) -> dict[str, bytes]:
    """Return the fields of a record's header."""
    fields, at = {}, 0
    while at < len(data):
        size = int.from_bytes(data[at : at + 4], "little")
        name, separator, value = data[at + 4 : at + 4 + size].partition(b"=")
        at += 4 + size
        if at > len(data) or not separator:
            raise _BrokenError("a record's header is broken")
        fields[name.decode("ascii", "replace")] = value
    return fields


def _field(fields: Fields, name: str, size: int | None = None) -> bytes:
    value = fields.get(name)
    if value is None or (size is not None and len(value) != size):
        raise _BrokenError(f"a record's header has no proper {name!r}")
    return value


def _number(fields: Fields, name: str, size: int) -> int:
    return int.from_bytes(_field(fields, name, size), "little")


def _text(fields: Fields, name: str) -> str:
    try:
        return _field(fields, name).decode()
    except UnicodeDecodeError as error:
        raise _BrokenError(f"a connection's {name!r} is no UTF-8") from error
