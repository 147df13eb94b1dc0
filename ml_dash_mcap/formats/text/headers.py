"""Reads the first lines of text files."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO
from zoneinfo import ZoneInfo

from ...errors import ForeignFileError, OptionError
from ...meaning.units import length_unit
from .dialect import Dialect, number
from .plain_text import decoded, is_filler

_LONGEST_BYTES = 1 << 26
_PREVIEW_BYTES = 1 << 16


class HeaderLines:
    """Reads lines from the start of a file and counts them."""

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self._path = path
        self._file = file
        self.line = 0
        """How many were read."""

    def next_or_none(self) -> str | None:
        """Return the next line without its end; None at the end of the file."""
        at = self.at()
        if not self._file.read(1):
            return None
        self._file.seek(at)
        return self.next("its end")

    def next(self, expected: str) -> str:
        """Return the next line without its end.

        Args:
            expected: What should stand there, for the error message.

        Raises:
            ForeignFileError: The file ends here, or the line does not end.
        """
        raw = self._file.readline(_LONGEST_BYTES)
        if not raw:
            raise ForeignFileError(self._path, f"the file ends before {expected}", self.line + 1)
        if len(raw) >= _LONGEST_BYTES:
            raise ForeignFileError(self._path, f"the line has more than {_LONGEST_BYTES} bytes", self.line + 1)
        self.line += 1
        return decoded(raw).lstrip("\ufeff").rstrip("\r\n") if self.line == 1 else decoded(raw).rstrip("\r\n")

    def first(self, expected: str) -> str:
        """Return the first line that is not blank and no filler.

        Raises:
            ForeignFileError: As `next`.
        """
        line = self.next(expected)
        while is_filler(line):
            line = self.next(expected)
        return line

    def row(self, expected: str, dialect: Dialect) -> list[str]:
        """Return the cells of the next line that is not blank, without the empty cells at its end.

        Raises:
            ForeignFileError: As `next`.
        """
        line = self.next(expected)
        while dialect.is_blank(line):
            line = self.next(expected)
        return without_empty_end(dialect.split(line))

    def at(self) -> int:
        """Return where in the file the next line starts, in bytes."""
        return self._file.tell()

    def to(self, at: int, line: int) -> None:
        """Go back to where the next line starts at some byte, when so many lines were read."""
        self._file.seek(at)
        self.line = line


def without_empty_end(cells: Sequence[str]) -> list[str]:
    """Return cells without the empty cells at the end."""
    count = len(cells)
    while count and not cells[count - 1]:
        count -= 1
    return list(cells[:count])


def preview(file: BinaryIO, stop: int | None = None) -> tuple[list[str], list[str]]:
    """Return some lines from where a file is, and some before its end; the file stays where it is.

    Args:
        file: At the start of a line.
        stop: Where the lines end, in bytes; None for the end of the file.
    """
    at = file.tell()
    head = file.read(_PREVIEW_BYTES if stop is None else min(_PREVIEW_BYTES, stop - at))
    end = file.seek(0, 2) if stop is None else stop
    # The first and the last line of a part may be cut, so they count only at the ends of the file.
    is_whole = at + len(head) >= end
    tail_at = max(at, end - _PREVIEW_BYTES)
    file.seek(tail_at)
    tail = file.read(end - tail_at)
    file.seek(at)
    first = decoded(head).split("\n")
    last = decoded(tail).split("\n")
    return first if is_whole else first[:-1] or first, last if tail_at == at else last[1:]


def refuse_numbers(path: Path, cells: Sequence[str], row: str, line: int) -> None:
    """Raise ForeignFileError if a row of the header is missing, so that a row of numbers stands in its place."""
    if cells and number(cells[0]) is not None:
        raise ForeignFileError(path, f"the header has no {row}: there are numbers in its place", line, 1)


def unit_of_length(
    path: Path, stated: str, asked: str | None, phrase: str, line: int | None = None, at: int | None = None
) -> str:
    """Return the unit of a file's lengths: "m", "cm" or "mm".

    Args:
        path: The file.
        stated: What the file says.
        asked: The option of the caller, which comes before the file's own word.
        phrase: The file's word for it, for the error message, such as "the unit".
        line: Where the file says it.
        at: In which column.

    Raises:
        ForeignFileError: The file says one that is not known, or none.
        OptionError: The caller does.
    """
    if asked is not None:
        unit = length_unit(asked) if isinstance(asked, str) else None
        if unit is None:
            raise OptionError(f"length_units={asked!r}: pass 'm', 'cm' or 'mm'")
        return unit
    unit = length_unit(stated)
    if unit is None:
        wrong = f"{phrase} {stated!r} is not known; m, cm and mm are" if stated.strip() else f"{phrase} is missing"
        raise ForeignFileError(path, f"{wrong}; pass length_units= to say it", line, at)
    return unit


def seconds_at(moment: tuple[int, int, int, int, int, int], fraction: str, timezone: str) -> float | None:
    """Return a moment that a header names, in s since 1970; None if there is none such, or it lies before.

    Args:
        moment: Year, month, day, hour, minute, second.
        fraction: The digits behind the second's point.
        timezone: An IANA name.

    Raises:
        OptionError: There is no such time zone.
    """
    zone: datetime.tzinfo = datetime.timezone.utc
    if timezone != "UTC":
        try:
            zone = ZoneInfo(timezone)
        except (KeyError, ValueError, OSError) as error:
            raise OptionError(f"timezone={timezone!r} is no time zone; pass a name such as 'Europe/Berlin'") from error
    try:
        whole = datetime.datetime(*moment, tzinfo=zone).timestamp()
    except (ValueError, OverflowError):
        return None
    seconds = whole + int(fraction.ljust(6, "0")[:6] or "0") / 1e6
    return seconds if seconds >= 0 else None


def check_on_bad(on_bad: str) -> None:
    """Raise OptionError unless a value is one of the two ways to treat bad cells."""
    if on_bad not in ("raise", "missing"):
        raise OptionError(f"on_bad={on_bad!r}: pass 'raise' or 'missing'")
