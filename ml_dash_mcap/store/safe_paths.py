"""Paths and names that callers give, checked so that none leaves its root folder or store."""

from __future__ import annotations

import os
import re
import unicodedata
from pathlib import Path

from ..errors import PrefixError, UsageError

LONGEST_COMPONENT_BYTES = 255
"""The longest name of a folder or file that the file systems of Linux, macOS and Windows take."""

_DRIVE = re.compile(r"[A-Za-z]:")


def place(given: object, what: str) -> Path:
    """Return a path that a caller gives, with `~` replaced by the user's home.

    Args:
        given: Text or a path.
        what: The name of the argument, for the error message: "path", "dest", ...

    Raises:
        UsageError: It is neither text nor a path.
    """
    if not isinstance(given, (str, os.PathLike)):
        raise UsageError(f"{what}={given!r} is of type {type(given).__name__}; pass a path, as text or a Path")
    return Path(given).expanduser()


def run_folder(root: str | os.PathLike[str], prefix: str) -> Path:
    """Return the folder of a run, `<root>/<prefix>`.

    Args:
        root: The folder of all recordings.
        prefix: Names joined by `/`, such as "alice/franka/pick-place".

    Raises:
        PrefixError: The prefix is empty, absolute, leaves the root or cannot be a folder's name.
        UsageError: The prefix is not text.
    """
    return Path(root).joinpath(*components(prefix, "prefix"))


def components(name: str, what: str) -> list[str]:
    """Split a name at its slashes into the names of folders and files, and check each.

    Args:
        name: Relative, with `/` between its parts on every system.
        what: The kind of name, for the error message: "prefix", "file name", ...

    Raises:
        PrefixError: See `run_folder`.
        UsageError: The name is not text.
    """
    if not isinstance(name, str):
        raise UsageError(f"{what}={name!r} is of type {type(name).__name__}; pass text such as 'alice/franka/demo'")
    if not name:
        raise PrefixError(f"{what}={name!r} is empty; pass text such as 'alice/franka/demo'")
    if name.startswith("/") or _DRIVE.match(name):
        raise PrefixError(f"{what}={name!r} is an absolute path; pass one that is relative to its root folder")
    parts = name.split("/")
    for part in parts:
        fault = _fault(part)
        if fault:
            raise PrefixError(f"{what}={name!r} {fault}")
    return parts


def object_name(name: str) -> str:
    """Check the name of an object in a store, and return it.

    It is relative, has `/` between its parts on every system, and no part that leads upwards.

    Args:
        name: Such as "alice/run-1/20260101T000000Z_000001.mcap".

    Raises:
        PrefixError: It would leave the store, or some file system or object store refuses such a name.
        UsageError: It is not text.
    """
    components(name, "name")
    control = next((letter for letter in name if unicodedata.category(letter) == "Cc"), None)
    if control is not None:
        raise PrefixError(f"name={name!r} has the control character {control!r}, which object stores refuse")
    return name


def folder_name(prefix: str) -> str:
    """Check the name of a folder in a store as `object_name` does, and return it; "" is the whole store."""
    return "" if prefix == "" else object_name(prefix)


def _fault(part: str) -> str:
    """Return why one part of a name cannot name a folder or file, in words; empty if it can."""
    if not part:
        return "has an empty part; put one slash between its parts, none at the end"
    if part in (".", ".."):
        return f"has the part {part!r}, which could leave the root folder; spell the parts out"
    if "\\" in part:
        return "has a backslash, which separates folders on Windows; use '/'"
    if "\0" in part:
        return "has a NUL character, which no file system takes"
    try:
        length = len(part.encode())
    except UnicodeEncodeError:
        return "has a lone surrogate, which is not text"
    if length > LONGEST_COMPONENT_BYTES:
        return f"has a part of {length} bytes; file systems take {LONGEST_COMPONENT_BYTES} (it starts {part[:20]!r})"
    return ""
