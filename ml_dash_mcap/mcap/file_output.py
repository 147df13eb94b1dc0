"""The destination of an MCAP file's bytes while it is written: a file that grows at its end, or memory."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

Piece = bytes | memoryview

# O_BINARY: Windows would write two bytes for a newline.
_FLAGS = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)


class Output(Protocol):
    """Takes bytes, one piece behind the other."""

    @property
    def size(self) -> int:
        """Bytes so far."""

    def write(self, *pieces: Piece) -> None:
        """Take some pieces, all of them or none."""


class MemoryOutput:
    """Keeps what is written in memory."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self._data = bytearray()

    @property
    def size(self) -> int:
        """Bytes so far."""
        return len(self._data)

    def write(self, *pieces: Piece) -> None:
        """Take some pieces."""
        for piece in pieces:
            self._data += piece

    def data(self) -> bytes:
        """Return everything."""
        return bytes(self._data)


class FileOutput:
    """A local file. One thread at a time uses it.

    A call that fails leaves the file as it was before: bytes of the failed write are cut off.
    """

    def __init__(self, path: Path, flags: int, size: int = 0, mode: int = 0o666) -> None:
        """Open a file.

        Args:
            path: Where it is.
            flags: Flags for `os.open`: whether to create the file, and whether it may be there already.
            size: How much of it stays, in bytes; writing goes on there.
            mode: The permissions of a new file.
        """
        self._descriptor = os.open(path, flags | _FLAGS, mode)
        self.size = size

    @classmethod
    def create(cls, path: Path) -> FileOutput:
        """Begin a file, in the place of one that may be there."""
        return cls(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)

    def write(self, *pieces: Piece) -> None:
        """Write all pieces behind what is there, or nothing."""
        # A write that failed may have left the position behind the end.
        os.lseek(self._descriptor, self.size, os.SEEK_SET)
        try:
            self.size += _write_all(self._descriptor, [memoryview(piece) for piece in pieces])
        except BaseException:
            self.cut(self.size)
            raise

    def overwrite(self, at: int, data: bytes) -> None:
        """Write over bytes that are there already."""
        os.lseek(self._descriptor, at, os.SEEK_SET)
        _write_all(self._descriptor, [memoryview(data)])

    def trim(self) -> None:
        """Cut off the bytes behind `size` of a failed write that could not be cut off at once."""
        os.ftruncate(self._descriptor, self.size)

    def cut(self, size: int) -> None:
        """Go back to an earlier size, as far as the system lets us."""
        self.size = size
        with contextlib.suppress(OSError):
            os.ftruncate(self._descriptor, size)

    def sync(self) -> None:
        """Wait until all written bytes would survive a power cut."""
        # fdatasync leaves out the file's times, which no reader needs; macOS has fsync only.
        getattr(os, "fdatasync", os.fsync)(self._descriptor)

    def close(self) -> None:
        """Close the file. May be called twice."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)


def _write_all(descriptor: int, pieces: list[memoryview]) -> int:
    """Write pieces one after the other, however many calls the system wants for that."""
    total = 0
    write: Callable[[int, list[memoryview]], int] = getattr(os, "writev", lambda fd, parts: os.write(fd, parts[0]))
    while pieces:
        # Linux and macOS take at most 1024 pieces in a call (IOV_MAX).
        done = write(descriptor, pieces[:512])
        total += done
        while pieces and done >= len(pieces[0]):
            done -= len(pieces.pop(0))
        if done:
            pieces[0] = pieces[0][done:]
    return total


def sync_folder(folder: Path) -> None:
    """Make a rename in a folder survive a power cut, where the system can."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
