"""Rows to an MCAP chunk with its message indexes."""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ..options import RecorderOptions
from . import records
from .rows import Rows

Compressed = bytes | memoryview


class Compressor(Protocol):
    """Compresses blocks of bytes, each to a frame of its own, in one call that lets other threads run."""

    name: str
    """As MCAP spells it."""

    def __call__(self, blocks: list[memoryview]) -> Sequence[Compressed]:
        """Return the compressed blocks."""


@dataclass(frozen=True, slots=True)
class Chunk:
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
        self._many = "multi_compress_to_buffer" in zstandard.backend_features

    def __call__(self, blocks: list[memoryview]) -> Sequence[Compressed]:
        if len(blocks) == 1 or not self._many:
            return [self._zstd.compress(block) for block in blocks]
        frames: Any = self._zstd.multi_compress_to_buffer([*blocks])
        return [memoryview(frame) for frame in frames]


class _Lz4:
    name = "lz4"

    def __init__(self, level: int | None) -> None:
        self._level = 0 if level is None else level

    def __call__(self, blocks: list[memoryview]) -> Sequence[Compressed]:
        import lz4.frame

        return [bytes(lz4.frame.compress(block, compression_level=self._level)) for block in blocks]


class _None:
    name = ""

    def __call__(self, blocks: list[memoryview]) -> Sequence[Compressed]:
        return blocks


def compressor(options: RecorderOptions) -> Compressor:
    """Return what the options ask for."""
    if options.compression == "zstd":
        return _Zstd(options.compression_level)
    return _Lz4(options.compression_level) if options.compression == "lz4" else _None()


def build(rows: Rows, compress: Compressor) -> list[Chunk]:
    """Index, checksum and compress rows; one chunk a block.

    The rows stay in the order in which they were appended; each MessageIndex is sorted by time.
    """
    firsts = np.flatnonzero(np.diff(rows.blocks, prepend=-1))
    cuts = [*rows.starts[firsts].tolist(), int(rows.ends[-1])]
    view = memoryview(rows.data)  # type: ignore[arg-type]  # numpy's stubs know no buffers before 3.12
    blocks = [view[start:end] for start, end in itertools.pairwise(cuts)]
    start_times = np.minimum.reduceat(rows.times, firsts).tolist()
    end_times = np.maximum.reduceat(rows.times, firsts).tolist()
    chunks = []
    for number, (block, data, entries) in enumerate(zip(blocks, compress(blocks), _index(rows, cuts), strict=True)):
        span = start_times[number], end_times[number]
        head = records.chunk_head(*span, len(block), zlib.crc32(block), compress.name, len(data))
        chunks.append(Chunk(head, data, compress.name, len(block), *span, *entries))
    return chunks


def _index(rows: Rows, cuts: list[int]) -> Iterator[tuple[dict[int, bytes], dict[int, int]]]:
    """Yield, for each block, the MessageIndex records and the number of rows by channel id."""
    order = np.lexsort((rows.times, rows.channels, rows.blocks))
    entries = np.empty(len(rows), records.INDEX_ENTRY_DTYPE)
    entries["time"] = rows.times[order]
    entries["offset"] = rows.starts[order] - np.array(cuts)[rows.blocks[order]]
    groups = rows.blocks[order] * (1 << 16) + rows.channels[order]
    firsts = np.flatnonzero(np.diff(groups, prepend=-1))
    lasts = np.append(firsts[1:], len(rows))
    by_block: list[tuple[dict[int, bytes], dict[int, int]]] = [({}, {}) for _ in cuts[1:]]
    for group, first, last in zip(groups[firsts].tolist(), firsts.tolist(), lasts.tolist(), strict=True):
        block, channel = divmod(group, 1 << 16)
        by_block[block][0][channel] = records.message_index(channel, entries[first:last])
        by_block[block][1][channel] = last - first
    yield from by_block
