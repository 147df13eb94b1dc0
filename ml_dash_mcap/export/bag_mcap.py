"""One MCAP file of a rosbag2 folder, written a block of messages at a time."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import numpy.typing as npt
import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Header, MetadataIndex, Schema, Statistics, SummaryOffset
from mcap.records import Metadata as MetadataRecord

from ..options import RecorderOptions
from ..version import LIBRARY
from ..write import records
from ..write.chunk import Compressor, compressor
from ..write.records import MESSAGE_HEAD
from .bag_plan import Outlet
from .bag_topics import Sent

_CHUNK_BYTES = 1 << 20
"""Chunks have about as many bytes, uncompressed: what viewers like."""

SUFFIX = ".mcap"


class _Zstd:
    """Finds in a standard message the numbers that ours before it has: two thirds smaller than level 1, and faster."""

    name = "zstd"

    def __init__(self) -> None:
        parameters = zstandard.ZstdCompressionParameters(
            window_log=20, hash_log=16, min_match=5, strategy=zstandard.STRATEGY_FAST
        )
        self._zstd = zstandard.ZstdCompressor(compression_params=parameters)

    def __call__(self, block: memoryview) -> bytes:
        return self._zstd.compress(block)


class Storage:
    """A file that takes messages until it is finished."""

    room = MESSAGE_HEAD
    """Bytes that each message needs before it."""

    def __init__(self, path: Path, outlets: Sequence[Outlet], qos: str, distro: str, compression: str) -> None:
        """Begin a file."""
        self._compress: Compressor = _Zstd()
        if compression != "zstd":
            self._compress = compressor(RecorderOptions(compression=compression))  # type: ignore[arg-type]  # checked
        self._file = path.open("wb")
        self.size = 0
        """Bytes so far."""
        types = {outlet.type: outlet for outlet in outlets}
        numbers = {name: number for number, name in enumerate(types, start=1)}
        self._schemas = [
            Schema(id=numbers[one.type], name=one.type, encoding="ros2msg", data=one.text.encode())
            for one in types.values()
        ]
        self._channels = [
            Channel(
                id=outlet.number,
                schema_id=numbers[outlet.type],
                topic=outlet.topic,
                message_encoding="cdr",
                metadata={"offered_qos_profiles": qos, "topic_type_hash": outlet.digest},
            )
            for outlet in outlets
        ]
        self._metadata: list[MetadataIndex] = []
        self._chunks: list[ChunkIndex] = []
        self.counts: dict[int, int] = {}
        self.start_ns = 0
        self.end_ns = 0
        self._distro = distro
        self._write(records.MAGIC + records.to_bytes(Header(profile="ros2", library=LIBRARY)))
        self._write(records.to_bytes(*self._schemas, *self._channels))

    def write(self, sent: Sequence[Sent]) -> None:
        """Write messages, as one chunk or a few."""
        total = sum(len(one.packed.data) for one in sent)
        pieces = max(1, min(-(-total // _CHUNK_BYTES), max((len(one.times_ns) for one in sent), default=1)))
        for part in _slices(sent, pieces):
            self._chunk(part)

    def finish(self, information: str) -> None:
        """Write the file's end.

        Args:
            information: What is said of it, as YAML.
        """
        said = {"ROS_DISTRO": self._distro, "serialized_metadata": information}
        record = records.to_bytes(MetadataRecord(name="rosbag2", metadata=said))
        self._metadata.append(MetadataIndex(offset=self.size, length=len(record), name="rosbag2"))
        self._write(record + records.data_end())
        summary_start = self.size
        summary = b""
        offsets = []
        for opcode, group in (
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.METADATA_INDEX, self._metadata),
        ):
            if group:
                data = records.to_bytes(*group)
                offsets.append(
                    SummaryOffset(group_opcode=opcode, group_start=summary_start + len(summary), group_length=len(data))
                )
                summary += data
        offset_start = summary_start + len(summary)
        summary += records.to_bytes(*offsets)
        head = records.footer(summary_start, offset_start, 0)[:-4]
        crc = crc32(head, crc32(summary))
        self._write(summary + head + crc.to_bytes(4, "little") + records.MAGIC)
        self._file.flush()
        self.close()

    def close(self) -> None:
        """Close the file, finished or not. May be called twice."""
        self._file.close()

    def _chunk(self, sent: Sequence[Sent]) -> None:
        block = np.concatenate([one.packed.data for one in sent])
        start_ns = min(int(one.times_ns[0]) for one in sent)
        end_ns = max(int(one.times_ns[-1]) for one in sent)
        indexes: dict[int, bytes] = {}
        at = 0
        for one in sent:
            count = self.counts.get(one.outlet.number, 0)
            _put_heads(block[at : at + len(one.packed.data)], one, count)
            entries = np.empty(len(one.times_ns), records.INDEX_ENTRY_DTYPE)
            entries["time"], entries["offset"] = one.times_ns, one.packed.starts + at
            indexes[one.outlet.number] = records.message_index(one.outlet.number, entries)
            self.counts[one.outlet.number] = count + len(entries)
            at += len(one.packed.data)
        view = memoryview(block)  # type: ignore[arg-type]  # numpy's stubs know no buffers before 3.12
        compressed = self._compress(view)
        name = self._compress.name
        head = records.chunk_head(start_ns, end_ns, len(block), crc32(view), name, len(compressed))
        offset = self.size
        places: dict[int, int] = {}
        end = offset + len(head) + len(compressed)
        index_start = end
        for number, index in indexes.items():
            places[number] = end
            end += len(index)
        self._write(head, compressed, *indexes.values())
        self._chunks.append(
            ChunkIndex(
                message_start_time=start_ns,
                message_end_time=end_ns,
                chunk_start_offset=offset,
                chunk_length=index_start - offset,
                message_index_offsets=places,
                message_index_length=end - index_start,
                compression=name,
                compressed_size=len(compressed),
                uncompressed_size=len(block),
            )
        )
        self.start_ns = start_ns if len(self._chunks) == 1 else min(self.start_ns, start_ns)
        self.end_ns = max(self.end_ns, end_ns)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=self.counts,
            chunk_count=len(self._chunks),
            message_count=sum(self.counts.values()),
            message_end_time=self.end_ns,
            message_start_time=self.start_ns,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )

    def _write(self, *parts: Any) -> None:
        for part in parts:
            self._file.write(part)
            self.size += len(part)


def _put_heads(block: npt.NDArray[np.uint8], sent: Sent, before: int) -> None:
    """Write the heads of Message records into the room before each message."""
    packed = sent.packed
    heads = np.zeros(len(sent.times_ns), records.MESSAGE_HEAD_DTYPE)
    heads["opcode"] = records.MESSAGE_OPCODE
    heads["length"] = packed.sizes + records.MESSAGE_LENGTH_EXCESS
    heads["channel"] = sent.outlet.number
    heads["sequence"] = (np.arange(before, before + len(heads)) & 0xFFFFFFFF).astype(np.uint32)
    heads["log_time"] = heads["publish_time"] = sent.times_ns
    data = heads.view(np.uint8).reshape(len(heads), MESSAGE_HEAD)
    size = MESSAGE_HEAD + int(packed.sizes[0])
    if len(block) == size * len(heads) and bool((packed.sizes == packed.sizes[0]).all()):
        block.reshape(len(heads), size)[:, :MESSAGE_HEAD] = data
    else:
        block[packed.starts[:, None] + np.arange(MESSAGE_HEAD)] = data


def _slices(sent: Sequence[Sent], pieces: int) -> list[list[Sent]]:
    """Cut messages into pieces by time."""
    if pieces == 1:
        return [list(sent)] if sent else []
    longest = max(sent, key=lambda one: len(one.times_ns))
    rows = np.linspace(0, len(longest.times_ns), pieces + 1).astype(np.int64)[1:-1]
    edges = longest.times_ns[rows]
    found: list[list[Sent]] = [[] for _ in range(pieces)]
    for one in sent:
        cuts = [0, *np.searchsorted(one.times_ns, edges, "left").tolist(), len(one.times_ns)]
        for piece, (start, end) in zip(found, pairwise(cuts), strict=True):
            if end > start:
                piece.append(Sent(one.outlet, one.times_ns[start:end], one.packed.slice(start, end)))
    return [piece for piece in found if piece]
