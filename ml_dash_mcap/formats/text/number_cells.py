"""Parses tables of numbers in text files: in bulk, and cell by cell where something is wrong."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pv

from ...errors import ForeignFileError
from ...store import read_ahead
from .dialect import BLANKS, Dialect

Floats = npt.NDArray[np.float64]
Texts = Mapping[int, Sequence[str | None]]
"""Columns of text, by their number."""

MISSING = (
    *("", "nan", "NaN", "NAN", "Nan", "-nan", "+nan", "-NaN"),
    *("nan(ind)", "-nan(ind)", "1.#IND", "-1.#IND", "1.#QNAN", "-1.#QNAN", "1.#QNAN0", "-1.#IND00", "1.#QNAN00"),
)
"""How files spell that there is no number; the last are those of Microsoft's C."""

_CHUNK_BYTES = 1 << 21
# A file without ends of lines must not be read into memory as one line.
_LONGEST_LINE_BYTES = 1 << 24
_SHOWN = 40
_BLANKS = re.compile(rb"[ \t]+")
_EDGES = re.compile(rb"^ | (?=\r?$)", re.MULTILINE)
_DIALECT = Dialect(",")


class TextChunk(NamedTuple):
    """Some lines of a file."""

    data: bytes
    line: int
    """The number of the first of them."""
    at: int
    """How many bytes of the file were read so far."""


class NumberPart(NamedTuple):
    """Some rows of a table."""

    values: Floats
    """[N, columns], NaN where a number is missing, and in columns of text."""
    lines: npt.NDArray[np.int64]
    """Where in the file each row stands, [N]."""
    texts: Texts
    at: int
    """How many bytes of the file were read so far."""
    bad: int
    """How many cells are no numbers."""


@dataclass
class Cells:
    """The numbers of a table, parsed on all cores a little ahead of who asks for them.

    Rows of blanks and separators only are none. What is wrong is an error with its line and column, or a missing
    number that is counted.
    """

    path: Path
    columns: int
    """How many cells each line has."""
    dialect: Dialect = _DIALECT
    shifts: Sequence[int] = ()
    """By how many places the decimal point of each column moves to the right; none moves by default."""
    texts: Sequence[int] = ()
    """Columns of text."""
    allow_short: bool = False
    """Whether the last cells of a line may be left out."""
    on_bad: str = "raise"
    """"raise", or "missing"."""
    keeps_blank_rows: bool = False
    """Whether a row that has all of its separators, and nothing between them, is one."""
    padding: int = field(default=0, init=False)
    """How many empty cells most lines have behind their last; others may have more or less."""
    bad: int = field(default=0, init=False)
    """How many cells were no numbers, so far."""

    def read(self, file: BinaryIO, line: int, stop: int | None = None) -> Iterator[NumberPart]:
        """Yield the table's rows, some at a time.

        Args:
            file: At the start of the table's first line.
            line: The number of that line.
            stop: Where the table ends, in bytes; None for the file's end.

        Raises:
            ForeignFileError: A cell is no number, or a line has too many or too few of them.
        """
        for part in read_ahead.in_order(self._parse, self._chunks(file, line, stop)):
            self.bad += part.bad
            if len(part.values):
                yield part

    def learn(self, lines: Sequence[str]) -> None:
        """Find out by some lines of numbers how decimals are spelt, and how many empty cells stand behind the last."""
        rows = [line for line in lines if not self.dialect.is_blank(line)]
        self.dialect = self.dialect.with_decimal_of(rows)
        cells = self._split(rows[0].rstrip("\r"), 0) if rows else []
        behind = cells[self.columns :]
        self.padding = 0 if any(cell.strip(f'{BLANKS}"') for cell in behind) else len(behind)

    def sample(self, lines: Sequence[str]) -> Floats:
        """Return the numbers of some lines without the blank lines. A cell that is no number counts as missing."""
        lenient = copy(self)
        lenient.allow_short, lenient.on_bad = True, "missing"
        rows = [lenient._line(line, 0)[0] for line in lines if not self.dialect.is_blank(line)]
        return np.array(rows, np.float64).reshape(-1, self.columns)

    def _chunks(self, file: BinaryIO, line: int, stop: int | None) -> Iterator[TextChunk]:
        rest, left = b"", None if stop is None else stop - file.tell()
        while True:
            chunk = file.read(_CHUNK_BYTES if left is None else min(_CHUNK_BYTES, left))
            left = None if left is None else left - len(chunk)
            data = rest + chunk
            if chunk:
                cut = data.rfind(b"\n") + 1
                data, rest = data[:cut], data[cut:]
                if len(rest) > _LONGEST_LINE_BYTES:
                    raise ForeignFileError(self.path, f"the line has more than {_LONGEST_LINE_BYTES} bytes", line)
            if data:
                yield TextChunk(data, line, file.tell())
            line += data.count(b"\n")
            if not chunk:
                return

    def _parse(self, chunk: TextChunk) -> NumberPart:
        data = chunk.data
        if data.isspace() and not self.keeps_blank_rows:
            none: npt.NDArray[np.int64] = np.empty(0, np.int64)
            return NumberPart(np.empty((0, self.columns)), none, {}, chunk.at, 0)
        if self.dialect.separator == " ":
            data = _EDGES.sub(b"", _BLANKS.sub(b" ", data))
        return self._fast(data, chunk) or self._slow(data, chunk)

    def _fast(self, data: bytes, chunk: TextChunk) -> NumberPart | None:
        """Return the rows of lines that are as they should be; None if any is not."""
        names = [str(number) for number in range(self.columns + self.padding)]
        shifts = [*(self.shifts or [0] * self.columns), *[0] * self.padding]
        is_text = [number in self.texts or number >= self.columns for number in range(len(names))]
        types = {
            name: pa.string() if by or text else pa.float64()
            for name, by, text in zip(names, shifts, is_text, strict=True)
        }
        try:
            table = pv.read_csv(
                pa.py_buffer(data),
                # `read_ahead` already runs several chunks at a time, so pyarrow's own threads would only compete.
                pv.ReadOptions(column_names=names, block_size=1 << 20, use_threads=False),
                pv.ParseOptions(
                    delimiter=self.dialect.separator,
                    quote_char='"' if b'"' in data else False,
                    # pyarrow drops the blank row of a table of one column; these tables always have more columns.
                ),
                pv.ConvertOptions(
                    column_types=types,
                    null_values=list(MISSING),
                    strings_can_be_null=True,
                    check_utf8=any(is_text[: self.columns]),
                    decimal_point=self.dialect.decimal,
                ),
            )
            values, texts = self._columns(table, shifts, is_text)
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError, UnicodeDecodeError):
            return None
        # A number that is too large becomes infinite without an error; the slow way names its line and column.
        if np.isinf(values).any() or any(table.column(at).null_count < len(values) for at in self._padded()):
            return None
        lines = np.arange(chunk.line, chunk.line + len(values))
        if len(values) < data.count(b"\n"):
            there = [bool(raw.strip(b"\r")) for raw in data.split(b"\n")]
            lines = chunk.line + np.flatnonzero(there)
        if len(lines) != len(values):
            return None
        return self._without_blank(NumberPart(values, lines, texts, chunk.at, 0))

    def _padded(self) -> range:
        return range(self.columns, self.columns + self.padding)

    def _columns(
        self, table: pa.Table, shifts: Sequence[int], is_text: Sequence[bool]
    ) -> tuple[Floats, dict[int, list[str | None]]]:
        # Columns are filled one by one, so they lie one by one in memory.
        values = np.empty((table.num_rows, self.columns), order="F")
        texts: dict[int, list[str | None]] = {}
        for number in range(self.columns):
            column = table.column(number)
            if is_text[number]:
                trimmed = [None if cell is None else cell.strip(BLANKS) or None for cell in column.to_pylist()]
                texts[number] = trimmed
                values[:, number] = np.nan
                continue
            if shifts[number]:
                text = pc.utf8_trim_whitespace(column)
                if self.dialect.decimal == ",":
                    if pc.any(pc.match_substring(text, ".")).as_py():
                        raise pa.ArrowInvalid("a point where commas are")
                    text = pc.replace_substring(text, ",", ".")
                # Moving the decimal point in the text is exact; multiplying the double would round a second time.
                column = pc.binary_join_element_wise(text, f"e{shifts[number]}", "").cast(pa.float64())
            values[:, number] = column.to_numpy()
        return values, texts

    def _without_blank(self, part: NumberPart) -> NumberPart:
        """Leave out rows that have nothing in them."""
        missing = np.isnan(part.values[:, 0])
        if self.keeps_blank_rows or not missing.any():
            return part
        blank = np.zeros(len(missing), np.bool_)
        blank[missing] = np.isnan(part.values[missing]).all(axis=1)
        for column in part.texts.values():
            blank &= np.array([text is None for text in column], np.bool_)
        if not blank.any():
            return part
        keep = np.flatnonzero(~blank)
        texts = {at: [column[row] for row in keep.tolist()] for at, column in part.texts.items()}
        return NumberPart(part.values[keep], part.lines[keep], texts, part.at, part.bad)

    def _slow(self, data: bytes, chunk: TextChunk) -> NumberPart:
        rows: list[list[float]] = []
        lines: list[int] = []
        texts: dict[int, list[str | None]] = {at: [] for at in self.texts}
        bad = 0
        for number, raw in enumerate(data.split(b"\n"), chunk.line):
            text = raw.decode("utf-8", "replace").rstrip("\r")
            is_row = text.count(self.dialect.separator) >= self.columns - 1 if self.keeps_blank_rows else False
            if self.dialect.is_blank(text) and not is_row:
                continue
            row, wrong, texts_by_column = self._line(text, number)
            rows.append(row)
            lines.append(number)
            for at, column in texts.items():
                column.append(texts_by_column.get(at))
            bad += wrong
        values = np.array(rows, np.float64).reshape(-1, self.columns)
        return self._without_blank(NumberPart(values, np.array(lines, np.int64), texts, chunk.at, bad))

    def _line(self, text: str, line: int) -> tuple[list[float], int, dict[int, str | None]]:
        """Return a line's numbers, how many of its cells are none, and its texts."""
        bad = 0
        cells = self._split(text, line)
        while len(cells) > self.columns and not cells[-1].strip(f'{BLANKS}"'):
            cells.pop()
        is_short = len(cells) < self.columns
        if len(cells) > self.columns or (is_short and not self.allow_short):
            problem = f"the line has {len(cells)} cells, but the header has {self.columns}{self._hint(text)}"
            if self.on_bad == "raise":
                raise ForeignFileError(self.path, problem, line)
            bad = abs(len(cells) - self.columns)
        cells = [*cells[: self.columns], *[""] * (self.columns - len(cells))]
        texts: dict[int, str | None] = {at: cells[at].strip(BLANKS) or None for at in self.texts}
        for at in texts:
            cells[at] = ""
        shifts = self.shifts or [0] * self.columns
        numbers = [self._number(cell, by, line, at) for at, (cell, by) in enumerate(zip(cells, shifts, strict=True), 1)]
        return [math.nan if value is None else value for value in numbers], bad + numbers.count(None), texts

    def _split(self, text: str, line: int) -> list[str]:
        """Return the cells of a line, whose number only an error message needs."""
        if '"' in text and self.dialect.separator not in "\t ":
            try:
                return next(csv.reader([text], delimiter=self.dialect.separator), [])
            except csv.Error:
                pass
        if self.dialect.separator == " ":
            return self.dialect.split(text)
        return text.split(self.dialect.separator)

    def _number(self, cell: str, shift: int, line: int, column: int) -> float | None:
        """Return the number that a cell spells, NaN if it is empty; None if it is no number and may be left out."""
        text = cell.strip(f'{BLANKS}"')
        if text in MISSING:
            return math.nan
        try:
            # Python's `float` takes `1_000`, which no file means as a number.
            if "_" in text or (self.dialect.decimal == "," and "." in text):
                raise ValueError
            spelt = text.replace(",", ".") if self.dialect.decimal == "," else text
            mantissa, _, exponent = spelt.lower().partition("e")
            value = float(f"{mantissa}e{int(exponent or 0) + shift}")
            if math.isinf(value):
                raise ValueError
        except ValueError:
            if self.on_bad == "raise":
                shown = text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
                raise ForeignFileError(
                    self.path,
                    f"{shown!r} is not a number{self._hint(text)}; pass on_bad='missing' to go on without it",
                    line,
                    column,
                ) from None
            return None
        return value

    def _hint(self, text: str) -> str:
        if ";" in text and self.dialect.separator != ";":
            return "; it seems to be separated by ';', as some languages export it: export with commas and points"
        if self.dialect.decimal == "," and "." in text:
            return "; the file has decimal commas elsewhere: export it with one of both"
        if "," in text and self.dialect.separator != "," and self.dialect.decimal != ",":
            return "; it seems to have decimal commas, as some languages export it: export with decimal points"
        return ""
