"""Files and folders that are there when they are whole, and not before."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import shutil
import unicodedata
import uuid
from collections.abc import Callable, Iterable, Iterator
from contextvars import ContextVar
from pathlib import Path

from ..errors import DestinationExistsError, StorageError
from .swap_names import exchange

_LONGEST_NAME = 200

_keep: ContextVar[Callable[[Path], str] | None] = ContextVar("keep", default=None)
"""Returns why what is at a destination must stay; empty if it may be replaced. None where nothing may.

Exporters write to one destination or several, some of which they name themselves; this reaches all of them."""


@contextlib.contextmanager
def replacing(keep: Callable[[Path], str]) -> Iterator[None]:
    """Let the block's destinations replace what is there: the old one stays until the new one is whole.

    Args:
        keep: Returns why what is at a path must stay, in words; empty if it may be replaced.
    """
    token = _keep.set(keep)
    try:
        yield
    finally:
        _keep.reset(token)


@contextlib.contextmanager
def fresh_file(dest: Path) -> Iterator[Path]:
    """Give a path beside `dest` to write to; it gets its name when the block ends, and goes if the block fails.

    Raises:
        DestinationExistsError: There is something at `dest` already.
        StorageError: It cannot be written.
    """
    with _fresh(dest, is_folder=False) as path:
        yield path


@contextlib.contextmanager
def fresh_folder(dest: Path) -> Iterator[Path]:
    """Give an empty folder beside `dest` to write into; it gets its name when the block ends, and goes if that fails.

    Raises:
        DestinationExistsError: There is something at `dest` already, other than an empty folder.
        StorageError: It cannot be written.
    """
    with _fresh(dest, is_folder=True) as path:
        path.mkdir()
        yield path


@contextlib.contextmanager
def _fresh(dest: Path, *, is_folder: bool) -> Iterator[Path]:
    refuse_existing(dest)
    _refuse_other_kind(dest, is_folder)
    beside = dest.parent / f".{dest.name[:_LONGEST_NAME]}.{uuid.uuid4().hex[:8]}.part"
    made = [folder for folder in dest.parents if not folder.exists()]
    try:
        dest.parent.mkdir(parents=True, exist_ok=True)
        yield beside
        refuse_existing(dest)
        _refuse_other_kind(dest, is_folder)
        _put(beside, dest)
    except OSError as error:
        _remove(beside, made)
        if isinstance(error, StorageError):
            raise
        raise StorageError(error.errno, f"cannot be written: {error.strerror}", str(dest)) from error
    except BaseException:
        _remove(beside, made)
        raise


def refuse_existing(dest: Path) -> None:
    """Raise DestinationExistsError if there is something at a path that must stay; an empty folder need not."""
    if _is_empty_folder(dest) or not (dest.exists() or dest.is_symlink()):
        return
    keep = _keep.get()
    if keep is None:
        what = "is there already; overwrite=True (--overwrite) replaces it, or choose another place"
        raise DestinationExistsError(errno.EEXIST, what, str(dest))
    reason = keep(dest)
    if reason:
        raise DestinationExistsError(errno.EEXIST, f"cannot be replaced: it {reason}", str(dest))


def _refuse_other_kind(dest: Path, is_folder: bool) -> None:
    """Raise DestinationExistsError if a file would replace a folder with something in it, or a folder a file."""
    if dest.exists() and dest.is_dir() != is_folder and not _is_empty_folder(dest):
        kinds = ("a folder", "a file")
        there, new = kinds if dest.is_dir() else kinds[::-1]
        what = f"cannot be replaced: it is {there}, and what is written is {new}"
        raise DestinationExistsError(errno.EEXIST, what, str(dest))


def _is_empty_folder(path: Path) -> bool:
    return path.is_dir() and not path.is_symlink() and next(path.iterdir(), None) is None


def _put(new: Path, dest: Path) -> None:
    """Give something its name, and remove what has that name so far; there is always one of the two."""
    if dest.is_dir() and not _is_empty_folder(dest):
        old = new.with_suffix(".old")
        if exchange(new, dest):
            os.replace(new, old)
        else:
            os.replace(dest, old)
            os.replace(new, dest)
        shutil.rmtree(old, ignore_errors=True)
        return
    if dest.is_dir() and not new.is_dir():
        dest.rmdir()
    os.replace(new, dest)


def _remove(path: Path, made: Iterable[Path]) -> None:
    """Remove what was written, and the folders that were made for it, the innermost first."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            path.unlink()
    with contextlib.suppress(OSError):  # somebody else uses one of them now
        for folder in made:
            folder.rmdir()


def name_of(topic: str, suffix: str) -> str:
    """Return a file's name for a topic: no two topics share one, and none leaves its folder.

    Letters and digits of all languages stay, and so do `-`, `_`, blanks and dots inside; all else becomes `%2F` and
    the like.
    """
    inside = "".join(letter if letter.isalnum() or letter in "-_. " else _percent(letter) for letter in topic)
    name = inside if inside[:1] not in (".", " ") else _percent(inside[0]) + inside[1:]
    if len((name + suffix).encode()) > _LONGEST_NAME:
        name = f"{name[: _LONGEST_NAME // 8]}~{_digest(topic)}"
    return name + suffix


def names_of(topics: Iterable[str], suffix: str) -> dict[str, str]:
    """Return a file's name for each of some topics, as `name_of` does; no two differ only in upper and lower case."""
    names: dict[str, str] = {}
    taken: set[str] = set()
    for topic in topics:
        name = name_of(topic, suffix)
        if _folded(name) in taken:
            name = f"{name_of(topic, '')}~{_digest(topic)}{suffix}"
        taken.add(_folded(name))
        names[topic] = name
    return names


def _folded(name: str) -> str:
    """Return what a file system that ignores case, and how accents are spelt, takes a name for."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


def _digest(topic: str) -> str:
    return hashlib.sha256(topic.encode()).hexdigest()[:16]


def _percent(letter: str) -> str:
    return "".join(f"%{byte:02X}" for byte in letter.encode())
