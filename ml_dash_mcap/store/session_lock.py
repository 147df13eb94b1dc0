"""The exclusive lock on a session file, by which others see whether its recorder lives."""

from __future__ import annotations

import os
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


class SessionLock:
    """The lock of one recorder's session file. The system releases it when the process ends, however that happens."""

    def __init__(self, path: Path, descriptor: int) -> None:
        self.path = path
        self._descriptor: int | None = descriptor

    @classmethod
    def create(cls, path: Path) -> SessionLock:
        """Make a new session file and hold its lock.

        Raises:
            OSError: The file is there already, or the folder cannot be written.
        """
        # O_CLOEXEC: a program that this process starts must not inherit the descriptor, and the lock with it.
        lock = cls(path, os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_CLOEXEC", 0), 0o644))
        lock._hold()
        return lock

    @classmethod
    def seize(cls, path: Path) -> SessionLock | None:
        """Take over the lock of a dead recorder; None if the recorder lives, or if the file cannot be locked."""
        try:
            lock = cls(path, os.open(path, os.O_RDWR | getattr(os, "O_CLOEXEC", 0)))
        except OSError:
            return None
        try:
            lock._hold()
        except OSError:
            lock.release()
            return None
        if not path.exists():  # another process took it over first, finished the recovery and removed the file
            lock.release()
            return None
        return lock

    @classmethod
    def is_held(cls, path: Path) -> bool:
        """Whether a living recorder holds the lock of a session file."""
        lock = cls.seize(path)
        if lock is not None:
            lock.release()
        return lock is None and path.exists()

    def _hold(self) -> None:
        assert self._descriptor is not None
        if fcntl is not None:
            # Not lockf: its locks belong to the process. A second recorder of this process would get the lock, too,
            # and closing any descriptor of the file would release it.
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        else:
            import msvcrt

            msvcrt.locking(self._descriptor, msvcrt.LK_NBLCK, 1)

    @property
    def inode(self) -> int:
        """The inode of the session file: a copy of the file has another one."""
        assert self._descriptor is not None
        return os.fstat(self._descriptor).st_ino

    def write(self, content: bytes) -> None:
        """Replace the content of the session file."""
        assert self._descriptor is not None
        os.ftruncate(self._descriptor, 0)
        os.lseek(self._descriptor, 0, os.SEEK_SET)
        os.write(self._descriptor, content)

    def release(self) -> None:
        """Release the lock and keep the file. May be called twice."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def remove(self) -> None:
        """Delete the session file and release its lock."""
        # Deleted while it is locked, so that nobody takes the file over in between.
        self.path.unlink(missing_ok=True)
        self.release()
