"""The place of an export: a path of this machine, or a name in a store, where files are put when all are written."""

from __future__ import annotations

import contextlib
import errno
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import DestinationExistsError, MissingObjectError
from ..file_names import SEGMENT_SUFFIX
from ..query.places import label, names_of
from ..store.local import LocalFolder
from ..store.safe_paths import object_name, place
from ..store.store import Store, check_store
from . import registry
from .destination import refuse_existing, replacing
from .replacing import HEAD_BYTES, RECORDING, content_that_stays, is_ours, keeper, written_by_others


@dataclass(frozen=True, slots=True)
class Reads:
    """The recording that is read while an export is written, and must not be replaced by it."""

    store: Store | None
    """Where the recording lies; None on this machine."""
    paths: Sequence[Path]
    """Its folders and files; in a store, pure paths."""


def located(dest: str | os.PathLike[str], store: Store | None) -> tuple[Path, Store | None]:
    """Return where a caller wants a result: a path of this machine, and None; or a pure path in a store, and the store.

    Raises:
        PrefixError: No store takes that name.
        UsageError: It is neither text nor a path, or `store` is no store.
    """
    check_store(store)
    if store is None:
        return place(dest, "dest"), None
    [name] = map(object_name, names_of([dest]))
    return (store.path_of(name), None) if isinstance(store, LocalFolder) else (label(name), store)


@contextlib.contextmanager
def destination(path: Path, store: Store | None, format: str, *, overwrite: bool, reads: Reads) -> Iterator[Path]:
    """Give a path of this machine to write to. What is written there is at the destination after the block.

    Args:
        path: Of the destination, as `located` returned it.
        store: Where that lies; None on this machine.
        format: One that is written, or `RECORDING`.
        overwrite: Whether to replace an earlier result of the format.
        reads: The recording that is read meanwhile.

    Raises:
        DestinationExistsError: Something is at the destination that must stay; nothing was written.
    """
    if store is not None:
        names = [read.as_posix() for read in reads.paths] if reads.store is store else []
        with _put_when_whole(store, path.as_posix(), format, overwrite=overwrite, reads=names) as beside:
            yield beside
        return
    sources = reads.paths if reads.store is None else ()
    with replacing(keeper(format, sources)) if overwrite else contextlib.nullcontext():
        refuse_existing(path)
        yield path


@contextlib.contextmanager
def _put_when_whole(store: Store, dest: str, format: str, *, overwrite: bool, reads: Sequence[str]) -> Iterator[Path]:
    """Give a path to write to. After the block, what was written is put into a store; if the block fails, nothing is.

    The files of a folder appear one by one, the file that tells its format last: when that one is there, all are.
    """
    earlier = _at(store, dest)
    if earlier:
        _refuse(store, dest, _reason_to_keep(store, dest, earlier, format, reads) if overwrite else _NOT_OVERWRITTEN)
    above, _, last = dest.rpartition("/")
    with tempfile.TemporaryDirectory(prefix="ml_dash_mcap-") as folder:
        yield Path(folder) / last
        files = [path.relative_to(folder).as_posix() for path in Path(folder).rglob("*") if path.is_file()]
        entry = registry.find(format, "write")
        landmark = f"{last}/{entry.landmark}" if entry is not None else ""
        # False sorts before True, so the landmark is put last.
        files.sort(key=lambda name: (name == landmark, name))
        names = {f"{above}/{name}" if above else name: Path(folder) / name for name in files}
        if earlier and (dest in names) != (dest in earlier):
            _refuse(store, dest, "cannot be replaced: one is a file, the other a folder")
        _put_all(store, names, store.put if overwrite else store.put_new)
    for name in earlier:
        if name not in names:
            store.delete(name)


_NOT_OVERWRITTEN = "is there already; overwrite=True replaces it, or choose another name"


def _put_all(store: Store, names: dict[str, Path], put: Callable[[str, Path], str]) -> None:
    """Put files, in order. If one cannot be put, those before it are removed, unless they may have replaced others."""
    done: list[str] = []
    try:
        for name, path in names.items():
            put(name, path)
            done.append(name)
    except BaseException:
        # `put_new` fails if a name exists, so everything that it put is ours to remove.
        if put == store.put_new:
            for name in done:
                store.delete(name)
        raise


def _at(store: Store, dest: str) -> list[str]:
    """Return the names of the objects at a destination: those in a folder of that name, and that of an object."""
    names = [stored.name for stored in store.list(dest)]
    with contextlib.suppress(MissingObjectError):
        names.append(store.head(dest).name)
    return names


def _reason_to_keep(store: Store, dest: str, earlier: Sequence[str], format: str, reads: Sequence[str]) -> str:
    """Return why what is at a destination must stay, in words; empty if it may be replaced."""
    if any(name == dest or name.startswith(f"{dest}/") for name in reads):
        return "cannot be replaced: it is what is read here, or holds it"
    inside = [name.removeprefix(f"{dest}/") for name in earlier if name != dest]
    reason = content_that_stays(inside, format) if inside else ""
    if not reason and format == RECORDING:
        segments = [name for name in earlier if name.endswith(SEGMENT_SUFFIX)]
        reason = next((written_by_others(name) for name in segments if not is_ours(_head(store, name))), "")
    return f"cannot be replaced: it {reason}" if reason else ""


def _head(store: Store, name: str) -> bytes:
    return store.read_ranges(store.head(name), [(0, HEAD_BYTES)])[0]


def _refuse(store: Store, dest: str, reason: str) -> None:
    if reason:
        raise DestinationExistsError(errno.EEXIST, reason, f"{store.url}/{dest}")
