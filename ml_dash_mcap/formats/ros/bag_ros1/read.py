"""A ROS 1 bag (http://wiki.ros.org/Bags/Format/2.0), read a chunk at a time."""

from __future__ import annotations

import bz2
import os
import struct
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import lz4.frame
import numpy as np
import numpy.typing as npt

from ....errors import ConversionWarning, DamagedFileError
from ....mcap.message import Connection, MessageBlock, Payload

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

_MD5_OF_NOTHING = "d41d8cd98f00b204e9800998ecf8427e"
"""Of a type without fields, whose definition may be an empty text."""

Fields = Mapping[str, bytes]
Numbers = npt.NDArray[np.int64]


class Ros1Bag:
    """A ROS 1 bag, which is one file."""

    format = "rosbag1"
    distro = ""
    version = 0
    text = ""
    custom: Mapping[str, str] = {}
    """Such bags have no place for it."""

    def __init__(self, path: Path, *, salvages: bool = False) -> None:
        """Open a bag; the arguments and errors are those of `Ros1File`."""
        self._file = Ros1File(path, salvages=salvages)
        self.channels = list(dict.fromkeys(self._file.channels.values()))
        self.count = self._file.count

    def files(self) -> Iterator[Ros1File]:
        """Yield its file."""
        yield self._file

    def close(self) -> None:
        """Close its file. May be called twice."""
        self._file.close()


class _Chunk(NamedTuple):
    """What a bag's index says of a chunk."""

    place: int
    counts: Mapping[int, int]
    """Connection to its messages."""


class _BrokenError(Exception):
    """A record is not what it should be; the message says what it is."""


class Ros1File:
    """An opened ROS 1 bag. Memory holds its index of chunks, and a few chunks."""

    def __init__(self, path: Path, *, salvages: bool = False) -> None:
        """Open a bag.

        Args:
            path: Of the bag.
            salvages: Whether to leave out what is damaged, and note it in `losses`. A bag without an index, such as one
                that is still being written (`.bag.active`), is walked then.

        Raises:
            DamagedFileError: It is no ROS 1 bag, is cut, or has no index.
        """
        self.name = path.name
        self.losses: list[str] = []
        self.corrections: list[str] = []
        """What the bag says wrongly of itself, in words; nothing is lost by it."""
        self._path = path
        self._salvages = salvages
        self._file = path.open("rb")
        self.channels: dict[int, Connection] = {}
        """All connections, numbered from 1 on; a bag may number them as it likes, up to 2**32."""
        self._numbers: dict[int, int] = {}
        """The bag's numbers of connections, to ours."""
        self._refused: set[int] = set()
        """Connections that cannot be read, and whose messages stay behind."""
        self._chunks: list[_Chunk] = []
        try:
            self._size = os.fstat(self._file.fileno()).st_size
            self._begin()
            try:
                self._read_index()
            except _BrokenError as error:
                if not salvages:
                    raise
                self.corrections.append(f"{path}: {error}; its records were walked")
                self._walk()
        except _BrokenError as error:
            self.close()
            raise DamagedFileError(path, 0, f"this ROS 1 bag cannot be read: {error}") from error
        except BaseException:
            self.close()
            raise

    @property
    def count(self) -> int:
        """Messages in all."""
        return sum(sum(chunk.counts.values()) for chunk in self._chunks)

    def blocks(self, wanted: Collection[int]) -> Iterator[MessageBlock]:
        """Yield the messages of some connections, in the order of the file.

        Raises:
            DamagedFileError: A chunk cannot be read.
        """
        mine = [chunk for chunk in self._chunks if chunk.counts.keys() & wanted]
        for chunk in sorted(mine, key=lambda one: one.place):
            try:
                block = self._block(chunk, wanted)
            except (_BrokenError, ValueError, OverflowError) as error:
                what = f"the chunk at byte {chunk.place} of this ROS 1 bag cannot be read: {error}"
                if not self._salvages:
                    raise DamagedFileError(self._path, chunk.place, what) from error
                self.losses.append(f"{self._path}, byte {chunk.place}: {what}")
                continue
            if len(block):
                yield block

    def close(self) -> None:
        """Close the file. May be called twice."""
        self._file.close()

    def _begin(self) -> None:
        head = self._file.read(len(MAGIC) + len(_VERSION))
        if head != MAGIC + _VERSION:
            what = f"its version is {head[len(MAGIC) :].strip()!r}, not 2.0" if head.startswith(MAGIC) else f"{head!r}"
            raise _BrokenError(f"it starts with {what}")

    def _read_index(self) -> None:
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
            self._connect(fields, data)
        known = {conn for conn, number in self._numbers.items() if number in self.channels} | self._refused
        for _ in range(chunks):
            fields, data = self._record(_CHUNK_INFO)
            place = _number(fields, "chunk_pos", 8)
            pairs = np.frombuffer(data[: len(data) // 8 * 8], "<u4").reshape(-1, 2).tolist()
            counts = {self._ours(conn): count for conn, count in pairs}
            if len(data) % 8 or not len(counts) == len(pairs) == _number(fields, "count", 4):
                raise _BrokenError(f"what its index says of the chunk at byte {place} contradicts itself")
            if not known.issuperset(conn for conn, _ in pairs):
                raise _BrokenError(f"its index names a connection of the chunk at byte {place} that it does not have")
            self._chunks.append(_Chunk(place, counts))

    def _ours(self, conn: int) -> int:
        return self._numbers.setdefault(conn, len(self._numbers) + 1)

    def _connect(self, fields: Fields, data: bytes) -> None:
        """Take in a connection, unless it is known."""
        conn = _number(fields, "conn", 4)
        number = self._ours(conn)
        if number in self.channels or conn in self._refused:
            return
        try:
            said = _parsed(data)
            self.channels[number] = _channel(fields, said)
        except _BrokenError as error:
            if not self._salvages:
                raise
            self._refused.add(conn)
            loss = f"{self._path}: connection {conn} cannot be read: {error}"
            if loss not in self.losses:
                self.losses.append(loss)
            return
        odd = [name for name, value in said.items() if name != "message_definition" and not _is_text(value)]
        if odd or not _is_text(fields["topic"]):
            which = ", ".join(map(repr, dict.fromkeys([*odd, *(() if _is_text(fields["topic"]) else ("topic",))])))
            warnings.warn(
                f"{self._path}: connection {conn}, of topic {self.channels[number].topic!r}, says what is no UTF-8 in "
                f"{which}; bytes that are no text have become U+FFFD",
                ConversionWarning,
                stacklevel=2,
            )

    def _walk(self) -> None:
        """Find chunks and connections without the index, up to where the file is cut.

        A chunk with broken content costs nothing behind it: its record says where the next one starts.
        """
        for found in (self.channels, self._numbers, self._refused, self._chunks):
            found.clear()
        self._file.seek(len(MAGIC) + len(_VERSION))
        while (place := self._file.tell()) < self._size:
            try:
                fields, data = self._record(None)
            except _BrokenError as error:
                self.losses.append(f"{self._path}, byte {place}: {error}")
                return
            try:
                if fields.get("op") == bytes([_CONNECTION]):
                    self._connect(fields, data)
                elif fields.get("op") == bytes([_CHUNK]):
                    content = _unpacked(data, _field(fields, "compression"), _number(fields, "size", 4))
                    _, owners, _ = self._walked(content, place)
                    numbers, counts = np.unique(np.array(owners, np.int64), return_counts=True)
                    self._chunks.append(_Chunk(place, dict(zip(numbers.tolist(), counts.tolist(), strict=True))))
            except (_BrokenError, ValueError, OverflowError) as error:
                self.losses.append(f"{self._path}, byte {place}: {error}")

    def _walked(self, content: bytes, place: int) -> tuple[list[int], list[int], list[int]]:
        """Walk a chunk's records: the times (ns), connections and places of its messages. Takes in its connections.

        What lies behind a record that is broken is noted as lost, and left out.
        """
        times, owners, places = [], [], []
        at = 0
        while at < len(content):
            try:
                fields, data, end = _record_at(content, at)
                if fields.get("op") == bytes([_CONNECTION]):
                    self._connect(fields, data)
                elif fields.get("op") == bytes([_MESSAGE]):
                    sec, nsec = struct.unpack("<II", _field(fields, "time", 8))
                    owner = self._ours(_number(fields, "conn", 4))
                    times.append(sec * 1_000_000_000 + nsec)
                    owners.append(owner)
                    places.append(at)
            except _BrokenError as error:
                loss = f"{self._path}, byte {place}: in this chunk, {error}, and what lies behind it"
                if loss not in self.losses:  # a chunk is walked again when it is read
                    self.losses.append(loss)
                break
            at = end
        return times, owners, places

    def _record(self, op: int | None) -> tuple[Fields, bytes]:
        """Read the next record, which must be of a kind; None for any."""
        fields = _parsed(self._sized(_HEADER_BYTES))
        if op is not None and fields.get("op") != bytes([op]):
            raise _BrokenError(f"a record before byte {self._file.tell()} is not what the index says")
        return fields, self._sized(_RECORD_BYTES)

    def _has_more(self, op: int) -> bool:
        """Whether the next record, which is not read, is of a kind."""
        if self._size - self._file.tell() < 8:
            return False
        return _parsed(self._sized(_HEADER_BYTES)).get("op") == bytes([op])

    def _sized(self, most: int) -> bytes:
        head = self._file.read(4)
        size = _LENGTH.unpack(head)[0] if len(head) == 4 else self._size
        if size > most or size > self._size - self._file.tell():
            raise _BrokenError(f"it ends, after {self._size} bytes, before its records do; `rosbag reindex` may help")
        return self._file.read(size)

    def _block(self, chunk: _Chunk, wanted: Collection[int]) -> MessageBlock:
        """Return the messages of some connections in a chunk."""
        if chunk.place > self._size:
            raise _BrokenError("the file ends before it")
        self._file.seek(chunk.place)
        fields, packed = self._record(_CHUNK)
        data = _unpacked(packed, _field(fields, "compression"), _number(fields, "size", 4))
        try:
            return _picked(data, *self._indexed(chunk), wanted)
        except _BrokenError:
            if not self._salvages:
                raise
        times, owners, places = (np.array(one, np.int64) for one in self._walked(data, chunk.place))
        return _picked(data, times, owners, places, wanted)

    def _indexed(self, chunk: _Chunk) -> tuple[Numbers, Numbers, Numbers]:
        """Read the indexes that lie behind a chunk: times (ns), connections and places of its messages."""
        found, owners = [], []
        for _ in chunk.counts:
            fields, entries = self._record(_INDEX)
            conn = _number(fields, "conn", 4)
            number = self._ours(conn)
            if number not in self.channels:
                raise _BrokenError(f"it has messages of connection {conn}, which is not in the bag's index")
            count = len(entries) // _ENTRY.itemsize
            if len(entries) % _ENTRY.itemsize or not count == _number(fields, "count", 4) == chunk.counts.get(number):
                raise _BrokenError(f"the indexes do not agree how many messages of connection {conn} it has")
            found.append(np.frombuffer(entries, _ENTRY))
            owners.append(number)
        if len(set(owners)) < len(owners) or self._has_more(_INDEX):
            raise _BrokenError("the indexes do not agree which connections it has messages of")
        whole = np.concatenate([np.zeros(0, _ENTRY), *found])
        times: Numbers = whole["sec"].astype(np.int64) * 1_000_000_000 + whole["nsec"]
        return times, np.repeat(np.array(owners, np.int64), list(map(len, found))), whole["offset"].astype(np.int64)


def _picked(data: bytes, times: Numbers, owners: Numbers, places: Numbers, wanted: Collection[int]) -> MessageBlock:
    """Return the messages of some connections in a chunk, in the order in which they lie there."""
    chosen = np.isin(owners, list(wanted))
    order = np.flatnonzero(chosen)[np.argsort(places[chosen], kind="stable")]
    times_ns = times[order].astype(np.uint64)
    payloads = _payloads(data, places[order])
    return MessageBlock(owners[order], times_ns, times_ns, np.zeros(len(order), np.uint32), payloads)


def _record_at(data: bytes, at: int) -> tuple[Fields, bytes, int]:
    """Return the fields and the data of the record at a place in a chunk, and where it ends."""
    try:
        (head,) = _LENGTH.unpack_from(data, at)
        (size,) = _LENGTH.unpack_from(data, at + 4 + head)
    except struct.error as error:
        raise _BrokenError(f"a record at byte {at} of it is cut") from error
    start = at + 8 + head
    if start + size > len(data):
        raise _BrokenError(f"a record at byte {at} of it is cut")
    return _parsed(data[at + 4 : at + 4 + head]), data[start : start + size], start + size


def _payloads(data: bytes, places: Numbers) -> list[Payload]:
    """Return the messages whose records start at some places in a chunk.

    Raises:
        _BrokenError: Something else is there.
    """
    if not len(places):
        return []
    if int(places.max()) + 8 > len(data):
        raise _BrokenError(f"a message at byte {int(places.max())} of it lies behind its end")
    lengths = np.ndarray((len(data) - 3,), "<u4", data, strides=(1,))
    starts = places + 8 + lengths[places].astype(np.int64)
    if int(starts.max()) > len(data):
        raise _BrokenError(f"a message at byte {int(places[np.argmax(starts)])} of it lies behind its end")
    ends = starts + lengths[starts - 4]
    if int(ends.max()) > len(data):
        raise _BrokenError(f"there is no whole message at byte {int(places[np.argmax(ends)])} of it")
    if not _are_messages(data, places, starts):
        for place, start in zip(places.tolist(), starts.tolist(), strict=True):
            if data.find(_MESSAGE_OP, place, start) < 0:
                raise _BrokenError(f"there is no whole message at byte {place} of it")
    view = memoryview(data)
    return [view[start:end] for start, end in zip(starts.tolist(), ends.tolist(), strict=True)]


def _are_messages(data: bytes, places: Numbers, starts: Numbers) -> bool:
    """Whether the records are messages whose headers have the fields in one order, as those of one writer have."""
    at = data.find(_MESSAGE_OP, int(places[0]), int(starts[0])) - int(places[0])
    if at < 0 or bool((places + at + len(_MESSAGE_OP) > starts).any()):
        return False
    words = np.ndarray((len(data) - 3,), "<u4", data, strides=(1,))
    return bool((words[places + at] == int.from_bytes(_MESSAGE_OP, "little")).all())


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


def _channel(fields: Fields, said: Fields) -> Connection:
    """Return the channel of a connection: what its header says, but for the type and its definition, is metadata."""
    text = said.get("message_definition", b"")
    metadata = {name: _lenient(value) for name, value in said.items() if name not in ("type", "message_definition")}
    topic = _text(fields, "topic")
    is_known = bool(text) or metadata.get("md5sum") == _MD5_OF_NOTHING
    return Connection(topic, _text(said, "type"), "ros1msg" if is_known else "", text, "ros1", tuple(metadata.items()))


def _lenient(value: bytes) -> str:
    return value.decode("utf-8", "replace")


def _parsed(data: bytes) -> dict[str, bytes]:
    """Return the fields of a record's header."""
    fields, at = {}, 0
    while at < len(data):
        size = int.from_bytes(data[at : at + 4], "little")
        name, separator, value = data[at + 4 : at + 4 + size].partition(b"=")
        at += 4 + size
        if at > len(data) or not separator:
            raise _BrokenError("a record's header is broken")
        fields[_lenient(name)] = value
    return fields


def _field(fields: Fields, name: str, size: int | None = None) -> bytes:
    value = fields.get(name)
    if value is None or (size is not None and len(value) != size):
        raise _BrokenError(f"a record's header has no proper {name!r}")
    return value


def _number(fields: Fields, name: str, size: int) -> int:
    return int.from_bytes(_field(fields, name, size), "little")


def _text(fields: Fields, name: str) -> str:
    return _lenient(_field(fields, name))


def _is_text(value: bytes) -> bool:
    try:
        value.decode()
    except UnicodeDecodeError:
        return False
    return True
