"""The files of a session, with dreamlake's names."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from typing import Any

from ..errors import UsageError
from .files import Description, Descriptions, Files, Paths


class SessionFiles:
    """Uploads and lists the files of a session: `session.files().upload("model.pt", path="/models")`."""

    __slots__ = ("_files",)

    def __init__(self, files: Files) -> None:
        self._files = files

    def __repr__(self) -> str:
        return f"<SessionFiles: {self._files!r}>"

    def upload(
        self,
        file_path: str | os.PathLike[str],
        *,
        path: str = "/",
        description: str | None = None,
        tags: Iterable[str] | None = None,
        metadata: Mapping[str, Any] | None = None,
    ) -> Description:
        """Copy a file from the disk into a folder of the session; see `Files.upload`."""
        return self._files(path).upload(file_path, description=description, tags=tags, metadata=metadata)

    def list(self, *, path: str | None = None, tags: Iterable[str] | None = None) -> Descriptions:
        """Return descriptions of the files in a folder and below it, sorted by path.

        Args:
            path: The folder; None is all.
            tags: Keep files that have one of them.
        """
        wanted = None if tags is None else set(tags)
        descriptions = self._files(path).list()
        return [file for file in descriptions if not wanted or wanted.intersection(file["tags"])]


class SessionFile:
    """One file of a session: `session.file(file_path="model.pt", prefix="/models").save()`."""

    __slots__ = ("_description", "_dest_path", "_file_id", "_file_path", "_files", "_metadata", "_prefix", "_tags")

    def __init__(
        self,
        files: Files,
        *,
        file_path: str | os.PathLike[str] | None = None,
        prefix: str = "/",
        description: str | None = None,
        tags: Iterable[str] | None = None,
        metadata: Mapping[str, Any] | None = None,
        file_id: str | None = None,
        dest_path: str | os.PathLike[str] | None = None,
    ) -> None:
        """Say which file is meant.

        Args:
            files: Those of the session.
            file_path: A file on the disk, for `save`.
            prefix: The folder in the session.
            description: Kept with the file, as are `tags` and `metadata`.
            file_id: The `id` of a file in the session, for `download` and `delete`.
            dest_path: Where to download to.
        """
        self._files = files
        self._file_path = file_path
        self._prefix = prefix
        self._description = description
        self._tags = tags
        self._metadata = metadata
        self._file_id = file_id
        self._dest_path = dest_path

    def __repr__(self) -> str:
        values = {
            "file_path": self._file_path,
            "prefix": self._prefix,
            "file_id": self._file_id,
            "dest_path": self._dest_path,
        }
        given = [f"{name}={str(value)!r}" for name, value in values.items() if value is not None]
        return f"<SessionFile {', '.join(given)}>"

    def save(self) -> Description:
        """Copy the file from the disk into the session; see `Files.upload`.

        Raises:
            UsageError: No `file_path` was given.
        """
        if self._file_path is None:
            raise UsageError("save() needs to know the file: session.file(file_path=...).save()")
        return SessionFiles(self._files).upload(
            self._file_path, path=self._prefix, description=self._description, tags=self._tags, metadata=self._metadata
        )

    def list(self) -> Descriptions:
        """Return descriptions of the files in the folder `prefix` and below it that have one of the tags, if any."""
        return SessionFiles(self._files).list(path=self._prefix, tags=self._tags)

    def download(self) -> str | Paths:
        """Copy the file `file_id` to `dest_path`, or into the working folder, and return where it lies now.

        Raises:
            UsageError: No `file_id` was given.
            NotFoundError: There is no such file.
        """
        return self._files(self._known()).download(to=self._dest_path)

    def delete(self) -> Description | Descriptions:
        """Delete the file `file_id` and return its `id` and `deletedAt`.

        Raises:
            UsageError: No `file_id` was given.
            NotFoundError: There is no such file.
        """
        return self._files(self._known()).delete()

    def _known(self) -> str:
        if self._file_id is None:
            raise UsageError("which file? session.file(file_id=...), where the id is what save() and list() return")
        return self._file_id
