"""An object of a store, read by range as a file is."""

from __future__ import annotations

import errno
from collections.abc import Iterable, Iterator, Sequence
from itertools import count, islice

from ..errors import MissingObjectError, StorageError
from .block_cache import BLOCK_BYTES, BlockCache
from .store import ByteRange, Store, StoredObject

_blocks = BlockCache(64 * 1024 * 1024)
"""Shared by all objects that are open, so that a recording of a thousand files is bounded too."""

_AHEAD_BYTES = 8 * 1024 * 1024
"""How many bytes of expected ranges are fetched together: one wait for the network instead of one for each range."""

_numbers = count()


class ObjectSource:
    """One version of an object as a `ByteSource`. Any thread may read from it.

    A read shorter than a block fetches the blocks that hold it. The first read also fetches the object's first block
    and its last 64 KiB, in which most MCAP files have their header and their summary. A longer read, or one that was
    announced by `expect`, fetches exactly its range.
    """

    def __init__(self, store: Store, stored: StoredObject) -> None:
        """Begin with nothing read.

        Args:
            store: Where it lies.
            stored: The object, as the store listed it.
        """
        self._store = store
        self._stored = stored
        self._owner, self._ahead = next(_numbers), next(_numbers)
        """The keys in the cache of its blocks, and of the ranges that were fetched ahead."""
        self._expected: dict[ByteRange, int] = {}
        """The ranges that will be read, in this order, with their numbers."""
        self._is_primed = False
        self._is_closed = False

    @property
    def name(self) -> str:
        """Its name in the store."""
        return self._stored.name

    def size(self) -> int:
        """Return how many bytes this version has."""
        return self._stored.size

    def stored_bytes(self) -> int:
        """Return how many bytes this version has: an object has no holes."""
        return self._stored.size

    def beside(self, name: str) -> bytes | None:
        """Return the bytes of another object in the same folder; None if there is none."""
        folder, slash, _ = self._stored.name.rpartition("/")
        try:
            stored = self._store.head(folder + slash + name)
        except MissingObjectError:
            return None
        return self._store.read_ranges(stored, [(0, stored.size)])[0]

    def is_version(self, stored: StoredObject) -> bool:
        """Whether a store's object is still the version that is read here."""
        return (stored.name, stored.version) == (self._stored.name, self._stored.version)

    def read(self, offset: int, length: int) -> bytes:
        """Return the bytes of [offset, offset + length); fewer only where the object ends before.

        Raises:
            StorageError: It cannot be read, or was closed.
            StaleVersionError: It was replaced since it was opened.
        """
        if self._is_closed:
            raise StorageError(errno.EBADF, "cannot be read: it was closed", self._stored.name)
        end = min(offset + length, self._stored.size)
        if offset >= end:
            return b""
        if end - offset >= BLOCK_BYTES or (offset, end) in self._expected:
            return self._exactly(offset, end)
        first, last = offset // BLOCK_BYTES, (end - 1) // BLOCK_BYTES
        blocks = self._kept(range(first, last + 1))
        # A read shorter than a block lies in two blocks at most.
        joined = blocks[first] if first == last else blocks[first] + blocks[last]
        return joined[offset - first * BLOCK_BYTES : end - first * BLOCK_BYTES]

    def prime(self) -> None:
        """Fetch the object's beginning and end, if that was not done yet."""
        self.read(0, 1)

    def expect(self, ranges: Sequence[ByteRange]) -> None:
        """Take note of ranges that will be read in this order. Reading one fetches some of the following ones too."""
        self._expected = {range_: number for number, range_ in enumerate(ranges)}

    def _exactly(self, start: int, end: int) -> bytes:
        """Return the bytes of a range, and fetch them with the next expected ranges if they were not fetched ahead."""
        data = _blocks.get(self._ahead, [start]).get(start, b"")
        if len(data) == end - start:
            return data
        expected = self._expected
        following = islice(expected, expected.get((start, end), len(expected)) + 1, None)
        wanted = [(start, end), *_first_of(following, _AHEAD_BYTES - (end - start))]
        fetched = self._store.read_ranges(self._stored, wanted)
        _blocks.put(self._ahead, {low: part for (low, _), part in zip(wanted[1:], fetched[1:], strict=True)})
        return fetched[0]

    def _kept(self, numbers: Sequence[int]) -> dict[int, bytes]:
        """Return blocks by their numbers. Blocks that are not in the cache are fetched."""
        blocks = _blocks.get(self._owner, numbers)
        missing = {number for number in numbers if number not in blocks}
        if not missing:
            return blocks
        if not self._is_primed:
            size = self._stored.size
            missing |= {0, max(size - BLOCK_BYTES, 0) // BLOCK_BYTES, (size - 1) // BLOCK_BYTES}
        wanted = sorted(missing)
        fetched = self._store.read_ranges(self._stored, [_range(number) for number in wanted])
        self._is_primed = True
        new = dict(zip(wanted, fetched, strict=True))
        _blocks.put(self._owner, new)
        return blocks | new

    def close(self) -> None:
        """Remove its blocks from the cache. May be called twice."""
        self._is_closed = True
        _blocks.forget(self._owner)
        _blocks.forget(self._ahead)


def _range(number: int) -> ByteRange:
    """Return where a block lies; the last one ends with its object."""
    return number * BLOCK_BYTES, (number + 1) * BLOCK_BYTES


def _first_of(ranges: Iterable[ByteRange], most_bytes: int) -> Iterator[ByteRange]:
    """Yield the first of some ranges, as many as have `most_bytes` together."""
    total = 0
    for start, end in ranges:
        total += end - start
        if total > most_bytes:
            return
        yield start, end
