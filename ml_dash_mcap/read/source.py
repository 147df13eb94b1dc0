"""The bytes of a file, by range."""

from __future__ import annotations

import os
import threading
import weakref
from pathlib import Path
from typing import Protocol

from ..errors import MissingRecordingError, StorageError


class Source(Protocol):
    """Where a file's bytes come from; every call says which range it wants."""

    @property
    def name(self) -> str:
        """What error messages call it."""

    def size(self) -> int:
        """Return how many bytes there are now; a file that is being recorded grows."""

    def read(self, offset: int, length: int) -> bytes:
        """Return the bytes of [offset, offset + length); fewer only where the file ends before."""

    def close(self) -> None:
        """Let go of what was opened. May be called twice."""


class LocalFile:
    """A file on this machine, closed with `close()` or when nobody has it any more. Any thread may read from it.

    Attributes:
        bytes_read: How much was read so far, in bytes, for the tests that hold us to reading little.
        reads: How many reads that took.
    """

    def __init__(self, path: str | Path) -> None:
        """Open the file.

        Raises:
            MissingRecordingError: There is no such file.
            StorageError: It cannot be opened.
        """
        self.path = Path(path)
        self.bytes_read = 0
        self.reads = 0
        self._position_lock = threading.Lock()
        try:
            self._descriptor = os.open(self.path, os.O_RDONLY | getattr(os, "O_BINARY", 0))
        except FileNotFoundError as error:
            raise MissingRecordingError(error.errno, "no such file", str(path)) from error
        except OSError as error:
            raise StorageError(error.errno, f"cannot be opened: {error.strerror}", str(path)) from error
        self._closing = weakref.finalize(self, os.close, self._descriptor)

    @property
    def name(self) -> str:
        """The path."""
        return str(self.path)

    def size(self) -> int:
        """Return how many bytes the file has now."""
        try:
            return os.fstat(self._descriptor).st_size
        except OSError as error:
            raise self._error(error) from error

    def is_at(self, path: Path) -> bool:
        """Whether a path leads to this very file, which may have been renamed since it was opened."""
        try:
            return os.path.samestat(os.fstat(self._descriptor), path.stat())
        except OSError:
            return False

    def read(self, offset: int, length: int) -> bytes:
        """Return the bytes of [offset, offset + length); fewer only where the file ends before."""
        parts: list[bytes] = []
        while length > 0:
            part = self._read_once(offset, length)
            if not part:
                break
            parts.append(part)
            offset += len(part)
            length -= len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def _read_once(self, offset: int, length: int) -> bytes:
        try:
            if hasattr(os, "pread"):
                part = os.pread(self._descriptor, length, offset)
            else:  # Windows
                with self._position_lock:
                    os.lseek(self._descriptor, offset, os.SEEK_SET)
                    part = os.read(self._descriptor, length)
        except OSError as error:
            raise self._error(error) from error
        self.reads += 1
        self.bytes_read += len(part)
        return part

    def _error(self, error: OSError) -> StorageError:
        return StorageError(error.errno, f"cannot be read: {error.strerror}", str(self.path))

    def close(self) -> None:
        """Close the file. May be called twice."""
        self._descriptor = -1  # whatever gets its number next is not ours to read
        self._closing()
