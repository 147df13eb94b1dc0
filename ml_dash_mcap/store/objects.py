"""The stores of the package obstore (memory, S3, Google Cloud, Azure), which is the extra `s3`."""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

try:
    from obstore.exceptions import (
        AlreadyExistsError,
        BaseError,
        PermissionDeniedError,
        PreconditionError,
        UnauthenticatedError,
    )
except ImportError as error:
    raise ImportError("ObjectStore needs the package obstore: pip install 'ml-dash-mcap[s3]'") from error

from ..errors import DestinationExistsError, MissingObjectError, StaleVersionError, StorageError
from .ranges import coalesced, cut
from .safe_paths import folder_name, object_name
from .store import ByteRange, Content, StoredObject

if TYPE_CHECKING:
    from obstore import ObjectMeta
    from obstore.store import ObjectStore as AnyObstore

GAP_BYTES = 1024 * 1024
"""Ranges at most so far apart are fetched by one request, in bytes: waiting for a second one would take longer."""

_MOST_REQUESTS = 8
"""So many requests of one call go on at once."""


class ObjectStore:
    """A store of obstore.

    The server itself checks the conditions of `put_new` and `replace`. Versions are its entity tags. It is pickled if
    the store of obstore is: those of servers are, a MemoryStore is not.

    Example:
        >>> from obstore.store import MemoryStore
        >>> store = ObjectStore(MemoryStore())
        >>> store.put("run/1.mcap", Path("1.mcap"))
        >>> Recording("run", store=store)
    """

    def __init__(self, store: AnyObstore, *, url: str | None = None) -> None:
        """Take a store of obstore, as `obstore.store.from_url` makes it.

        Args:
            store: It holds the credentials and says how often a request is tried.
            url: Its name in error messages; the name of its class by default.
        """
        self._store = store
        self._url = type(store).__name__ if url is None else url

    @property
    def url(self) -> str:
        """The name of the store in error messages."""
        return self._url

    def list(self, prefix: str = "", *, recursive: bool = True) -> Sequence[StoredObject]:
        """Return the objects in a folder, sorted by name; see `Store.list`."""
        folder = folder_name(prefix)
        with self._mapped(folder):
            if recursive:
                metas: Sequence[ObjectMeta] = [meta for page in self._store.list(folder) for meta in page]
            else:
                metas = self._store.list_with_delimiter(folder)["objects"]
        return sorted(map(_stored, metas), key=lambda stored: stored.name)

    def head(self, name: str) -> StoredObject:
        """Return the size, time and version of an object; see `Store.head`."""
        with self._mapped(object_name(name)):
            return _stored(self._store.head(name))

    def read_ranges(self, stored: StoredObject, ranges: Sequence[ByteRange]) -> Sequence[bytes]:
        """Return the bytes of several ranges, fetched at the same time; see `Store.read_ranges`."""
        object_name(stored.name)
        clipped = [(start, max(start, min(end, stored.size))) for start, end in ranges]
        requests = coalesced(clipped, GAP_BYTES)
        parts = dict(zip(requests, _side_by_side(lambda request: self._read(stored, *request), requests), strict=True))
        return [cut(parts, start, end) for start, end in clipped]

    def put(self, name: str, content: Content) -> str:
        """Store an object, also if the name is taken; see `Store.put`."""
        return self._put(name, content, "overwrite")

    def put_new(self, name: str, content: Content) -> str:
        """Store an object if none has the name; see `Store.put_new`. It is sent in one request."""
        return self._put(name, content, "create")

    def replace(self, name: str, content: Content, version: str) -> str:
        """Store an object in the place of one version of it; see `Store.replace`. It is sent in one request."""
        return self._put(name, content, {"e_tag": version})

    def delete(self, name: str) -> None:
        """Remove an object; see `Store.delete`."""
        # Only some stores raise FileNotFoundError for a missing object.
        with self._mapped(object_name(name)), suppress(FileNotFoundError):
            self._store.delete(name)

    def __repr__(self) -> str:
        return f"ObjectStore({self._store!r}, url={self._url!r})"

    def _put(self, name: str, content: Content, mode: Any) -> str:
        object_name(name)
        try:
            with self._mapped(name):
                result = self._store.put(name, content, mode=mode)
        except MissingObjectError as error:
            # obstore means the local file: the object need not be there.
            raise StorageError(errno.ENOENT, "cannot be copied: no such file", str(content)) from error
        return result["e_tag"] or ""

    def _read(self, stored: StoredObject, start: int, end: int) -> bytes:
        """Return one range of one version of an object."""
        with self._mapped(stored.name):
            result = self._store.get(stored.name, options={"range": (start, end), "if_match": stored.version or None})
            return bytes(result.bytes())

    @contextmanager
    def _mapped(self, name: str) -> Iterator[None]:
        """Turn errors of obstore into errors of this library."""
        place = f"{self._url}/{name}"
        try:
            yield
        except FileNotFoundError as error:
            raise MissingObjectError(errno.ENOENT, "no such object", place) from error
        except AlreadyExistsError as error:
            raise DestinationExistsError(errno.EEXIST, "is there already", place) from error
        except PreconditionError as error:
            raise StaleVersionError(errno.ESTALE, "was replaced or removed since", place) from error
        except (PermissionDeniedError, UnauthenticatedError) as error:
            raise StorageError(errno.EACCES, _first_line(error), place) from error
        except BaseError as error:
            raise StorageError(errno.EIO, _first_line(error), place) from error


def _stored(meta: ObjectMeta) -> StoredObject:
    return StoredObject(meta["path"], meta["size"], meta["last_modified"].timestamp(), meta["e_tag"] or "")


def _side_by_side(fetch: Callable[[ByteRange], bytes], requests: Sequence[ByteRange]) -> Sequence[bytes]:
    """Return the bytes that each request fetches. Each request waits for the network on a thread of its own."""
    if len(requests) < 2:
        return [fetch(request) for request in requests]
    with ThreadPoolExecutor(min(len(requests), _MOST_REQUESTS), "ml_dash_mcap store") as threads:
        return list(threads.map(fetch, requests))


def _first_line(error: BaseError) -> str:
    """Return the message of an error, without the dump of Rust's structures that obstore appends."""
    return str(error).partition("\n")[0]
