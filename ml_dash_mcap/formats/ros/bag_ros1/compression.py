"""Compresses the chunks of ROS 1 bags, and unpacks them."""

from __future__ import annotations

import bz2
from collections.abc import Callable, Mapping
from typing import NamedTuple

import lz4.frame

from .layout import BrokenRecordError

_MOST_BYTES = 1 << 30
"""The largest content of a chunk that is unpacked."""


class Compression(NamedTuple):
    """One way to compress chunks."""

    pack: Callable[[bytes], bytes]
    unpack: Callable[[bytes, int], bytes]
    """Takes what is packed and how many bytes to return at most."""


def unpacked(packed: bytes, name: str, size: int) -> bytes:
    """Return a chunk's content.

    Args:
        packed: The content as the chunk has it.
        name: Of its compression, one of `COMPRESSIONS`.
        size: Of the content, in bytes, as the chunk says it.

    Raises:
        BrokenRecordError: It is not so many bytes, or in a compression that is not known.
    """
    if size > _MOST_BYTES:
        raise BrokenRecordError(f"it is {size} bytes, of {_MOST_BYTES} at most")
    compression = COMPRESSIONS.get(name)
    if compression is None:
        raise BrokenRecordError(f"its compression is {name.encode()!r}, which is not known")
    try:
        # One byte more than stated, so that a content that is too long is noticed without unpacking all of it.
        data = compression.unpack(packed, size + 1)
    except (OSError, RuntimeError, EOFError) as error:
        raise BrokenRecordError(str(error)) from error
    if len(data) != size:
        raise BrokenRecordError(f"it is not the {size} bytes that it says")
    return data


def _unpack_bz2(packed: bytes, most: int) -> bytes:
    return bz2.BZ2Decompressor().decompress(packed, most)


def _pack_lz4(data: bytes) -> bytes:
    """Compress a chunk as ROS 1 reads it: without its size, in blocks that do not need each other, with a checksum."""
    return bytes(lz4.frame.compress(data, store_size=False, block_linked=False, content_checksum=True))


def _unpack_lz4(packed: bytes, most: int) -> bytes:
    data: bytes = lz4.frame.LZ4FrameDecompressor().decompress(packed, most)
    return data


COMPRESSIONS: Mapping[str, Compression] = {
    "none": Compression(bytes, lambda packed, _: packed),
    "bz2": Compression(bz2.compress, _unpack_bz2),
    "lz4": Compression(_pack_lz4, _unpack_lz4),
}
"""By the names that chunks have for them."""
