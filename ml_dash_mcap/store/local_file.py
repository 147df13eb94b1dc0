"""The bytes of a file of this machine, by range."""

from __future__ import annotations

import errno
import os
import stat
import threading
import weakref
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path

from ..errors import DamagedFileError, MissingRecordingError, StorageError
from .store import ByteRange


class LocalFile:
    """A file on this machine, closed with `close()` or when its last reference goes. Any thread may read from it.

    Of many files only those that were read last hold a descriptor, because systems allow a process some hundreds. The
    others are opened again by their paths, and it is an error if another file is there by then.

    Attributes:
        bytes_read: How many bytes were read so far. Tests check that no more is read than needed.
        reads: How many calls of the system that took.
    """

    def __init__(self, path: str | Path, *, stays_open: bool = False) -> None:
        """Open the file.

        Args:
            path: Where it is.
            stays_open: Whether to keep its descriptor, because the file may be renamed and its path lead nowhere.

        Raises:
            MissingRecordingError: There is no such file.
            StorageError: It cannot be opened.
            DamagedFileError: It is a folder, a pipe or a device.
        """
        self.path = Path(path)
        self.bytes_read = 0
        self.reads = 0
        self._position_lock = threading.Lock()
        """Guards the file's position, on systems that have no `pread`."""
        self._is_closed = False
        self._stays_open = stays_open
        self._handle: _Handle | None = _Handle(self.path)
        self._identity = self._handle.identity()
        _note_use(self)

    @property
    def name(self) -> str:
        """The path."""
        return str(self.path)

    def size(self) -> int:
        """Return how many bytes the file has now."""
        return self._size(self._opened())

    def stored_bytes(self) -> int:
        """Return how many bytes the disk holds: fewer than the size if the file has holes."""
        try:
            status = os.fstat(self._opened().descriptor)
        except OSError as error:
            raise self._error(error) from error
        blocks = getattr(status, "st_blocks", None)  # of 512 bytes each on all file systems; Windows has no such field
        return status.st_size if blocks is None else min(status.st_size, 512 * blocks)

    def expect(self, ranges: Sequence[ByteRange]) -> None:
        """Do nothing: the system reads ahead."""

    def beside(self, name: str) -> bytes | None:
        """Return the bytes of another file in the same folder; None if there is none."""
        path = self.path.with_name(name)
        return path.read_bytes() if path.is_file() else None

    def is_at(self, path: Path) -> bool:
        """Whether a path leads to this file, which may have been renamed since it was opened."""
        return identity(path) == self._identity

    def settle(self, path: Path) -> None:
        """Take the path that the file keeps from now on, so that its descriptor may be closed between reads."""
        self.path = path
        if self._stays_open:
            self._stays_open = False
            if not self._is_closed:
                _note_use(self)

    def read(self, offset: int, length: int) -> bytes:
        """Return the bytes of [offset, offset + length); fewer only where the file ends before.

        Raises:
            DamagedFileError: The disk cannot read them any more.
            StorageError: They cannot be read for another reason.
        """
        handle = self._opened()
        length = min(length, self._size(handle) - offset)  # both may be any number: damaged files name such ranges
        parts: list[bytes] = []
        while length > 0:
            part = self._read_once(handle, offset, length)
            if not part:
                break
            parts.append(part)
            offset += len(part)
            length -= len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def _size(self, handle: _Handle) -> int:
        try:
            return os.fstat(handle.descriptor).st_size
        except OSError as error:
            raise self._error(error) from error

    def _read_once(self, handle: _Handle, offset: int, length: int) -> bytes:
        try:
            if hasattr(os, "pread"):
                # pread has no position that threads would share.
                part = os.pread(handle.descriptor, length, offset)
            else:  # Windows
                with self._position_lock:
                    os.lseek(handle.descriptor, offset, os.SEEK_SET)
                    part = os.read(handle.descriptor, length)
        except OSError as error:
            if error.errno == errno.EIO:
                raise DamagedFileError(self.path, offset, f"the disk cannot read this: {error.strerror}") from error
            raise self._error(error) from error
        self.reads += 1
        self.bytes_read += len(part)
        return part

    def _opened(self) -> _Handle:
        """Return the descriptor, opened again if need be. It stays valid for its holder, whoever closes this object."""
        if self._is_closed:
            raise StorageError(errno.EBADF, "cannot be read: it was closed", str(self.path))
        handle = self._handle
        if handle is None:
            handle = _Handle(self.path)
            if handle.identity() != self._identity:
                raise StorageError(errno.ESTALE, "is another file than when it was opened", str(self.path))
            self._handle = handle
        _note_use(self)
        return handle

    def rest(self) -> None:
        """Let go of the descriptor until the file is read again."""
        self._handle = None

    def _error(self, error: OSError) -> StorageError:
        return StorageError(error.errno, f"cannot be read: {error.strerror}", str(self.path))

    def close(self) -> None:
        """Close the file. May be called twice."""
        self._is_closed = True
        self._handle = None


def identity(path: Path) -> tuple[int, int] | None:
    """Return the device and the inode of a file, which no other file has; None if there is no file."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino


_OPEN_FLAGS = os.O_RDONLY | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NONBLOCK", 0)
"""`O_NONBLOCK`: opening a named pipe would wait until somebody writes into it."""


class _Handle:
    """The descriptor of an open file, closed when its last reference goes."""

    __slots__ = ("descriptor",)

    def __init__(self, path: Path) -> None:
        self.descriptor = -1
        try:
            self.descriptor = os.open(path, _OPEN_FLAGS)
            mode = os.fstat(self.descriptor).st_mode
        except FileNotFoundError as error:
            raise MissingRecordingError(error.errno, "no such file", str(path)) from error
        except OSError as error:
            raise StorageError(error.errno, f"cannot be opened: {error.strerror}", str(path)) from error
        if not stat.S_ISREG(mode):
            raise DamagedFileError(path, 0, "this is no file that can be read: it is a folder, a pipe or a device")

    def identity(self) -> tuple[int, int]:
        """Return the device and the inode of the file."""
        status = os.fstat(self.descriptor)
        return status.st_dev, status.st_ino

    def __del__(self) -> None:
        if self.descriptor >= 0:
            os.close(self.descriptor)


_OPEN: OrderedDict[int, weakref.ref[LocalFile]] = OrderedDict()
"""The files that hold a descriptor, those that were used last at the end."""
# Half of what macOS allows a process by default, 256.
_MOST_OPEN = 128
_open_lock = threading.Lock()
"""Guards `_OPEN`."""


def _note_use(file: LocalFile) -> None:
    """Note that a file was used. If too many are open, the one whose use is longest ago lets go of its descriptor."""
    if file._stays_open:
        return
    with _open_lock:
        _OPEN.pop(id(file), None)
        _OPEN[id(file)] = weakref.ref(file)
        oldest = _OPEN.popitem(last=False)[1]() if len(_OPEN) > _MOST_OPEN else None
    if oldest is not None:
        oldest.rest()
