"""Cuts a CSV file into cells, some rows at a time, and tells which cells were quoted."""

from __future__ import annotations

import codecs
import contextlib
import csv
import io
import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ....errors import ForeignFileError, OptionError

SEPARATORS = ",;\t|"

_CHUNK_BYTES = 1 << 20
_LONGEST_ROW_BYTES = 1 << 26
_SNIFFED_BYTES = 1 << 16
_NEWLINE = ord("\n")
_MARKS = {codecs.BOM_UTF8: "utf-8", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}


class CellRows(NamedTuple):
    """Some rows of a file."""

    height: int
    """How many."""
    cells: pa.Array
    """Their text, row by row."""
    quoted: npt.NDArray[np.bool_] | None
    """Which of the cells were quoted; None if none was."""
    lines: npt.NDArray[np.int64]
    """The number of the line that each row starts in, [N], from 1."""
    read: int
    """How many bytes of the file were read so far."""


@dataclass
class Tokens:
    """Reads a file's cells: RFC 4180, with any separator, and line ends of any kind.

    A quote inside a cell that does not begin with one is a letter. Rows without any text are left out.
    """

    path: Path
    separator: str
    columns: int
    """How many cells a row has; further ones must be empty."""
    encoding: str = "utf-8"
    allow_short: bool = False
    """Whether the last cells of a row may be left out."""

    def __post_init__(self) -> None:
        cut = re.escape(self.separator)
        # A quoted cell (its inside, then letters behind the quote) or a plain cell, and then whatever ends the cell.
        pattern = rf'(?:"([^"]*(?:""[^"]*)*)"(?!")([^{cut}\r\n]*)|([^{cut}\r\n]*))({cut}|\r\n|\n|\r|\Z)'
        self._cell = re.compile(pattern.encode())
        self._cut = self.separator.encode()

    def read(self) -> Iterator[CellRows]:
        """Yield the rows behind the header.

        Raises:
            ForeignFileError: A row has too many or too few cells, a quote does not end, or bytes are no text.
        """
        rest, line, done, is_header = b"", 1, 0, True
        with self.path.open("rb") as file:
            for text, done in _texts(self.path, file, self.encoding):
                rest += text
                rows, rest, line = self._some(rest, line, done, is_header, is_last=False)
                is_header = is_header and rows is None
                if rows is not None and rows.height:
                    yield rows
                if len(rest) > _LONGEST_ROW_BYTES:
                    problem = f"the row has more than {_LONGEST_ROW_BYTES} bytes, or a quote in it does not end"
                    raise ForeignFileError(self.path, problem, line)
        rows, _, _ = self._some(rest, line, done, is_header, is_last=True)
        if rows is not None and rows.height:
            yield rows

    def _some(
        self, data: bytes, line: int, read: int, is_header: bool, *, is_last: bool
    ) -> tuple[CellRows | None, bytes, int]:
        """Return the whole rows at the beginning of some text, the rest of it, and the number of its first line."""
        if b'"' in data or is_header:
            return self._by_cell(data, line, read, is_header, is_last=is_last)
        cut = len(data) if is_last else data.rfind(b"\n") + 1
        if not cut and b"\r" in data:
            return self._by_cell(data, line, read, is_header, is_last=is_last)
        rows = self._in_bulk(data[:cut], line, read) if cut else None
        if cut and rows is None:
            return self._by_cell(data, line, read, is_header, is_last=is_last)
        return rows, data[cut:], line + data.count(b"\n", 0, cut)

    def _in_bulk(self, data: bytes, line: int, read: int) -> CellRows | None:
        """Cut rows without quotes all at once; None if they are not all alike."""
        data = data.replace(b"\r\n", b"\n")
        if b"\r" in data:
            return None
        array = np.frombuffer(data if data.endswith(b"\n") else data + b"\n", np.uint8)
        # Without quotes every separator ends a cell, so numpy finds all cells of a block at once.
        ends = np.flatnonzero((array == self._cut[0]) | (array == _NEWLINE))
        row_ends = np.flatnonzero(array[ends] == _NEWLINE)
        count = len(row_ends)
        if len(ends) != count * self.columns or (np.diff(row_ends, prepend=-1) != self.columns).any():
            return None
        self._check_text(data, line)
        keep = np.ones(len(array), np.bool_)
        keep[ends] = False
        offsets = np.concatenate(([0], ends - np.arange(len(ends)))).astype(np.int32)
        letters = array[keep]
        lengths = np.diff(offsets).reshape(count, self.columns)
        if (lengths.sum(axis=1) == 0).any():
            return None
        cells = pa.StringArray.from_buffers(len(ends), pa.py_buffer(offsets), pa.py_buffer(letters))
        return CellRows(count, cells, None, np.arange(line, line + count), read)

    def _by_cell(
        self, data: bytes, line: int, read: int, is_header: bool, *, is_last: bool
    ) -> tuple[CellRows | None, bytes, int]:
        """Cut rows cell by cell."""
        cells: list[bytes] = []
        quoted: list[bool] = []
        lines: list[int] = []
        cut = 0
        for row, marks, end, first in self._rows(data, line, is_last=is_last):
            cut = end
            if is_header:
                is_header = not any(cell.strip() for cell in row)
            elif any(cell.strip() for cell in row) or any(marks):
                self._check_count(row, first)
                missing = [b""] * (self.columns - len(row))
                cells += (row + missing)[: self.columns]
                quoted += (marks + [False] * len(missing))[: self.columns]
                lines.append(first)
        rest, behind = data[cut:], line + _breaks(data, 0, cut)
        if is_header:
            return None, rest, behind
        if not b"".join(cells).isascii():
            for at, cell in enumerate(cells):
                self._check_text(cell, lines[at // self.columns])
        flags = np.array(quoted, np.bool_)
        array = pa.array(cells, pa.binary()).cast(pa.string())
        return CellRows(len(lines), array, flags if flags.any() else None, np.array(lines), read), rest, behind

    def _rows(self, data: bytes, line: int, *, is_last: bool) -> Iterator[tuple[list[bytes], list[bool], int, int]]:
        """Yield the whole rows of some text: their cells, which were quoted, where the row ends, and its first line."""
        row: list[bytes] = []
        marks: list[bool] = []
        start = at = 0
        while at < len(data):
            match = self._cell.match(data, at)
            assert match is not None  # the pattern matches nothing, too
            inside, behind, plain, end = match.groups()
            is_open = inside is None and data[at : at + 1] == b'"'
            # A "\r" at the end of a block may be the first half of "\r\n".
            is_cut = not end or is_open or (end == b"\r" and match.end() == len(data))
            if is_cut and not is_last:
                return
            if is_open:
                raise ForeignFileError(self.path, "a quote that begins in this row does not end", line)
            row.append(plain if inside is None else inside.replace(b'""', b'"') + behind)
            marks.append(inside is not None)
            at = match.end()
            if end == self._cut and (at < len(data) or not is_last):
                continue
            if end == self._cut:  # the file ends with an empty cell
                row.append(b"")
                marks.append(False)
            yield row, marks, at, line
            line += _breaks(data, start, at)
            start, row, marks = at, [], []

    def _check_count(self, row: list[bytes], line: int) -> None:
        """Raise ForeignFileError if a row has too many cells, or too few."""
        problem = f"the row has {len(row)} cells, but the header {self.columns}"
        if any(row[self.columns :]):
            raise ForeignFileError(self.path, problem, line, self.columns + 1)
        if len(row) < self.columns and not self.allow_short:
            hint = "; pass on_bad='missing' to convert() to take those that are there"
            raise ForeignFileError(self.path, problem + hint, line)

    def _check_text(self, data: bytes, line: int) -> None:
        if data.isascii():
            return
        try:
            data.decode()
        except UnicodeDecodeError as error:
            at = line + data.count(b"\n", 0, error.start)
            problem = f"the byte 0x{data[error.start]:02x} is no UTF-8; pass encoding= to convert(), such as 'cp1252'"
            raise ForeignFileError(self.path, problem, at) from error


def _breaks(data: bytes, start: int, end: int) -> int:
    """Count the ends of lines."""
    return data.count(b"\n", start, end) + data.count(b"\r", start, end) - data.count(b"\r\n", start, end)


def _texts(path: Path, file: BinaryIO, encoding: str) -> Iterator[tuple[bytes, int]]:
    """Yield a file's text in UTF-8, some at a time, without its mark, each with the bytes read so far."""
    head = file.read(4)
    for mark, name in _MARKS.items():
        if head.startswith(mark):
            encoding = name
    file.seek(0)
    try:
        decoder = None if codecs.lookup(encoding).name == "utf-8" else codecs.getincrementaldecoder(encoding)()
    except LookupError as error:
        raise OptionError(f"encoding={encoding!r} is none; pass a name such as 'utf-8' or 'cp1252'") from error
    done, is_first = 0, True
    while chunk := file.read(_CHUNK_BYTES):
        done += len(chunk)
        try:
            text = chunk if decoder is None else decoder.decode(chunk).encode()
        except UnicodeError as error:
            raise ForeignFileError(
                path, f"it is no text in {encoding}: {error}; pass another encoding= to convert()"
            ) from error
        if is_first:
            text = text.removeprefix(codecs.BOM_UTF8)
        is_first = False
        yield text, done


def first_rows(path: Path, separator: str, encoding: str, most: int) -> list[list[str]]:
    """Return the cells of a file's first rows that have any text, whatever their number."""
    with path.open("rb") as file:
        data = b""
        for text, _ in _texts(path, file, encoding):
            data += text
            if len(data) >= _SNIFFED_BYTES:
                break
    sample = data.decode("utf-8", "replace")
    if len(data) >= _SNIFFED_BYTES:
        sample = sample[: max(sample.rfind("\n"), sample.rfind("\r")) + 1] or sample
    rows: list[list[str]] = []
    with contextlib.suppress(csv.Error):
        reader = csv.reader(io.StringIO(sample, newline=""), delimiter=separator)
        rows += itertools.islice((row for row in reader if any(cell.strip() for cell in row)), most)
    return rows


def separator_of(path: Path, encoding: str) -> str:
    """Return what separates a file's cells: what its first rows have the same number of."""
    best, score = ",", (0, 0)
    for candidate in SEPARATORS:
        rows = first_rows(path, candidate, encoding, 50)
        if not rows or len(rows[0]) < 2:
            continue
        alike = sum(len(row) == len(rows[0]) for row in rows)
        agreement = (alike * 100 // len(rows), len(rows[0]))
        if agreement > score:
            best, score = candidate, agreement
    return best
