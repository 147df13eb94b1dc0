"""Blocks of objects, kept in memory for the next reader as long as there is room."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterable, Mapping

BLOCK_BYTES = 64 * 1024
"""The size of a block. The last block of an object may be shorter."""

_Key = tuple[int, int]
"""The number of an object, and that of one of its blocks."""


class BlockCache:
    """The blocks that were used last, up to a number of bytes. Any thread may call it."""

    def __init__(self, most_bytes: int) -> None:
        """Begin with nothing.

        Args:
            most_bytes: How many bytes are kept at most.
        """
        self._most_bytes = most_bytes
        self._cache_lock = threading.Lock()
        """Guards the blocks and their size."""
        self._blocks: OrderedDict[_Key, bytes] = OrderedDict()
        self._bytes = 0

    def get(self, owner: int, numbers: Iterable[int]) -> dict[int, bytes]:
        """Return the blocks of an object that are kept, by their numbers."""
        with self._cache_lock:
            kept = {number: self._blocks.get((owner, number)) for number in numbers}
            blocks = {number: block for number, block in kept.items() if block is not None}
            for number in blocks:
                self._blocks.move_to_end((owner, number))
            return blocks

    def put(self, owner: int, blocks: Mapping[int, bytes]) -> None:
        """Keep some of an object's blocks. The blocks whose use is longest ago make room for them."""
        with self._cache_lock:
            for number, block in blocks.items():
                self._bytes += len(block) - len(self._blocks.pop((owner, number), b""))
                self._blocks[owner, number] = block
            while self._bytes > self._most_bytes:
                self._bytes -= len(self._blocks.popitem(last=False)[1])

    def forget(self, owner: int) -> None:
        """Remove an object's blocks."""
        with self._cache_lock:
            for key in [key for key in self._blocks if key[0] == owner]:
                self._bytes -= len(self._blocks.pop(key))
