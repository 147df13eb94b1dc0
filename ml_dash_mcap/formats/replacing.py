"""Decides what an export may replace at its destination: only an earlier result of its own format."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable
from pathlib import Path

from ..errors import OptionError
from ..file_names import SESSION_GLOB
from ..mcap.records import MAGIC
from ..store.session_lock import SessionLock
from ..version import LIBRARY
from . import registry

RECORDING = "recording"
"""Stands for the folder of a recording, which `convert` makes, where otherwise a format is named."""

_OF_RECORDINGS = registry.Format(RECORDING, contents=registry.OF_RECORDINGS)

_OF_DESKTOPS = (".DS_Store", "Thumbs.db", "desktop.ini")
_LIBRARY = LIBRARY.split()[0].encode()
HEAD_BYTES = 1024
"""An MCAP file has the name of its library within its first bytes, and these are more than enough."""
_MOST_FILES = 100_000
"""No more names of a folder are looked at, so a folder with more files is not replaced."""

Keep = Callable[[Path], str]
"""Returns why what is at a path must stay, in words; empty if it may be replaced."""


def keeper(format: str, sources: Iterable[Path]) -> Keep:
    """Return a function that says why a path must not be replaced by a result of a format.

    Args:
        format: The name of a format, or `RECORDING`.
        sources: The files and folders that are read meanwhile.
    """
    read = [path.resolve() for path in sources]

    def keep(path: Path) -> str:
        # Replacing a link would replace the link and not what it leads to.
        if path.is_symlink():
            return "is a link; export to where it leads, or remove it"
        place = path.resolve()
        if any(place == source or place in source.parents for source in read):
            return "is what is read here, or holds it"
        if path.is_dir():
            return _reason_to_keep_folder(path, format)
        return "" if path.is_file() else "is neither a file nor a folder"

    return keep


def check_overwrite(overwrite: object) -> None:
    """Raise OptionError if `overwrite` is neither True nor False."""
    if not isinstance(overwrite, bool):
        raise OptionError(f"overwrite={overwrite!r}: it must be True or False")


def content_that_stays(names: Iterable[str], format: str) -> str:
    """Return why a folder must not be replaced by a result of a format, in words; empty if it may be.

    Args:
        names: The names of all files below the folder, relative to it.
        format: One that is written, or `RECORDING`.
    """
    entry = registry.find(format, "write") or _OF_RECORDINGS
    pattern = re.compile(entry.contents)
    needed = entry.landmark
    for number, name in enumerate(names):
        if number == _MOST_FILES:
            return f"is a folder with more than {_MOST_FILES} files; remove it yourself, or choose another place"
        if name == needed:
            needed = ""
        if not pattern.fullmatch(name) and name.rpartition("/")[2] not in _OF_DESKTOPS:
            content = "a recording" if format == RECORDING else f"what {format!r} writes"
            return f"is a folder that holds more than {content}: {name}; remove it yourself, or choose another place"
    return f"is a folder without the {needed} that {format!r} writes, so it is something else" if needed else ""


def _reason_to_keep_folder(folder: Path, format: str) -> str:
    reason = content_that_stays(_files(folder), format)
    if reason:
        return reason
    if format == RECORDING:
        foreign = next((path.name for path in folder.glob("*.mcap*") if not is_ours(_head(path))), None)
        if foreign is not None:
            return written_by_others(foreign)
    if any(SessionLock.is_held(path) for path in folder.glob(SESSION_GLOB)):
        return "is being recorded"
    if next(folder.glob(SESSION_GLOB), None) is not None:
        return "has rows that a crashed recorder left; open or recover it before you replace it"
    return ""


def _files(folder: Path) -> Iterable[str]:
    """Yield the names of all files below a folder, relative to it. Links to folders count as files."""
    for place, names, files in os.walk(folder):
        inside = Path(place).relative_to(folder)
        # `os.walk` does not go into links, so they must be named or they would be removed unseen.
        links = [name for name in names if os.path.islink(os.path.join(place, name))]
        yield from ((inside / name).as_posix() for name in (*files, *links))


def written_by_others(name: str) -> str:
    """Return why a folder with such an MCAP file must not be replaced."""
    return f"is a folder with an MCAP file that another program wrote: {name}"


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(HEAD_BYTES)


def is_ours(head: bytes) -> bool:
    """Whether the header of an MCAP file (https://mcap.dev/spec#header-op0x01) names this library.

    Args:
        head: The first `HEAD_BYTES` of the file, or all of a shorter one.
    """
    begin = len(MAGIC) + 1 + 8  # the record's opcode and length
    begin += 4 + int.from_bytes(head[begin : begin + 4], "little")  # the profile
    return head.startswith(MAGIC) and head[begin + 4 :].startswith(_LIBRARY)
