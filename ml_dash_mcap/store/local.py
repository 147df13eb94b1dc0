"""A folder of this machine as a store."""

from __future__ import annotations

import errno
import os
import re
import shutil
import stat
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from ..errors import DestinationExistsError, MissingObjectError, PrefixError, StaleVersionError, StorageError
from .safe_paths import folder_name, object_name
from .store import ByteRange, Content, StoredObject

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_PART = re.compile(r"\..*\.[0-9a-f]{32}\.part")
"""The name of a file until it is whole. A process that dies leaves such a file behind, and lists leave it out."""

_COPIED_BYTES = 1024 * 1024

_LONGEST_STEM = 50
"""So many letters of an object's name begin the name of its part, so that file systems take that one too."""


class LocalFolder:
    """A folder and the folders below it as a store, for code that takes any store. `Recording(path)` needs no store.

    Files that other programs put there are objects too, except pipes, devices, links that lead nowhere, and files with
    names that stores refuse (see `safe_paths.object_name`). On Windows, `put_new` and `replace` keep their promises
    between the threads of one process only.
    """

    def __init__(self, root: str | Path) -> None:
        """Take the folder's path. The folder is made when the first object is put there."""
        self.root = Path(root).expanduser()
        self._turn_lock = threading.Lock()
        """Held while a version is compared and replaced; `_turn` locks out other processes as well."""

    @property
    def url(self) -> str:
        """The folder's path."""
        return str(self.root)

    def path_of(self, name: str) -> Path:
        """Return the path that an object has, or would have; that of "" is the folder.

        Raises:
            PrefixError: No store takes such a name, for example because it leaves the folder.
        """
        return self.root / folder_name(name)

    def list(self, prefix: str = "", *, recursive: bool = True) -> Sequence[StoredObject]:
        """Return the objects in a folder, sorted by name; see `Store.list`."""
        folder = self.path_of(prefix)
        with _mapped(folder, "listed"):
            entries = [self._entry(path) for path in _files(folder, recursive)]
        return sorted((entry for entry in entries if entry is not None), key=lambda entry: entry.name)

    def head(self, name: str) -> StoredObject:
        """Return the size, time and version of an object; see `Store.head`."""
        path = self.path_of(object_name(name))
        with _mapped(path, "read"):
            entry = self._entry(path)
        if entry is None:
            raise MissingObjectError(errno.ENOENT, "no such object", str(path))
        return entry

    def read_ranges(self, stored: StoredObject, ranges: Sequence[ByteRange]) -> Sequence[bytes]:
        """Return the bytes of several ranges; see `Store.read_ranges`."""
        path = self.path_of(object_name(stored.name))
        with _mapped(path, "read"), path.open("rb") as file:
            if _version(os.fstat(file.fileno())) != stored.version:
                raise StaleVersionError(errno.ESTALE, "was replaced since", str(path))
            return [_read(file, start, min(end, stored.size)) for start, end in ranges]

    def put(self, name: str, content: Content) -> str:
        """Store an object, also if the name is taken; see `Store.put`."""
        return self._put(name, content, lambda path: None)

    def put_new(self, name: str, content: Content) -> str:
        """Store an object if none has the name; see `Store.put_new`."""

        def check(path: Path) -> None:
            if os.path.lexists(path):
                raise DestinationExistsError(errno.EEXIST, "is there already", str(path))

        return self._put(name, content, check)

    def replace(self, name: str, content: Content, version: str) -> str:
        """Store an object in the place of one version of it; see `Store.replace`."""

        def check(path: Path) -> None:
            entry = self._entry(path)
            if entry is None or entry.version != version:
                raise StaleVersionError(errno.ESTALE, "was replaced or removed since", str(path))

        return self._put(name, content, check)

    def delete(self, name: str) -> None:
        """Remove an object; see `Store.delete`."""
        path = self.path_of(object_name(name))
        with _mapped(path, "removed"), suppress(FileNotFoundError, NotADirectoryError), self._turn():
            path.unlink()

    def __reduce__(self) -> tuple[type[LocalFolder], tuple[Path]]:
        """Let it pass between processes: a lock does not, so each process makes its own."""
        return type(self), (self.root,)

    def __repr__(self) -> str:
        return f"LocalFolder({self.url!r})"

    def _put(self, name: str, content: Content, check: Callable[[Path], None]) -> str:
        """Write a file beside an object's path, and rename it to that path unless `check` raises."""
        path = self.path_of(object_name(name))
        if _PART.fullmatch(path.name):
            raise PrefixError(f"name={name!r} is that of a file that is still being written")
        part = path.with_name(f".{path.name[:_LONGEST_STEM]}.{uuid.uuid4().hex}.part")
        with _mapped(path, "written"):
            path.parent.mkdir(parents=True, exist_ok=True)
            try:
                version = _write(part, content)
                with self._turn():
                    check(path)
                    os.replace(part, path)
            except BaseException:
                with suppress(OSError):
                    part.unlink()
                raise
        return version

    @contextmanager
    def _turn(self) -> Iterator[None]:
        """Keep other threads and processes from putting or removing objects meanwhile."""
        with self._turn_lock:
            if fcntl is None:
                yield
                return
            descriptor = os.open(self.root, os.O_RDONLY)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX)  # of the folder itself, because a lock file would stay behind
                yield
            finally:
                os.close(descriptor)

    def _entry(self, path: Path) -> StoredObject | None:
        """Return the size, time and version of a file; None if it is no object."""
        name = path.relative_to(self.root).as_posix()
        try:
            object_name(name)
            status = path.stat()
        except (PrefixError, FileNotFoundError, NotADirectoryError):
            return None
        if not stat.S_ISREG(status.st_mode) or _PART.fullmatch(path.name):
            return None
        return StoredObject(name, status.st_size, status.st_mtime, _version(status))


def _files(folder: Path, recursive: bool) -> Iterator[Path]:
    """Yield all files in a folder, and in those below it; links to folders are not followed."""

    def refuse(error: OSError) -> None:
        if not isinstance(error, (FileNotFoundError, NotADirectoryError)):
            raise error

    for place, names, files in os.walk(folder, onerror=refuse):
        if not recursive:
            names.clear()
        yield from (Path(place, name) for name in files)


def _write(part: Path, content: Content) -> str:
    """Write a file, make sure that it is on the disk, and return its version."""
    with part.open("xb") as file:
        if isinstance(content, Path):
            with _mapped(content, "copied"), content.open("rb") as source:
                shutil.copyfileobj(source, file, _COPIED_BYTES)
        else:
            file.write(content)
        file.flush()
        os.fsync(file.fileno())  # without it, a rename may reach the disk before the content does
    # File systems take times from a clock that steps by some ms, so that two versions could share one.
    now_ns = time.time_ns()
    os.utime(part, ns=(now_ns, now_ns))
    return _version(part.stat())


def _version(status: os.stat_result) -> str:
    return f"{status.st_ino:x}-{status.st_mtime_ns:x}-{status.st_size:x}"


def _read(file: BinaryIO, start: int, end: int) -> bytes:
    if start >= end:
        return b""
    file.seek(start)
    return file.read(end - start)


@contextmanager
def _mapped(path: Path, verb: str) -> Iterator[None]:
    """Turn errors of the system into errors of this library."""
    try:
        yield
    except StorageError:
        raise
    except OSError as error:
        if verb == "read" and isinstance(error, (FileNotFoundError, NotADirectoryError)):
            raise MissingObjectError(error.errno, "no such object", str(path)) from error
        raise StorageError(error.errno, f"cannot be {verb}: {error.strerror}", str(path)) from error
