"""Does the writer thread's work once on two rows, before a loop waits for it.

The first block of a process would take twice as long as later ones: modules are imported, and numpy sets itself up.
"""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np

from ..codecs import codec_table
from ..codecs.codec import Codec
from ..file_names import TRACK
from ..mcap.chunk_writer import build, compressor
from ..mcap.message_records import message
from ..mcap.row_arrays import SealedBuffer, split
from ..options import RecorderOptions
from .channels import ChannelInfo
from .prepare_block import BlockPreparer

_BLOCK_BYTES = 2 * 1024 * 1024
"""About as much as the writer thread needs at a time for arrays of a block's rows."""


@functools.cache
def rehearse(encoding: str) -> None:
    """Prepare and compress a block in memory. What fails here fails, and is reported, where it matters.

    Args:
        encoding: Of the rows.
    """
    codec = codec_table.find(encoding)
    if not isinstance(codec, Codec):
        return
    codec = codec.for_channel("rehearsal")
    rows = [codec.encode({name: [0.5, 1.5], "_ts": 1.0}, "rehearsal") for name in "ab"]
    block = _block([message(1, 10**9, payload) for payload in rows])
    preparer = BlockPreparer(Path(), {}, {1: ChannelInfo(1, "rehearsal", TRACK, codec=codec)})
    prepared = preparer.prepare(block)
    if prepared.rows is not None:
        for part in split(prepared.rows, 1):
            build(part, compressor(RecorderOptions()))


def touch_memory() -> None:
    """Have the allocator keep memory at hand for the calling thread, as much as the first block needs.

    glibc gives each thread memory of its own. It gives the first array of this size back to the system, and learns by
    that to keep the second.
    """
    for _ in range(2):
        np.ones(_BLOCK_BYTES, np.uint8)


def _block(records: list[bytes]) -> SealedBuffer:
    data = np.frombuffer(bytearray(b"".join(records)), np.uint8)
    return SealedBuffer(data, 0, len(data), [sum(map(len, records[:number])) for number in range(len(records))])
