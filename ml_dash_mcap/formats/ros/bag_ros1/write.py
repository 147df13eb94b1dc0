"""A ROS 1 bag, written a block of messages at a time (http://wiki.ros.org/Bags/Format/2.0)."""

from __future__ import annotations

import bz2
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import lz4.frame
import numpy as np
import numpy.typing as npt

from .... import clock
from ....errors import ConversionError
from ....mcap.message import MessageBlock
from ..bag_plan import Outlet
from ..rows_out import Sent

_MAGIC = b"#ROSBAG V2.0\n"
_HEAD_BYTES = 4096
"""Of the bag's header with its padding, so that it can be written again when the end is known."""

_CHUNK_BYTES = 1 << 20
"""Chunks have about as many bytes, uncompressed. ROS 1 holds one at a time."""

_BAG, _CHUNK, _CONNECTION, _MESSAGE, _INDEX, _CHUNK_INFO = 3, 5, 7, 2, 4, 6
"""The records' op codes."""

_MESSAGE_HEAD = np.dtype(
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
_INDEX_ENTRY = np.dtype([("sec", "<u4"), ("nsec", "<u4"), ("offset", "<u4")])


_NOT_IN_HEADERS = frozenset({"type", "md5sum", "message_definition", "offered_qos_profiles", "topic_type_hash"})
"""Metadata of a channel that do not go into its connection's header: the type, and what only ROS 2 says.

All others came from such a header, which may say whatever the node said (http://wiki.ros.org/ROS/Connection Header).
"""

_END_NS = clock.NS_PER_S << 32
"""ROS 1 has 32 bits for the seconds of a time."""


def _lz4(data: bytes) -> bytes:
    """Compress a chunk as ROS 1 reads it: without its size, in blocks that do not need each other, with a checksum."""
    return bytes(lz4.frame.compress(data, store_size=False, block_linked=False, content_checksum=True))


COMPRESSORS: Mapping[str, Callable[[bytes], bytes]] = {"none": bytes, "bz2": bz2.compress, "lz4": _lz4}


class _Pending(NamedTuple):
    """Messages with their heads that later ones may still come between."""

    data: npt.NDArray[np.uint8]
    starts: npt.NDArray[np.int64]
    sizes: npt.NDArray[np.int64]
    """Bytes of each, with its head, [N]."""
    times_ns: npt.NDArray[np.uint64]
    connections: npt.NDArray[np.int64]

    def part(self, first: int, last: int) -> _Pending:
        """Return those from a number on and before another."""
        begin = int(self.starts[first]) if first < len(self.starts) else len(self.data)
        end = int(self.starts[last]) if last < len(self.starts) else len(self.data)
        which = slice(first, last)
        starts = self.starts[which] - begin
        return _Pending(self.data[begin:end], starts, self.sizes[which], self.times_ns[which], self.connections[which])


class Storage:
    """A file that takes messages until it is finished.

    Chunks are in the order of time, messages of all topics together: ROS 1 unpacks one chunk at a time, and would
    unpack two again and again that hold the same time.
    """

    room = _MESSAGE_HEAD.itemsize
    """Bytes that each message needs before it."""

    def __init__(self, path: Path, outlets: Sequence[Outlet], compression: str) -> None:
        """Begin a file.

        Args:
            path: Where nothing is.
            outlets: All topics.
            compression: One of `COMPRESSORS`.
        """
        self._compression = compression
        self._outlets = outlets
        self._pending: list[_Pending] = []
        self._infos: list[bytes] = []
        self._introduced: set[int] = set()
        """Connections that a chunk has said what they are."""
        self._file = path.open("xb")
        self._file.write(_MAGIC + _bag_head(0, 0, 0))

    def write(self, sent: Sequence[Sent]) -> None:
        """Take messages; later calls bring none before the first of them."""
        if not sent:
            return
        for one in sent:
            self._check_times(_connection_id(one.outlet), one.times_ns)
        first_ns = min(int(one.times_ns[0]) for one in sent)
        self._settle(first_ns)
        self._pending += [_with_heads(one) for one in sent]

    def pack(self, block: MessageBlock) -> _Pending:
        """Return messages that are carried with their heads, in their order."""
        self._check_times(block.channels - 1, block.times_ns)
        sizes = np.fromiter(map(len, block.payloads), np.int64, len(block))
        text = _heads(block.channels - 1, block.times_ns, sizes).tobytes()
        size = _MESSAGE_HEAD.itemsize
        parts: list[Any] = [None] * (2 * len(block))
        parts[0::2] = [text[at : at + size] for at in range(0, len(text), size)]
        parts[1::2] = block.payloads
        whole = sizes + size
        data = np.frombuffer(b"".join(parts), np.uint8)
        return _Pending(data, np.cumsum(whole) - whole, whole, block.times_ns, block.channels - 1)

    def write_packed(self, messages: _Pending) -> None:
        """Write messages that are carried, as a chunk of their own."""
        self._settle(int(messages.times_ns.min()))
        self._chunk(messages)

    def finish(self) -> None:
        """Write the file's end."""
        self._settle(None)
        if not self._infos and self._outlets:  # rosbags reads no connections of a bag without chunks
            nothing = np.zeros(0, np.int64)
            self._chunk(_Pending(np.zeros(0, np.uint8), nothing, nothing, np.zeros(0, np.uint64), nothing))
        index_place = self._file.tell()
        self._file.write(b"".join(map(_connection, self._outlets)) + b"".join(self._infos))
        self._file.seek(len(_MAGIC))
        self._file.write(_bag_head(index_place, len(self._outlets), len(self._infos)))
        self._file.flush()
        self.close()

    def close(self) -> None:
        """Close the file, finished or not. May be called twice."""
        self._file.close()

    def _check_times(self, connections: Any, times_ns: npt.NDArray[np.uint64]) -> None:
        """Refuse messages whose times ROS 1 has no room for."""
        if not len(times_ns) or int(times_ns.max()) < _END_NS:
            return
        at = int(np.argmax(times_ns))
        number = int(np.broadcast_to(connections, times_ns.shape)[at])
        topic = next(one.topic for one in self._outlets if _connection_id(one) == number)
        raise ConversionError(
            f"topic {topic!r} has a message at {clock.to_seconds(int(times_ns[at]))!r} s; ROS 1 has no times from "
            "2**32 s, in the year 2106, on; pass time_offset= to move them"
        )

    def _settle(self, before_ns: int | None) -> None:
        """Write the messages before a time; all of them without one."""
        ready, later = [], []
        for one in self._pending:
            count = len(one.times_ns) if before_ns is None else int(np.searchsorted(one.times_ns, np.uint64(before_ns)))
            if count:
                ready.append(one.part(0, count))
            if count < len(one.times_ns):
                later.append(one.part(count, len(one.times_ns)))
        if before_ns is not None and sum(len(one.data) for one in ready) < _CHUNK_BYTES:
            return  # more will come that goes into the same chunk
        self._pending = later
        if ready:
            merged = _merged(ready)
            edges = np.arange(_CHUNK_BYTES, len(merged.data), _CHUNK_BYTES)
            cuts = np.unique([0, *np.searchsorted(merged.starts, edges), len(merged.starts)]).tolist()
            for first, last in pairwise(cuts):
                self._chunk(merged.part(first, last))

    def _chunk(self, messages: _Pending) -> None:
        place = self._file.tell()
        numbers = np.unique(messages.connections).tolist()
        new = [one for one in self._outlets if _connection_id(one) in set(numbers) - self._introduced]
        new = new if numbers else list(self._outlets)
        self._introduced.update(map(_connection_id, new))
        before = b"".join(map(_connection, new))
        raw = before + messages.data.tobytes()
        packed = COMPRESSORS[self._compression](raw)
        name = self._compression.encode()
        self._file.write(_record(packed, op=_byte(_CHUNK), compression=name, size=_u32(len(raw))))
        counts = b""
        for number in numbers:
            which = messages.connections == number
            entries = np.empty(int(which.sum()), _INDEX_ENTRY)
            entries["sec"], entries["nsec"] = np.divmod(messages.times_ns[which], np.uint64(clock.NS_PER_S))
            entries["offset"] = messages.starts[which] + len(before)
            fields = {"ver": _u32(1), "conn": _u32(number), "count": _u32(len(entries))}
            self._file.write(_record(entries.tobytes(), op=_byte(_INDEX), **fields))
            counts += _u32(number) + _u32(len(entries))
        start, end = (_time(time_ns) for time_ns in _edges(messages.times_ns))
        fields = {"chunk_pos": place.to_bytes(8, "little"), "start_time": start, "end_time": end}
        info = {"ver": _u32(1), **fields, "count": _u32(len(numbers))}
        self._infos.append(_record(counts, op=_byte(_CHUNK_INFO), **info))


def _edges(times_ns: npt.NDArray[np.uint64]) -> tuple[int, int]:
    """Return the first and the last of some times; 0 where there are none."""
    return (int(times_ns.min()), int(times_ns.max())) if len(times_ns) else (0, 0)


def _with_heads(sent: Sent) -> _Pending:
    """Write the heads of message records into the room before each message."""
    packed, count = sent.packed, len(sent.times_ns)
    heads = _heads(_connection_id(sent.outlet), sent.times_ns, packed.sizes)
    data = packed.data if packed.data.flags.writeable else packed.data.copy()
    data[packed.starts[:, None] + np.arange(_MESSAGE_HEAD.itemsize)] = heads.view(np.uint8).reshape(count, -1)
    connections = np.full(count, _connection_id(sent.outlet), np.int64)
    return _Pending(data, packed.starts, packed.sizes + _MESSAGE_HEAD.itemsize, sent.times_ns, connections)


def _heads(connections: Any, times_ns: npt.NDArray[np.uint64], sizes: npt.NDArray[np.int64]) -> npt.NDArray[Any]:
    """Return the heads of message records, [N]."""
    heads = np.zeros(len(times_ns), _MESSAGE_HEAD)
    heads["length"] = _MESSAGE_HEAD.itemsize - 8  # but for itself and the data's size
    for name, text in (("op", b"op=" + _byte(_MESSAGE)), ("conn_key", b"conn="), ("time_key", b"time=")):
        size = len(text) + (0 if name == "op" else 4 if name == "conn_key" else 8)
        heads[name] = np.frombuffer(_u32(size) + text, np.uint8)
    heads["conn"] = connections
    heads["sec"], heads["nsec"] = np.divmod(times_ns, np.uint64(clock.NS_PER_S))
    heads["size"] = sizes
    return heads


def _merged(parts: Sequence[_Pending]) -> _Pending:
    """Return messages in the order of time, those of one time by topic."""
    if len(parts) == 1:
        return parts[0]
    before = np.cumsum([0, *(len(one.data) for one in parts)])
    starts = np.concatenate([one.starts + at for one, at in zip(parts, before.tolist(), strict=False)])
    sizes, times, connections = (
        np.concatenate([one[field] for one in parts])
        for field in (2, 3, 4)  # as in _Pending
    )
    order = np.lexsort((connections, times))
    whole = memoryview(np.concatenate([one.data for one in parts]))  # type: ignore[arg-type]  # as in bag_mcap
    starts, sizes = starts[order], sizes[order]
    spans = zip(starts.tolist(), (starts + sizes).tolist(), strict=True)
    data = np.frombuffer(b"".join([whole[start:end] for start, end in spans]), np.uint8)
    return _Pending(data, np.cumsum(sizes) - sizes, sizes, times[order], connections[order])


def _connection_id(outlet: Outlet) -> int:
    return outlet.number - 1


def _connection(outlet: Outlet) -> bytes:
    topic, found = outlet.topic.encode(), outlet.carried
    about = {} if found is not None else {"topic": topic}
    about.update(type=outlet.type.replace("/msg/", "/").encode(), md5sum=outlet.digest.encode())
    about["message_definition"] = outlet.text.encode() if found is None else found.definition
    if found is not None:  # with or without a topic, which is another one where it was remapped
        about.update((name, value.encode()) for name, value in found.metadata if name not in _NOT_IN_HEADERS)
    return _record(_fields(about), op=_byte(_CONNECTION), conn=_u32(_connection_id(outlet)), topic=topic)


def _bag_head(index_place: int, connections: int, chunks: int) -> bytes:
    fields = {"index_pos": index_place.to_bytes(8, "little"), "conn_count": _u32(connections)}
    head = _fields({"op": _byte(_BAG), **fields, "chunk_count": _u32(chunks)})
    padding = _HEAD_BYTES - 8 - len(head)
    return _u32(len(head)) + head + _u32(padding) + b" " * padding


def _record(data: bytes, **fields: bytes) -> bytes:
    head = _fields(fields)
    return b"".join((_u32(len(head)), head, _u32(len(data)), data))


def _fields(fields: Mapping[str, Any]) -> bytes:
    said = [name.encode() + b"=" + value for name, value in fields.items()]
    return b"".join(_u32(len(one)) + one for one in said)


def _byte(value: int) -> bytes:
    return bytes([value])


def _u32(value: int) -> bytes:
    return value.to_bytes(4, "little")


def _time(time_ns: int) -> bytes:
    sec, nsec = divmod(time_ns, clock.NS_PER_S)
    return _u32(sec) + _u32(nsec)
