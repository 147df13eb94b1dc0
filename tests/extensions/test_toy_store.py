"""A store is one class: this one keeps objects in a dictionary, does what every store does, and holds recordings."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

from ml_dash_mcap.errors import DestinationExistsError, MissingObjectError, StaleVersionError, StorageError
from ml_dash_mcap.store.safe_paths import folder_name, object_name
from ml_dash_mcap.store.store import ByteRange, Content, Store, StoredObject
from tests.support.store_laws import StoreLaws
from tests.support.stored_recordings import RecordingLaws, local_run

__all__ = ["local_run"]


class ToyStore:
    """Objects in a dictionary; a version is the number of a change."""

    url = "toy:"

    def __init__(self) -> None:
        self._objects: dict[str, tuple[StoredObject, bytes]] = {}
        self._changes = 0
        self._lock = threading.Lock()

    def list(self, prefix: str = "", *, recursive: bool = True) -> Sequence[StoredObject]:
        folder = f"{folder_name(prefix)}/" if prefix else ""
        with self._lock:
            below = {name: stored for name, (stored, _) in self._objects.items() if name.startswith(folder)}
        return [below[name] for name in sorted(below) if recursive or "/" not in name[len(folder) :]]

    def head(self, name: str) -> StoredObject:
        return self._get(name)[0]

    def read_ranges(self, stored: StoredObject, ranges: Sequence[ByteRange]) -> Sequence[bytes]:
        present, content = self._get(stored.name)
        if present.version != stored.version:
            raise StaleVersionError(0, "was replaced", f"{self.url}/{stored.name}")
        return [content[start:end] for start, end in ranges]

    def put(self, name: str, content: Content) -> str:
        object_name(name)
        data = _data(content)
        with self._lock:
            return self._set(name, data)

    def put_new(self, name: str, content: Content) -> str:
        object_name(name)
        data = _data(content)
        with self._lock:
            if name in self._objects:
                raise DestinationExistsError(0, "is there already", f"{self.url}/{name}")
            return self._set(name, data)

    def replace(self, name: str, content: Content, version: str) -> str:
        object_name(name)
        data = _data(content)
        with self._lock:
            if name not in self._objects or self._objects[name][0].version != version:
                raise StaleVersionError(0, "was replaced", f"{self.url}/{name}")
            return self._set(name, data)

    def delete(self, name: str) -> None:
        with self._lock:
            self._objects.pop(object_name(name), None)

    def _get(self, name: str) -> tuple[StoredObject, bytes]:
        with self._lock:
            try:
                return self._objects[object_name(name)]
            except KeyError as error:
                raise MissingObjectError(2, "no such object", f"{self.url}/{name}") from error

    def _set(self, name: str, data: bytes) -> str:
        self._changes += 1
        stored = StoredObject(name, len(data), time.time(), str(self._changes))
        self._objects[name] = stored, data
        return stored.version


def _data(content: Content) -> bytes:
    try:
        return content.read_bytes() if isinstance(content, Path) else content
    except OSError as error:
        raise StorageError(error.errno, "cannot be copied", str(content)) from error


class TestToyStore(StoreLaws, RecordingLaws):
    @pytest.fixture
    def store(self) -> Store:
        return ToyStore()
