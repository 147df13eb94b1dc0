"""The bytes of one file, wherever it lies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from .store import ByteRange


class ByteSource(Protocol):
    """Gives the bytes of one file by range. Any thread may call it."""

    @property
    def name(self) -> str:
        """The name of the file in error messages."""

    def size(self) -> int:
        """Return how many bytes the file has now; one that is being recorded grows."""

    def stored_bytes(self) -> int:
        """Return how many bytes of storage the file takes: fewer than its size if it has holes."""

    def read(self, offset: int, length: int) -> bytes:
        """Return the bytes of [offset, offset + length); fewer only where the file ends before."""

    def expect(self, ranges: Sequence[ByteRange]) -> None:
        """Take note of ranges, [start, end), that will be read in this order, so that some are fetched together."""

    def beside(self, name: str) -> bytes | None:
        """Return the bytes of another file in the same folder; None if there is none."""

    def close(self) -> None:
        """Close everything that was opened. May be called twice."""
