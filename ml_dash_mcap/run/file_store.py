"""The files of one run on disk, and the rows of topic `ml_dash/files` that describe them."""

from __future__ import annotations

import hashlib
import mimetypes
import os
import shutil
import threading
import uuid
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Protocol

from ..errors import NotFoundError, StorageError
from ..file_names import FILE_TOPIC
from ..rows import json_text
from .utc import now_text, text_of

_PARTIAL = ".ml_dash-partial-"
"""How the names of files begin that are still being written."""


class FileRows(Protocol):
    """Where the rows about files go, and where they are read back."""

    def append(self, row: dict[str, Any]) -> None:
        """Take one row of the topic.

        Raises:
            StateError: The recording is closed.
        """

    def rows(self) -> Iterable[dict[str, Any]]:
        """Return all rows of the topic, the oldest first."""

    def check_open(self) -> None:
        """Raise StateError if the recording is closed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Details:
    """The description of a file that a caller gives."""

    description: str | None = None
    tags: tuple[str, ...] = ()
    bindrs: tuple[str, ...] = ()
    metadata: dict[str, Any] | None = None

    def fields(self) -> dict[str, Any]:
        """Return the description as fields of a row, without the parts that were not given."""
        row: dict[str, Any] = {"description": self.description, "tags": list(self.tags), "bindrs": list(self.bindrs)}
        row["metadata"] = self.metadata
        return {name: value for name, value in row.items() if value}


class FileStore:
    """Saves, finds and deletes files in one folder; any thread may call it.

    A file is written beside its place and then moved there, so that nobody sees half a file. It is not synced: after
    a power failure it may be missing or damaged, which its SHA-256 in the recording tells.
    """

    def __init__(self, folder: Path, rows: FileRows, owner: str) -> None:
        """Make a store; the folder is made with the first file.

        Args:
            folder: The run's folder `files/`.
            rows: Where the rows go.
            owner: The run's prefix.
        """
        self.folder = folder
        self._rows = rows
        self._owner = owner
        self._order_lock = threading.Lock()
        """Keeps the order of the rows of a path the order in which its files replaced each other."""

    def save(self, path: PurePosixPath, write: Callable[[Path], None], details: Details) -> dict[str, Any]:
        """Save a file that `write` writes to the place it is given, and return what `describe` says of it.

        Args:
            path: Checked, relative to the folder.
            write: Called once.
            details: What the caller says about the file.

        Raises:
            StateError: The recording is closed.
            FieldError: The details cannot be stored.
            StorageError: The folder or the file cannot be written.
        """
        self._rows.check_open()
        fields = details.fields()
        json_text.exact(fields, FILE_TOPIC)  # a mistake in them should not leave a file without its row
        target = self.folder.joinpath(path)
        with _storage_errors(f"cannot save {path}"), self._beside(target) as partial:
            write(partial)
            row = {"path": str(path), "bytes": partial.stat().st_size, "sha256": sha256(partial), **fields}
            row = {**row, "content_type": content_type(path.name), "saved": now_text()}
            # The row follows its file. A crash between both leaves a file without a row, which `_measured` describes,
            # and never a row without a file.
            with self._order_lock:
                os.replace(partial, target)
                self._rows.append(row)
        return self._description(row)

    def delete(self, path: PurePosixPath) -> dict[str, Any]:
        """Delete a file and return its `id` and `deletedAt`.

        Raises:
            StateError: The recording is closed.
            NotFoundError: There is no such file.
        """
        self._rows.check_open()
        source = self.folder / self.find(path)
        with _storage_errors(f"cannot delete {path}"), self._order_lock:
            row = {"path": str(path), "bytes": source.stat().st_size, "sha256": "", "deleted": True}
            row = {**row, "content_type": content_type(path.name), "saved": now_text()}
            source.unlink()
            self._rows.append(row)
        return {"id": str(path), "deletedAt": row["saved"]}

    def find(self, path: PurePosixPath) -> Path:
        """Return where a file lies.

        Raises:
            NotFoundError: There is no such file.
        """
        place = self.folder.joinpath(path)
        if not place.is_file():
            raise NotFoundError(f"no file {str(path)!r} in {self.folder}; files(...).list() gives those there are")
        return place

    def copy(self, path: PurePosixPath, to: Path, expected: str) -> str:
        """Copy a file out of the store and return where it lies now.

        Args:
            path: The file in the store.
            to: The new file, or a folder that exists.
            expected: The SHA-256 that it was saved with; empty if it is unknown.

        Raises:
            NotFoundError: There is no such file.
            StorageError: It cannot be written, or its content is not what was saved.
        """
        place = self.find(path)
        target = to / path.name if to.is_dir() else to
        with _storage_errors(f"cannot copy {path} to {target}"), self._beside(target) as partial:
            shutil.copyfile(place, partial)
            if expected and sha256(partial) != expected:
                raise StorageError(f"{place} is damaged: its SHA-256 is not the {expected} that was saved")
            os.replace(partial, target)
        return str(target)

    def list(self, below: PurePosixPath) -> list[dict[str, Any]]:
        """Return what is known about each file below a folder, or about that file, sorted by path.

        The files come from the disk, and their descriptions from the recording.
        """
        rows = self._last_rows()
        return [self._description(rows.get(str(path)) or self._measured(path)) for path in self._walk(below)]

    def _walk(self, below: PurePosixPath) -> Iterator[PurePosixPath]:
        start = self.folder.joinpath(below)
        places = [start] if start.is_file() else sorted(start.rglob("*"))
        for path in places:
            if path.is_file() and not path.name.startswith(_PARTIAL):
                yield PurePosixPath(path.relative_to(self.folder).as_posix())

    def _last_rows(self) -> dict[str, dict[str, Any]]:
        last = {row["path"]: row for row in self._rows.rows() if isinstance(row.get("path"), str)}
        return {path: row for path, row in last.items() if not row.get("deleted")}

    def _measured(self, path: PurePosixPath) -> dict[str, Any]:
        """Return the row that a file without one would have: somebody put it there by hand."""
        place = self.folder.joinpath(path)
        status = place.stat()
        row = {"path": str(path), "bytes": status.st_size, "sha256": sha256(place)}
        return {**row, "content_type": content_type(path.name), "saved": text_of(status.st_mtime)}

    def _description(self, row: dict[str, Any]) -> dict[str, Any]:
        """Return a row in the shape in which ml-dash describes a file."""
        path = PurePosixPath(row["path"])
        parent = str(path.parent)
        return {
            "id": str(path),
            "experimentId": self._owner,
            "path": "/" if parent == "." else f"/{parent}",
            "filename": path.name,
            "description": row.get("description"),
            "tags": row.get("tags", []),
            "bindrs": row.get("bindrs", []),
            "contentType": row.get("content_type", ""),
            "sizeBytes": row.get("bytes", 0),
            "checksum": row.get("sha256", ""),
            "metadata": row.get("metadata"),
            "uploadedAt": row.get("saved"),
            "updatedAt": row.get("saved"),
            "deletedAt": None,
        }

    @contextmanager
    def _beside(self, target: Path) -> Iterator[Path]:
        """Give a place in the target's folder to write to, and clear it away if it is still there afterwards."""
        target.parent.mkdir(parents=True, exist_ok=True)
        suffix = target.suffix if len(target.suffix) <= 16 else ""  # writers of images choose the format by it
        partial = target.parent / f"{_PARTIAL}{uuid.uuid4().hex}{suffix}"
        try:
            yield partial
        finally:
            with suppress(FileNotFoundError):
                partial.unlink()


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file's content, in hexadecimal digits."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def content_type(name: str) -> str:
    """Return the media type that a file's name suggests."""
    return mimetypes.guess_type(name)[0] or "application/octet-stream"


@contextmanager
def _storage_errors(what: str) -> Iterator[None]:
    try:
        yield
    except StorageError:
        raise
    except OSError as error:
        raise StorageError(f"{what}: {error}") from error
