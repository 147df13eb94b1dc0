"""Rows to an MCAP chunk with its message indexes."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..options import RecorderOptions
from . import records
from .rows import Rows

Compress = Callable[[memoryview], bytes]


@dataclass(frozen=True, slots=True)
class Chunk:
    """A chunk, ready to be written."""

    head: bytes
    """The Chunk record up to its data."""
    data: bytes | memoryview
    """The compressed Message records."""
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


def compressor(options: RecorderOptions) -> Compress:
    """Return what compresses a chunk in one call that lets other threads run."""
    level = options.compression_level
    if options.compression == "zstd":
        import zstandard

        return zstandard.ZstdCompressor(level=1 if level is None else level).compress
    if options.compression == "lz4":
        import lz4.frame

        return lambda data: bytes(lz4.frame.compress(data, compression_level=0 if level is None else level))
    return bytes


def build(rows: Rows, options: RecorderOptions, compress: Compress) -> Chunk:
    """Index, checksum and compress packed rows, one or more.

    The rows stay in the order in which they were appended; each MessageIndex is sorted by time.
    """
    block = memoryview(rows.contiguous())
    data = compress(block)
    name = "" if options.compression == "none" else options.compression
    start_ns, end_ns = int(rows.times.min()), int(rows.times.max())
    head = records.chunk_head(start_ns, end_ns, len(block), zlib.crc32(block), name, len(data))
    indexes, counts = _index(rows)
    return Chunk(head, data, len(block), start_ns, end_ns, indexes, counts)


def _index(rows: Rows) -> tuple[dict[int, bytes], dict[int, int]]:
    order = np.lexsort((rows.times, rows.channels))
    entries = np.empty(len(rows), records.INDEX_ENTRY_DTYPE)
    entries["time"] = rows.times[order]
    entries["offset"] = rows.starts[order] - rows.starts[0]
    channels, firsts, counts = np.unique(rows.channels[order], return_index=True, return_counts=True)
    indexes, by_channel = {}, {}
    for channel, first, count in zip(channels.tolist(), firsts.tolist(), counts.tolist(), strict=True):
        indexes[channel] = records.message_index(channel, entries[first : first + count])
        by_channel[channel] = count
    return indexes, by_channel
