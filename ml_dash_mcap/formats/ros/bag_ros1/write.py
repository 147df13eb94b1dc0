"""Writes a ROS 1 bag, a block of messages at a time (http://wiki.ros.org/Bags/Format/2.0)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from .... import clock
from ....errors import ConversionError
from ....mcap.message import MessageBlock
from ..bag_plan import Outlet
from ..rows_out import Sent
from . import layout
from .compression import COMPRESSIONS
from .layout import ENTRY, MESSAGE_HEAD, BagHeader, ChunkHeader, ChunkInfo, IndexHeader, Op, fields_bytes, u32

_CHUNK_BYTES = 1 << 20
"""Chunks have about as many bytes, uncompressed. ROS 1 holds one at a time."""

_NOT_IN_HEADERS = frozenset({"type", "md5sum", "message_definition", "offered_qos_profiles", "topic_type_hash"})
"""Metadata of a channel that do not go into its connection's header: the type, and what only ROS 2 says.

All others came from such a header, which has whatever the node put there (http://wiki.ros.org/ROS/Connection Header).
"""

_END_NS = clock.NS_PER_S << 32
"""ROS 1 has 32 bits for the seconds of a time."""


class _Pending(NamedTuple):
    """Messages with their heads that wait, because messages with earlier times may still come."""

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


class Ros1BagWriter:
    """A file that takes messages until it is finished.

    Chunks are in the order of time, messages of all topics together: ROS 1 unpacks one chunk at a time, and would
    unpack two again and again that hold the same time.
    """

    room = MESSAGE_HEAD.itemsize
    """Bytes that each message needs before it."""

    def __init__(self, path: Path, outlets: Sequence[Outlet], compression: str) -> None:
        """Begin a file.

        Args:
            path: Where nothing is.
            outlets: All topics.
            compression: One of `COMPRESSIONS`.
        """
        self._compression = compression
        self._outlets = outlets
        self._pending: list[_Pending] = []
        self._infos: list[ChunkInfo] = []
        self._introduced: set[int] = set()
        """Connections whose record stands in a chunk already."""
        self._file = path.open("xb")
        # The header is padded to a fixed size, so that `finish` can write it again with the place of the index.
        self._file.write(layout.MAGIC + layout.VERSION + BagHeader(0, 0, 0).record())

    def write(self, sent: Sequence[Sent]) -> None:
        """Take messages; later calls bring none before the first of them."""
        if not sent:
            return
        for messages in sent:
            self._check_times(_connection_id(messages.outlet), messages.times_ns)
        first_ns = min(int(messages.times_ns[0]) for messages in sent)
        self._settle(first_ns)
        self._pending += [_with_heads(messages) for messages in sent]

    def pack(self, block: MessageBlock) -> _Pending:
        """Return messages that are carried with their heads, in their order."""
        self._check_times(block.channels - 1, block.times_ns)
        sizes = np.fromiter(map(len, block.payloads), np.int64, len(block))
        text = _heads(block.channels - 1, block.times_ns, sizes).tobytes()
        size = MESSAGE_HEAD.itemsize
        # Heads and payloads alternate, and one `join` copies every byte once.
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
        self._file.write(b"".join(map(_connection, self._outlets)))
        self._file.write(b"".join(info.record() for info in self._infos))
        self._file.seek(len(layout.MAGIC + layout.VERSION))
        self._file.write(BagHeader(index_place, len(self._outlets), len(self._infos)).record())
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
        topic = next(outlet.topic for outlet in self._outlets if _connection_id(outlet) == number)
        raise ConversionError(
            f"topic {topic!r} has a message at {clock.to_seconds(int(times_ns[at]))!r} s; ROS 1 has no times from "
            "2**32 s, in the year 2106, on; pass time_offset= to move them"
        )

    def _settle(self, before_ns: int | None) -> None:
        """Write the messages before a time; all of them without one."""
        ready, later = [], []
        for pending in self._pending:
            count = (
                len(pending.times_ns)
                if before_ns is None
                else int(np.searchsorted(pending.times_ns, np.uint64(before_ns)))
            )
            if count:
                ready.append(pending.part(0, count))
            if count < len(pending.times_ns):
                later.append(pending.part(count, len(pending.times_ns)))
        if before_ns is not None and sum(len(pending.data) for pending in ready) < _CHUNK_BYTES:
            return  # more will come that goes into the same chunk
        self._pending = later
        if ready:
            merged = _merged(ready)
            edges = np.arange(_CHUNK_BYTES, len(merged.data), _CHUNK_BYTES)
            cuts = np.unique([0, *np.searchsorted(merged.starts, edges), len(merged.starts)]).tolist()
            for first, last in pairwise(cuts):
                self._chunk(merged.part(first, last))

    def _chunk(self, messages: _Pending) -> None:
        """Write a chunk, and the indexes of its messages behind it."""
        place = self._file.tell()
        numbers = np.unique(messages.connections).tolist()
        introductions = self._introductions(numbers)
        content = introductions + messages.data.tobytes()
        packed = COMPRESSIONS[self._compression].pack(content)
        self._file.write(ChunkHeader(self._compression, len(content)).record(packed))
        counts: dict[int, int] = {}
        for number in numbers:
            mine = messages.connections == number
            counts[number] = int(mine.sum())
            entries = np.empty(counts[number], ENTRY)
            entries["sec"], entries["nsec"] = np.divmod(messages.times_ns[mine], np.uint64(clock.NS_PER_S))
            entries["offset"] = messages.starts[mine] + len(introductions)
            self._file.write(IndexHeader(number, counts[number]).record(entries.tobytes()))
        self._infos.append(ChunkInfo(place, counts, *_edges(messages.times_ns)))

    def _introductions(self, numbers: Sequence[int]) -> bytes:
        """Return the records of the connections that no chunk before had; of all for a chunk without messages."""
        new = set(numbers) - self._introduced
        outlets = [outlet for outlet in self._outlets if not numbers or _connection_id(outlet) in new]
        self._introduced.update(map(_connection_id, outlets))
        return b"".join(map(_connection, outlets))


def _edges(times_ns: npt.NDArray[np.uint64]) -> tuple[int, int]:
    """Return the first and the last of some times; 0 where there are none."""
    return (int(times_ns.min()), int(times_ns.max())) if len(times_ns) else (0, 0)


def _with_heads(sent: Sent) -> _Pending:
    """Write the heads of message records into the room before each message."""
    packed, count = sent.packed, len(sent.times_ns)
    heads = _heads(_connection_id(sent.outlet), sent.times_ns, packed.sizes)
    # A block whose bytes come from `bytes` cannot be written into.
    data = packed.data if packed.data.flags.writeable else packed.data.copy()
    data[packed.starts[:, None] + np.arange(MESSAGE_HEAD.itemsize)] = heads.view(np.uint8).reshape(count, -1)
    connections = np.full(count, _connection_id(sent.outlet), np.int64)
    return _Pending(data, packed.starts, packed.sizes + MESSAGE_HEAD.itemsize, sent.times_ns, connections)


def _heads(connections: Any, times_ns: npt.NDArray[np.uint64], sizes: npt.NDArray[np.int64]) -> npt.NDArray[Any]:
    """Return the heads of message records, [N]."""
    heads = np.zeros(len(times_ns), MESSAGE_HEAD)
    heads["length"] = MESSAGE_HEAD.itemsize - 8  # but for itself and the data's size
    for name, text, value_size in (("op", layout.MESSAGE_OP, 0), ("conn_key", b"conn=", 4), ("time_key", b"time=", 8)):
        heads[name] = np.frombuffer(u32(len(text) + value_size) + text, np.uint8)
    heads["conn"] = connections
    heads["sec"], heads["nsec"] = np.divmod(times_ns, np.uint64(clock.NS_PER_S))
    heads["size"] = sizes
    return heads


def _merged(parts: Sequence[_Pending]) -> _Pending:
    """Return messages in the order of time, those of one time by topic."""
    if len(parts) == 1:
        return parts[0]
    before = np.cumsum([0, *(len(part.data) for part in parts)])
    starts = np.concatenate([part.starts + at for part, at in zip(parts, before.tolist(), strict=False)])
    sizes, times, connections = (
        np.concatenate([part[field] for part in parts])
        for field in (2, 3, 4)  # as in _Pending
    )
    # The last key of `lexsort` counts first.
    order = np.lexsort((connections, times))
    whole = memoryview(np.concatenate([part.data for part in parts]))  # type: ignore[arg-type]  # as in bag_mcap
    starts, sizes = starts[order], sizes[order]
    spans = zip(starts.tolist(), (starts + sizes).tolist(), strict=True)
    data = np.frombuffer(b"".join([whole[start:end] for start, end in spans]), np.uint8)
    return _Pending(data, np.cumsum(sizes) - sizes, sizes, times[order], connections[order])


def _connection_id(outlet: Outlet) -> int:
    return outlet.number - 1


def _connection(outlet: Outlet) -> bytes:
    """Return the record of a connection."""
    topic, carried = outlet.topic.encode(), outlet.carried
    header = {} if carried is not None else {"topic": topic}
    header.update(type=outlet.type.replace("/msg/", "/").encode(), md5sum=outlet.digest.encode())
    header["message_definition"] = outlet.text.encode() if carried is None else carried.definition
    if carried is not None:  # with or without a topic, which is another one where it was remapped
        header.update((name, value.encode()) for name, value in carried.metadata if name not in _NOT_IN_HEADERS)
    fields = {"conn": u32(_connection_id(outlet)), "topic": topic}
    return layout.record(Op.CONNECTION, fields, fields_bytes(header))
