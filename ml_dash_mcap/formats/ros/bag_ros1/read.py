"""Reads a ROS 1 bag (http://wiki.ros.org/Bags/Format/2.0), a chunk at a time."""

from __future__ import annotations

import os
import warnings
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import numpy as np

from .... import clock
from ....errors import ConversionWarning, DamagedFileError
from ....mcap.message import Connection, MessageBlock
from . import chunk_content, layout
from .chunk_content import Index
from .compression import unpacked
from .layout import BagHeader, BrokenRecordError, ChunkHeader, ChunkInfo, Fields, IndexHeader, Op

_HEADER_BYTES = 1 << 24
"""The largest header of a record. A damaged size would ask for any amount of memory."""
_RECORD_BYTES = 1 << 30
"""The largest data of a record."""

_MD5_OF_NOTHING = "d41d8cd98f00b204e9800998ecf8427e"
"""The MD5 sum of a type without fields, whose definition may be an empty text."""


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
        """Wrong statements of the bag about itself, in words; nothing is lost by them."""
        self._path = path
        self._salvages = salvages
        self._file = path.open("rb")
        self.channels: dict[int, Connection] = {}
        """All connections, numbered from 1 on; a bag may number them as it likes, up to 2**32."""
        self._numbers: dict[int, int] = {}
        """The bag's numbers of connections, to ours."""
        self._refused: set[int] = set()
        """Connections that cannot be read, and whose messages stay behind."""
        self._chunks: list[ChunkInfo] = []
        """Their connections have our numbers."""
        try:
            self._size = os.fstat(self._file.fileno()).st_size
            self._begin()
            try:
                self._read_index()
            except BrokenRecordError as error:
                if not salvages:
                    raise
                self.corrections.append(f"{path}: {error}; its records were walked")
                self._walk()
        except BrokenRecordError as error:
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
        for chunk in sorted(mine, key=lambda chunk: chunk.place):
            try:
                block = self._block(chunk, wanted)
            except (BrokenRecordError, ValueError, OverflowError) as error:
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
        magic, version = layout.MAGIC, layout.VERSION
        head = self._file.read(len(magic) + len(version))
        if head != magic + version:
            what = f"its version is {head[len(magic) :].strip()!r}, not 2.0" if head.startswith(magic) else f"{head!r}"
            raise BrokenRecordError(f"it starts with {what}")

    def _read_index(self) -> None:
        fields, _ = self._record(Op.BAG)
        if fields.get("encryptor"):
            raise BrokenRecordError(f"it is encrypted, by {fields['encryptor'].decode(errors='replace')!r}")
        header = BagHeader.parse(fields)
        # rosbag writes 0 here first and the place of the index when it closes the bag.
        if not self._file.tell() <= header.index_place <= self._size:
            what = "it has no index: it was cut, or is still being written; `rosbag reindex` makes one"
            raise BrokenRecordError(what)
        self._file.seek(header.index_place)
        for _ in range(header.connections):
            self._connect(*self._record(Op.CONNECTION))
        in_index = {conn for conn, number in self._numbers.items() if number in self.channels} | self._refused
        for _ in range(header.chunks):
            info = ChunkInfo.parse(*self._record(Op.CHUNK_INFO))
            if not in_index.issuperset(info.counts):
                what = f"its index names a connection of the chunk at byte {info.place} that it does not have"
                raise BrokenRecordError(what)
            self._chunks.append(ChunkInfo(info.place, {self._ours(conn): n for conn, n in info.counts.items()}))

    def _ours(self, conn: int) -> int:
        return self._numbers.setdefault(conn, len(self._numbers) + 1)

    def _connect(self, fields: Fields, data: bytes) -> None:
        """Take in a connection, unless it is known."""
        conn = layout.number(fields, "conn", 4)
        number = self._ours(conn)
        if number in self.channels or conn in self._refused:
            return
        try:
            header = layout.parse_fields(data)
            self.channels[number] = _connection(fields, header)
        except BrokenRecordError as error:
            if not self._salvages:
                raise
            self._refused.add(conn)
            self._lose(f"{self._path}: connection {conn} cannot be read: {error}")
            return
        odd = [name for name, value in header.items() if name != "message_definition" and not _is_text(value)]
        if not _is_text(fields["topic"]):
            odd.append("topic")
        if odd:
            warnings.warn(
                f"{self._path}: connection {conn}, of topic {self.channels[number].topic!r}, says what is no UTF-8 in "
                f"{', '.join(map(repr, dict.fromkeys(odd)))}; bytes that are no text have become U+FFFD",
                ConversionWarning,
                stacklevel=2,
            )

    def _lose(self, loss: str) -> None:
        """Note what is lost, once: connections and chunks may be read more than once."""
        if loss not in self.losses:
            self.losses.append(loss)

    def _walk(self) -> None:
        """Find chunks and connections without the index, up to the place where the file is cut.

        A chunk with broken content costs nothing behind it: its record says where the next one starts.
        """
        for collection in (self.channels, self._numbers, self._refused, self._chunks):
            collection.clear()
        self._file.seek(len(layout.MAGIC) + len(layout.VERSION))
        while (place := self._file.tell()) < self._size:
            try:
                fields, data = self._record(None)
            except BrokenRecordError as error:
                self.losses.append(f"{self._path}, byte {place}: {error}")
                return
            try:
                if fields.get("op") == Op.CONNECTION.value_bytes:
                    self._connect(fields, data)
                elif fields.get("op") == Op.CHUNK.value_bytes:
                    header = ChunkHeader.parse(fields)
                    index = self._walk_chunk(unpacked(data, *header), place)
                    numbers, counts = np.unique(index.connections, return_counts=True)
                    self._chunks.append(ChunkInfo(place, dict(zip(numbers.tolist(), counts.tolist(), strict=True))))
            except (BrokenRecordError, ValueError, OverflowError) as error:
                self.losses.append(f"{self._path}, byte {place}: {error}")

    def _walk_chunk(self, content: bytes, place: int) -> Index:
        """Return the messages of a chunk as its records tell. Takes in its connections.

        The records behind a broken record are noted as lost, and left out.
        """
        messages: list[tuple[int, int, int]] = []
        try:
            for at, fields, data in chunk_content.records(content):
                if fields.get("op") == Op.CONNECTION.value_bytes:
                    self._connect(fields, data)
                elif fields.get("op") == Op.MESSAGE.value_bytes:
                    seconds, nanoseconds = np.frombuffer(layout.field(fields, "time", 8), "<u4").tolist()
                    number = self._ours(layout.number(fields, "conn", 4))
                    messages.append((seconds * clock.NS_PER_S + nanoseconds, number, at))
        except BrokenRecordError as error:
            self._lose(f"{self._path}, byte {place}: in this chunk, {error}, and what lies behind it")
        return Index(*np.array(messages, np.int64).reshape(-1, 3).T)

    def _record(self, op: Op | None) -> tuple[Fields, bytes]:
        """Read the next record, which must be of a kind; None for any."""
        fields = layout.parse_fields(self._sized(_HEADER_BYTES))
        if op is not None and fields.get("op") != op.value_bytes:
            raise BrokenRecordError(f"a record before byte {self._file.tell()} is not what the index says")
        return fields, self._sized(_RECORD_BYTES)

    def _has_more(self, op: Op) -> bool:
        """Whether the next record, which is not read, is of a kind."""
        if self._size - self._file.tell() < 2 * layout.LENGTH.size:
            return False
        return layout.parse_fields(self._sized(_HEADER_BYTES)).get("op") == op.value_bytes

    def _sized(self, most: int) -> bytes:
        """Read what stands behind its size."""
        head = self._file.read(layout.LENGTH.size)
        size = layout.LENGTH.unpack(head)[0] if len(head) == layout.LENGTH.size else self._size
        if size > most or size > self._size - self._file.tell():
            what = f"it ends, after {self._size} bytes, before its records do; `rosbag reindex` may help"
            raise BrokenRecordError(what)
        return self._file.read(size)

    def _block(self, chunk: ChunkInfo, wanted: Collection[int]) -> MessageBlock:
        """Return the messages of some connections in a chunk."""
        if chunk.place > self._size:
            raise BrokenRecordError("the file ends before it")
        self._file.seek(chunk.place)
        fields, packed = self._record(Op.CHUNK)
        content = unpacked(packed, *ChunkHeader.parse(fields))
        try:
            return chunk_content.pick(content, self._read_chunk_index(chunk), wanted)
        except BrokenRecordError:
            if not self._salvages:
                raise
        return chunk_content.pick(content, self._walk_chunk(content, chunk.place), wanted)

    def _read_chunk_index(self, chunk: ChunkInfo) -> Index:
        """Read the indexes that lie behind a chunk, one for each connection that it has messages of."""
        entries, connections = [], []
        for _ in chunk.counts:
            fields, data = self._record(Op.INDEX)
            header = IndexHeader.parse(fields)
            number = self._ours(header.connection)
            if number not in self.channels:
                what = f"it has messages of connection {header.connection}, which is not in the bag's index"
                raise BrokenRecordError(what)
            count = len(data) // layout.ENTRY.itemsize
            if len(data) % layout.ENTRY.itemsize or not count == header.messages == chunk.counts.get(number):
                what = f"the indexes do not agree how many messages of connection {header.connection} it has"
                raise BrokenRecordError(what)
            entries.append(np.frombuffer(data, layout.ENTRY))
            connections.append(number)
        if len(set(connections)) < len(connections) or self._has_more(Op.INDEX):
            raise BrokenRecordError("the indexes do not agree which connections it has messages of")
        return chunk_content.of_entries(entries, connections)


def _connection(fields: Fields, header: Fields) -> Connection:
    """Return a connection: what its own header says, but for the type and its definition, is metadata."""
    definition = header.get("message_definition", b"")
    metadata = {
        name: layout.lenient_text(value) for name, value in header.items() if name not in ("type", "message_definition")
    }
    topic, type_ = layout.text(fields, "topic"), layout.text(header, "type")
    is_known = bool(definition) or metadata.get("md5sum") == _MD5_OF_NOTHING
    return Connection(topic, type_, "ros1msg" if is_known else "", definition, "ros1", tuple(metadata.items()))


def _is_text(value: bytes) -> bool:
    try:
        value.decode()
    except UnicodeDecodeError:
        return False
    return True
