"""Builds MCAP chunks with their message indexes from rows."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from ..file_names import is_like_a_bomb
from ..options import RecorderOptions
from .message import MessageBlock, Payload
from .message_records import MESSAGE_HEAD_BYTES, index_entries, message_heads, pack_message_index
from .record_layout import pack_prefix
from .records import CHUNK_HEAD, Chunk, ChunkHead, Opcode
from .row_arrays import Rows

Compressed = bytes | memoryview


class Compressor(Protocol):
    """Compresses a block of bytes in one call that lets other threads run."""

    name: str
    """As MCAP spells it."""

    def __call__(self, block: memoryview) -> Compressed:
        """Return the compressed block."""


@dataclass(frozen=True, slots=True)
class PackedChunk:
    """A chunk, ready to be written."""

    head: bytes
    """The Chunk record up to its data."""
    data: Compressed
    """The compressed Message records."""
    compression: str
    """As MCAP spells it."""
    uncompressed_size: int
    start_ns: int
    end_ns: int
    indexes: dict[int, bytes]
    """The MessageIndex record of each channel id in it."""
    counts: dict[int, int]
    """Rows of each channel id in it."""

    @property
    def length(self) -> int:
        """Length of the Chunk record in bytes."""
        return len(self.head) + len(self.data)

    def placed(self, offset: int) -> Chunk:
        """Return the index entry of the chunk at `offset` in its file, with its message indexes right behind it."""
        offsets, position = {}, offset + self.length
        for channel_id, index in self.indexes.items():
            offsets[channel_id] = position
            position += len(index)
        return Chunk(
            offset=offset,
            length=self.length,
            start_ns=self.start_ns,
            end_ns=self.end_ns,
            compression=self.compression,
            compressed_size=len(self.data),
            uncompressed_size=self.uncompressed_size,
            message_index_offsets=offsets,
            message_index_length=position - offset - self.length,
        )


class _Zstd:
    name = "zstd"

    def __init__(self, level: int | None) -> None:
        import zstandard

        if level is None:
            # As fast as level 1, and 2 to 3 % smaller on rows of numbers: matches of 6 bytes find the keys in between.
            parameters = zstandard.ZstdCompressionParameters(
                window_log=19, hash_log=13, min_match=6, strategy=zstandard.STRATEGY_FAST
            )
            self._zstd = zstandard.ZstdCompressor(compression_params=parameters)
        else:
            self._zstd = zstandard.ZstdCompressor(level=level)

    def __call__(self, block: memoryview) -> Compressed:
        return self._zstd.compress(block)


class _Lz4:
    name = "lz4"

    def __init__(self, level: int | None) -> None:
        self._level = 0 if level is None else level

    def __call__(self, block: memoryview) -> Compressed:
        import lz4.frame

        return bytes(lz4.frame.compress(block, compression_level=self._level))


class _None:
    name = ""

    def __call__(self, block: memoryview) -> Compressed:
        return block


UNCOMPRESSED: Compressor = _None()


def compressor(options: RecorderOptions) -> Compressor:
    """Return the compressor that the options ask for."""
    if options.compression == "zstd":
        return _Zstd(options.compression_level)
    return _Lz4(options.compression_level) if options.compression == "lz4" else _None()


def build(rows: Rows, compress: Compressor) -> PackedChunk:
    """Index, checksum and compress rows, one or more.

    They stay in the order in which they were appended; each MessageIndex is sorted by time.
    """
    block = memoryview(rows.data)  # type: ignore[arg-type]  # numpy's stubs know no buffers before 3.12
    return pack(block, int(rows.times.min()), int(rows.times.max()), _entries(rows), compress)


def build_block(block: MessageBlock, compress: Compressor) -> PackedChunk:
    """Build a chunk of one or more messages of another file. The numbers of their channels become the channel ids."""
    return build(rows_of_block(block), compress)


def rows_of_block(block: MessageBlock) -> Rows:
    """Return one or more messages as Message records. The numbers of their channels become the channel ids."""
    sizes = np.fromiter(map(len, block.payloads), np.int64, len(block))
    heads = message_heads(sizes, block.channels, block.times_ns)
    heads["sequence"] = block.sequences
    heads["publish_time"] = block.published_ns
    ends = np.cumsum(sizes + MESSAGE_HEAD_BYTES)
    times: Any = block.times_ns  # beyond the year 2262 they do not fit into signed numbers
    starts = ends - sizes - MESSAGE_HEAD_BYTES
    return Rows(_joined(heads, block.payloads, sizes), starts, ends, block.channels, times)


def pack(
    block: memoryview, start_ns: int, end_ns: int, entries: Mapping[int, npt.NDArray[np.void]], compress: Compressor
) -> PackedChunk:
    """Checksum and compress Message records.

    Args:
        block: The records, one behind the other.
        start_ns: The first of their log times.
        end_ns: The last one.
        entries: The entries of each channel's MessageIndex, in `INDEX_ENTRY`, by channel id.
        compress: How to compress them.
    """
    data, compression = compress(block), compress.name
    # Readers refuse a chunk that unpacks to so much more than it has, ours among them (`limits.Limits`).
    if is_like_a_bomb(len(block), len(data)):
        data, compression = block, ""
    head = ChunkHead(start_ns, end_ns, len(block), zlib.crc32(block), compression, len(data))
    content = CHUNK_HEAD.content(head)
    prefix = pack_prefix(Opcode.CHUNK, len(content) + len(data))
    return PackedChunk(prefix + content, data, compression, len(block), start_ns, end_ns, *index_records(entries))


def index_records(entries: Mapping[int, npt.NDArray[np.void]]) -> tuple[dict[int, bytes], dict[int, int]]:
    """Return the MessageIndex record of each channel id, and how many messages are in it."""
    return (
        {channel_id: pack_message_index(channel_id, part) for channel_id, part in entries.items()},
        {channel_id: len(part) for channel_id, part in entries.items()},
    )


def _entries(rows: Rows) -> dict[int, npt.NDArray[np.void]]:
    """Return the entries of each channel id's MessageIndex."""
    order = np.lexsort((rows.times, rows.channels))
    entries = index_entries(rows.times[order], rows.starts[order])
    channels, firsts = np.unique(rows.channels[order], return_index=True)
    return dict(zip(channels.tolist(), np.split(entries, firsts[1:]), strict=True))


def _joined(heads: npt.NDArray[np.void], payloads: list[Payload], sizes: npt.NDArray[np.int64]) -> Any:
    """Return Message records, each with its payload behind its head."""
    count, size = len(heads), int(sizes[0])
    if (sizes == size).all():  # payloads of one size are the columns of a matrix: that takes a third of the time
        whole = np.empty((count, MESSAGE_HEAD_BYTES + size), np.uint8)
        whole[:, :MESSAGE_HEAD_BYTES] = heads.view(np.uint8).reshape(count, -1)
        whole[:, MESSAGE_HEAD_BYTES:] = np.frombuffer(b"".join(payloads), np.uint8).reshape(count, size)
        return whole.reshape(-1)
    text = heads.tobytes()
    parts: list[Any] = [None] * (2 * count)
    # Heads and payloads in turn, for one join.
    parts[0::2] = [text[at : at + MESSAGE_HEAD_BYTES] for at in range(0, len(text), MESSAGE_HEAD_BYTES)]
    parts[1::2] = payloads
    return np.frombuffer(b"".join(parts), np.uint8)
