"""The protocol of a store: whole objects under names, listed, read by range, and replaced on condition."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeAlias

from ..errors import UsageError

Content: TypeAlias = bytes | Path
"""The content of an object: bytes, or the path of a local file, which must not change meanwhile."""

ByteRange: TypeAlias = tuple[int, int]
"""Where a range starts, and where it ends: the end is not included."""


@dataclass(frozen=True, slots=True)
class StoredObject:
    """An object as it was when it was listed or looked at."""

    name: str
    """Relative to its store, with `/` between its parts."""
    size: int
    """In bytes."""
    modified: float
    """When it was written, in s since 1970 (UTC)."""
    version: str
    """Differs from the versions of all other contents under the name. A store may give equal contents one version."""


class Store(Protocol):
    """A place of whole objects: a folder, a bucket, a dictionary.

    Names are relative, have `/` between their parts on every system, and never leave the store. An object appears when
    it is whole, and a reader sees all of one version or nothing of it. Any thread of any process may call everything.

    All methods raise PrefixError for a name that no store takes (see `safe_paths.object_name`), and StorageError for
    whatever else the store refuses. A class that has these methods is a store; it need not inherit from this one, and
    passes `StoreLaws` of the tests.
    """

    @property
    def url(self) -> str:
        """The name of the store in error messages."""

    def list(self, prefix: str = "", *, recursive: bool = True) -> Sequence[StoredObject]:
        """Return the objects in a folder, sorted by name; none if there is no such folder.

        Args:
            prefix: The folder's name: "run" is that of "run/a" and "run/b/c", not of "run" and "run-2/a".
            recursive: Whether those in the folders below it are wanted too.
        """

    def head(self, name: str) -> StoredObject:
        """Return the size, time and version of an object, without its bytes.

        Raises:
            MissingObjectError: There is none.
        """

    def read_ranges(self, stored: StoredObject, ranges: Sequence[ByteRange]) -> Sequence[bytes]:
        """Return the bytes of several ranges, each [start, end); as few requests as that takes.

        Args:
            stored: The object, as `head` or `list` returned it.
            ranges: In any order; the bytes come in the same one. Bytes behind the object's end are left out.

        Raises:
            MissingObjectError: The object is gone.
            StaleVersionError: It was replaced since.
        """

    def put(self, name: str, content: Content) -> str:
        """Store an object, in the place of one that has the name; returns its version."""

    def put_new(self, name: str, content: Content) -> str:
        """Store an object if none has the name: of several callers at once, one does; returns its version.

        Raises:
            DestinationExistsError: An object has the name already.
        """

    def replace(self, name: str, content: Content, version: str) -> str:
        """Store an object in the place of one version of it: of several callers at once, one does.

        Returns:
            Its new version.

        Raises:
            StaleVersionError: The object is another version now, or is gone.
        """

    def delete(self, name: str) -> None:
        """Remove an object; nothing happens if there is none."""


_MEMBERS = sorted(name for name in vars(Store) if not name.startswith("_"))


def check_store(store: object) -> None:
    """Raise UsageError if `store` is neither a store nor None."""
    missing = [name for name in _MEMBERS if not hasattr(store, name)]
    if store is None or not (missing or isinstance(store, type)):
        return
    type_ = type(store)
    if isinstance(store, type):
        advice = f"pass an instance, as {store.__name__}(...) makes it"
    elif type_.__module__.partition(".")[0] == "obstore":
        advice = "pass ObjectStore(...) around it"
    else:
        advice = "pass LocalFolder(path), ObjectStore(...), another object with the methods of Store, or None"
    lacking = f", which has no {missing[0]}" if missing else ""
    raise UsageError(f"store={store!r} is of type {type_.__name__}{lacking}; {advice}")
