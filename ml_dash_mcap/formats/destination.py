"""Makes files and folders appear at their destination when they are whole."""

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
"""Returns why what is at a destination must stay; empty if it may be replaced. None if nothing may be replaced.

It is a context variable, because an exporter may write several files, and names some of them itself. A parameter would
have to pass through all exporters."""


@contextlib.contextmanager
def replacing(keep: Callable[[Path], str]) -> Iterator[None]:
    """Let destinations that are written in the block replace what is there, once the new file or folder is whole.

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
    """Give a path beside `dest` to write a file to. The file moves to `dest` when the block ends.

    If the block fails, the file is removed.

    Raises:
        DestinationExistsError: There is something at `dest` already.
        StorageError: It cannot be written.
    """
    with _fresh(dest, is_folder=False) as path:
        yield path


@contextlib.contextmanager
def fresh_folder(dest: Path) -> Iterator[Path]:
    """Give an empty folder beside `dest` to write into. The folder moves to `dest` when the block ends.

    If the block fails, the folder is removed.

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
    # In the same folder, so that the move is a rename within one file system, which happens in one step.
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
    """Raise DestinationExistsError if something at a path must stay. An empty folder may always be replaced."""
    if _is_empty_folder(dest) or not (dest.exists() or dest.is_symlink()):
        return
    keep = _keep.get()
    if keep is None:
        problem = "is there already; overwrite=True (--overwrite) replaces it, or choose another place"
        raise DestinationExistsError(errno.EEXIST, problem, str(dest))
    reason = keep(dest)
    if reason:
        raise DestinationExistsError(errno.EEXIST, f"cannot be replaced: it {reason}", str(dest))


def _refuse_other_kind(dest: Path, is_folder: bool) -> None:
    """Raise DestinationExistsError if a file would replace a folder that is not empty, or a folder a file."""
    if dest.exists() and dest.is_dir() != is_folder and not _is_empty_folder(dest):
        kinds = ("a folder", "a file")
        present, new = kinds if dest.is_dir() else kinds[::-1]
        problem = f"cannot be replaced: it is {present}, and what is written is {new}"
        raise DestinationExistsError(errno.EEXIST, problem, str(dest))


def _is_empty_folder(path: Path) -> bool:
    return path.is_dir() and not path.is_symlink() and next(path.iterdir(), None) is None


def _put(new: Path, dest: Path) -> None:
    """Move a new file or folder to its destination, and then remove the old one."""
    if dest.is_dir() and not _is_empty_folder(dest):
        old = new.with_suffix(".old")
        # A folder that is not empty cannot be replaced by `rename`; without the exchange there is a moment with
        # nothing at `dest`.
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
    """Remove what was written, and the folders that were made for it, from the innermost on."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            path.unlink()
    with contextlib.suppress(OSError):  # another process has put something into one of them
        for folder in made:
            folder.rmdir()


def name_of(topic: str, suffix: str) -> str:
    """Return a file's name for a topic. No two topics share a name, and no name leaves its folder.

    Letters and digits of all languages stay as they are, and so do `-`, `_`, blanks and dots inside the name. All other
    characters are spelt like `%2F`.
    """
    inside = "".join(letter if letter.isalnum() or letter in "-_. " else _percent(letter) for letter in topic)
    name = inside if inside[:1] not in (".", " ") else _percent(inside[0]) + inside[1:]
    if len((name + suffix).encode()) > _LONGEST_NAME:
        # A letter has up to 4 bytes in UTF-8, so few of them are kept; the digest keeps the names apart.
        name = f"{name[: _LONGEST_NAME // 8]}~{_digest(topic)}"
    return name + suffix


def names_of(topics: Iterable[str], suffix: str) -> dict[str, str]:
    """Return a file's name for each of some topics, as `name_of` does. No two names differ only in case."""
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
    """Return one form for all names that some file systems take for the same: they ignore case and forms of accents."""
    # Twice, because `casefold` may take a composed letter apart (Unicode, section 3.13).
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


def _digest(topic: str) -> str:
    return hashlib.sha256(topic.encode()).hexdigest()[:16]


def _percent(letter: str) -> str:
    return "".join(f"%{byte:02X}" for byte in letter.encode())
