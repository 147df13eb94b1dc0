"""The bytes of one file, wherever it lies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from .store import ByteRange


class ByteSource(Protocol):
    """Where a file's bytes come from; every call says which range it wants."""

    @property
    def name(self) -> str:
        """What error messages call it."""

    def size(self) -> int:
        """Return how many bytes there are now; a file that is being recorded grows."""

    def stored_bytes(self) -> int:
        """Return how many bytes are really stored: of a file with holes, fewer than its size."""

    def read(self, offset: int, length: int) -> bytes:
        """Return the bytes of [offset, offset + length); fewer only where the file ends before."""

    def expect(self, ranges: Sequence[ByteRange]) -> None:
        """Take note of ranges, each [start, end), that will be read one after another: some may be fetched together."""

    def beside(self, name: str) -> bytes | None:
        """Return the bytes of another file in the same folder; None if there is none."""

    def close(self) -> None:
        """Let go of what was opened. May be called twice."""
