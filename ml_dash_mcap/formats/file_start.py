"""Reads what tells the format of a file or folder: its name, its first bytes, its first line, the names inside it."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cached_property
from pathlib import Path

from .text.plain_text import first_line_of

START_BYTES = 4096

Sign = Callable[["FileStart"], bool]
"""Whether what is at a path has a format, by what it begins with."""


class FileStart:
    """The beginning of a file, or the names in a folder. Each part is read once, when it is first asked for."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.name = path.name
        self.suffix = path.suffix.lower()
        self.is_file = path.is_file()

    @cached_property
    def data(self) -> bytes:
        """The first 4,096 bytes; none of a folder, nor of a file that cannot be read."""
        if not self.is_file:
            return b""
        try:
            with self.path.open("rb") as file:
                return file.read(START_BYTES)
        except OSError:
            return b""

    @cached_property
    def first_line(self) -> str:
        """The first line that is not blank, as text."""
        return first_line_of(self.data)

    @cached_property
    def inside(self) -> tuple[Path, ...]:
        """The paths in a folder; none for a file."""
        return tuple(self.path.iterdir()) if self.path.is_dir() else ()


def begins_with(pattern: bytes) -> Sign:
    """Tell a format by a regular expression for its first bytes."""
    matches = re.compile(pattern, re.DOTALL).match
    return lambda start: matches(start.data) is not None


def first_line(pattern: re.Pattern[str]) -> Sign:
    """Tell a format of text by what its first line begins with."""
    return lambda start: pattern.match(start.first_line) is not None


def named(*suffixes: str) -> Sign:
    """Tell a format by the suffixes of files alone, in small letters."""
    return lambda start: start.is_file and start.suffix in suffixes


def tables(*suffixes: str) -> Sign:
    """Tell a format by the suffix of a file, or of all files of a folder that holds nothing else but hidden ones."""

    def are_tables(start: FileStart) -> bool:
        if start.is_file:
            return start.suffix in suffixes
        files = [path for path in start.inside if not path.name.startswith(".")]
        return bool(files) and all(path.is_file() and path.suffix.lower() in suffixes for path in files)

    return are_tables


def either(*signs: Sign) -> Sign:
    """Tell a format by any of several signs."""
    return lambda start: any(sign(start) for sign in signs)


def both(*signs: Sign) -> Sign:
    """Tell a format by several signs together."""
    return lambda start: all(sign(start) for sign in signs)
