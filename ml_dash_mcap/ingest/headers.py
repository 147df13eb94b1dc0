"""The first lines of text files."""

from __future__ import annotations

import csv
import datetime
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO, NoReturn
from zoneinfo import ZoneInfo

from ..errors import ForeignFileError, OptionError

_LONGEST_BYTES = 1 << 26
_SNIFFED_BYTES = 4096


def first_line(path: Path) -> str:
    """Return what a file begins with, up to the end of its first line; "" for a folder."""
    if not path.is_file():
        return ""
    with path.open("rb") as file:
        return _text(file.readline(_SNIFFED_BYTES)).lstrip("\ufeff")


class Header:
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

    def next(self, what: str) -> str:
        """Return the next line without its end.

        Args:
            what: What should stand there, for the error message.

        Raises:
            ForeignFileError: The file ends here, or the line does not end.
        """
        raw = self._file.readline(_LONGEST_BYTES)
        if not raw:
            raise ForeignFileError(self._path, f"the file ends before {what}", self.line + 1)
        if len(raw) >= _LONGEST_BYTES:
            raise ForeignFileError(self._path, f"the line has more than {_LONGEST_BYTES} bytes", self.line + 1)
        self.line += 1
        return _text(raw).lstrip("\ufeff").rstrip("\r\n") if self.line == 1 else _text(raw).rstrip("\r\n")

    def at(self) -> int:
        """Return where in the file the next line starts, in bytes."""
        return self._file.tell()

    def skip(self, lines: int) -> None:
        """Take note of lines that others read."""
        self.line += lines

    def back(self, at: int) -> None:
        """Go back to the start of the line before, which was read last."""
        self._file.seek(at)
        self.line -= 1


def _text(raw: bytes) -> str:
    try:
        return raw.decode()
    except UnicodeDecodeError:  # what Windows tools wrote before they wrote UTF-8
        return raw.decode("latin-1")


def csv_cells(path: Path, text: str, line: int) -> list[str]:
    """Return the cells of a line of CSV.

    Raises:
        ForeignFileError: It is no such line, as where lines end as on old Macs.
    """
    try:
        return next(csv.reader([text]), [])
    except csv.Error as error:
        raise ForeignFileError(path, f"the line is no CSV: {error}", line) from error


def refuse_semicolons(path: Path) -> NoReturn:
    """Raise ForeignFileError for a table of commas that has something else in their place."""
    said = "the file is separated by ';' or tabs, as some languages export it: export with commas and points"
    raise ForeignFileError(path, said, 1, 1)


def refuse_numbers(path: Path, cells: Sequence[str], row: str, line: int) -> None:
    """Raise ForeignFileError if a row that the header should have is one of the numbers behind it."""
    try:
        float(cells[0])
    except (IndexError, ValueError):
        return
    raise ForeignFileError(path, f"the header has no {row}: there are numbers in its place", line, 1)


def seconds_at(moment: tuple[int, int, int, int, int, int], fraction: str, timezone: str) -> float:
    """Return a moment that a header names, in s since 1970; 0.0 if there is none such, or it lies before.

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
        return 0.0
    return max(whole + int(fraction.ljust(6, "0")[:6] or "0") / 1e6, 0.0)


def check_on_bad(on_bad: str) -> None:
    """Raise OptionError unless something is a way to treat bad cells."""
    if on_bad not in ("raise", "missing"):
        raise OptionError(f"on_bad={on_bad!r}: pass 'raise' or 'missing'")


def distinct(names: Sequence[str]) -> list[str]:
    """Return names, with `#2`, `#3` behind those that were there before."""
    seen: dict[str, int] = {}
    found = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        found.append(name if seen[name] == 1 else f"{name}#{seen[name]}")
    return found
