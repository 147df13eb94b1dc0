"""The files of one recorder session besides its segments: its lock, and the buffers of its journal."""

from __future__ import annotations

import errno
import math
import os
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

from ..errors import StorageError
from ..file_names import SESSION_FILE
from ..options import RecorderOptions
from ..store.session_lock import SessionLock
from .buffer import Buffer
from .session_record import SessionRecord, buffer_path

# Files here are memory that outlives the process, and writing to them waits for no disk.
_SHARED_MEMORY = Path("/dev/shm")


class JournalFiles:
    """Made when a recorder opens a run's folder. A crash leaves them behind, and a recovery reads the rows in them."""

    def __init__(self, folder: Path, name: str, options: RecorderOptions, about: Mapping[str, str]) -> None:
        """Lock the session and reserve its buffers.

        Args:
            folder: The run's folder.
            name: The session's name.
            options: The options of the recorder.
            about: The constant part of the `ml_dash` metadata record, for a recovery to repeat.

        Raises:
            StorageError: The folder cannot be written, or there is no room for the backlog.
        """
        self.name = name
        self._folder = folder
        self._options = options
        self.place = folder
        """Where the buffers are."""
        try:
            self._lock = SessionLock.create(folder / SESSION_FILE.format(session=name))
        except OSError as error:
            raise _cannot_write(folder, error) from error
        self.buffers: list[Buffer] = []
        try:
            self._reserve()
            record = SessionRecord.of(name, str(self._path("*")), about, self._lock)
            self._lock.write(record.to_bytes())
        except OSError as error:
            self.remove()
            if isinstance(error, StorageError):
                raise
            raise _cannot_write(folder, error) from error
        except BaseException:
            self.remove()
            raise

    def _path(self, number: object) -> Path:
        return buffer_path(self.place, self.name, number)

    def _places(self) -> Iterator[Path]:
        if self._options.journal_dir is not None:
            yield Path(self._options.journal_dir)
            return
        if _SHARED_MEMORY.is_dir() and os.access(_SHARED_MEMORY, os.W_OK):
            yield _SHARED_MEMORY
        yield self._folder

    def _reserve(self) -> None:
        """Reserve all buffers in the first place that has room for them."""
        count = self._options.backlog_bytes // self._options.chunk_bytes
        failures: list[OSError] = []
        for place in self._places():
            self.place = place
            try:
                _check_room(place, count * self._options.chunk_bytes)
                while len(self.buffers) < count:
                    self.buffers.append(Buffer(self._path(len(self.buffers)), self._options.chunk_bytes))
            except OSError as error:
                while self.buffers:
                    self.buffers.pop().discard()
                failures.append(error)
                continue
            return
        raise StorageError(
            f"no room for a backlog of {self._options.backlog_bytes} bytes: "
            + "; ".join(f"{error.filename or 'journal'}: {error.strerror or error}" for error in failures)
            + " (make room, or set backlog_bytes= or journal_dir=)"
        ) from failures[-1]

    def make_large(self, size: int) -> Buffer:
        """Reserve a buffer for one row.

        Raises:
            OSError: There is no room for it.
        """
        # The time makes the name unique in this session: several threads may append large rows at once.
        return Buffer(self._path(f"large{time.monotonic_ns()}"), size, is_large=True)

    def remove(self) -> None:
        """Delete everything: all rows are in finished segments."""
        for buffer in self.buffers:
            buffer.discard()
        self._lock.remove()

    def leave_behind(self) -> None:
        """Let go of the lock and keep the files, for a recovery."""
        self._lock.release()


def _cannot_write(folder: Path, error: OSError) -> StorageError:
    return StorageError(error.errno, f"cannot write to the recording's folder: {error.strerror}", str(folder))


def _check_room(place: Path, size: int) -> None:
    """Check the room before anything is reserved: too many buffers would take all memory before the last of them fails.

    Args:
        place: The folder of the buffers.
        size: Of all of them, in bytes.

    Raises:
        OSError: The folder's file system has less room; for shared memory, also if the machine has less memory.
    """
    if hasattr(os, "statvfs"):
        status = os.statvfs(place)
        # Some file systems report no size at all; posix_fallocate() has the last word there.
        if status.f_blocks and size > status.f_bavail * status.f_frsize:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(place))
    # The limit of /dev/shm may exceed the memory that is free, and the system would then kill a process to get it.
    if place == _SHARED_MEMORY and size > _available_memory():
        raise OSError(errno.ENOMEM, os.strerror(errno.ENOMEM), str(place))


def _available_memory() -> float:
    """Return how much memory programs can still get, in bytes; infinite if the system does not say."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        return math.inf
    kib = [line.split()[1] for line in lines if line.startswith("MemAvailable:")]
    return int(kib[0]) * 1024 if kib else math.inf
