"""Tables of numbers out of text files: parsed in bulk, and cell by cell where something is wrong."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pv

from ..errors import ForeignFileError
from ..read import ahead

Floats = npt.NDArray[np.float64]

MISSING = ("", "nan", "NaN", "NAN", "-nan")
"""How files spell that there is no number."""

_CHUNK_BYTES = 1 << 21
_LONGEST_LINE_BYTES = 1 << 24
_SHOWN = 40
_BLANKS = re.compile(rb"[ \t]+")
_EDGES = re.compile(rb"^ | (?=\r?$)", re.MULTILINE)


class _Chunk(NamedTuple):
    """Some lines of a file."""

    data: bytes
    line: int
    """The number of the first of them."""
    at: int
    """How many bytes of the file were read so far."""


@dataclass
class Cells:
    """The numbers of a table, parsed on all cores a little ahead of who asks for them.

    What is wrong in it is an error with its line and column, or a missing number that is counted.
    """

    path: Path
    columns: int
    """How many cells each line has."""
    separator: str = ","
    """One letter; " " stands for any number of blanks and tabs."""
    shifts: Sequence[int] = ()
    """By how many places the decimal point of each column moves to the right; none moves by default."""
    allow_short: bool = False
    """Whether the last cells of a line may be left out."""
    on_bad: str = "raise"
    """"raise", or "missing"."""
    stop_at_blank: bool = False
    """Whether a line without cells ends the table."""
    bad: int = 0
    """How many cells were no numbers, so far."""
    lines: int = 0
    """How many lines were read."""

    def read(self, file: BinaryIO, line: int) -> Iterator[tuple[Floats, int]]:
        """Yield rows, [N, columns], NaN where a number is missing, each time with the bytes read so far.

        Afterwards the file is at the line behind the table.

        Args:
            file: At the start of the table's first line.
            line: The number of that line.

        Raises:
            ForeignFileError: A cell is no number, or a line has too many or too few of them.
        """
        for values, at, bad in ahead.in_order(self._parse, self._chunks(file, line)):
            self.bad += bad
            yield values, at

    def _chunks(self, file: BinaryIO, line: int) -> Iterator[_Chunk]:
        """Yield the table's lines, without those that are blank if there are no others."""
        rest, done = b"", file.tell()
        while True:
            chunk = file.read(_CHUNK_BYTES)
            data = rest + chunk
            if chunk:
                cut = data.rfind(b"\n") + 1
                data, rest = data[:cut], data[cut:]
                if len(rest) > _LONGEST_LINE_BYTES:
                    raise ForeignFileError(self.path, f"the line has more than {_LONGEST_LINE_BYTES} bytes", line)
            data, is_over = self._up_to_blank(data)
            if data and not data.isspace():
                yield _Chunk(data, line, file.tell())
            ended = int(np.count_nonzero(np.frombuffer(data, np.uint8) == ord("\n")))
            line, self.lines = line + ended, self.lines + ended
            done += len(data)
            if is_over or not chunk:
                file.seek(done)
                return

    def _up_to_blank(self, data: bytes) -> tuple[bytes, bool]:
        if not self.stop_at_blank:
            return data, False
        at = 0
        while at < len(data):
            end = data.find(b"\n", at) + 1 or len(data)
            if not data[at:end].strip(b" \r\n\t" + self.separator.encode()):
                return data[:at], True
            at = end
        return data, False

    def _parse(self, chunk: _Chunk) -> tuple[Floats, int, int]:
        """Return a chunk's rows, how many bytes were read so far, and how many cells are no numbers."""
        data = chunk.data
        if self.separator == " ":
            data = _EDGES.sub(b"", _BLANKS.sub(b" ", data))
        values = self._fast(data)
        if values is not None:
            return values, chunk.at, 0
        values, bad = self._slow(data, chunk.line)
        return values, chunk.at, bad

    def _fast(self, data: bytes) -> Floats | None:
        """Return the numbers of lines that are as they should be; None if any is not."""
        names = [str(number) for number in range(self.columns)]
        shifts = self.shifts or [0] * self.columns
        types = {name: pa.string() if by else pa.float64() for name, by in zip(names, shifts, strict=True)}
        try:
            table = pv.read_csv(
                pa.py_buffer(data),
                pv.ReadOptions(column_names=names, block_size=1 << 20, use_threads=False),
                pv.ParseOptions(delimiter=self.separator, quote_char=False),
                pv.ConvertOptions(
                    column_types=types, null_values=list(MISSING), strings_can_be_null=True, check_utf8=False
                ),
            )
            values = np.empty((table.num_rows, self.columns), order="F")
            for number, by in enumerate(shifts):
                column = table.column(number)
                if by:
                    text = pc.utf8_trim_whitespace(column)
                    column = pc.binary_join_element_wise(text, f"e{by}", "").cast(pa.float64())
                values[:, number] = column.to_numpy()
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
            return None
        return None if np.isinf(values).any() else values

    def _slow(self, data: bytes, line: int) -> tuple[Floats, int]:
        rows: list[list[float]] = []
        bad = 0
        for number, raw in enumerate(data.split(b"\n"), line):
            text = raw.decode("utf-8", "replace").rstrip("\r")
            if text.strip():
                row, wrong = self._line(text, number)
                rows.append(row)
                bad += wrong
        return np.array(rows, np.float64).reshape(-1, self.columns), bad

    def _line(self, text: str, line: int) -> tuple[list[float], int]:
        """Return a line's numbers, and how many of its cells are none."""
        bad = 0
        cells = text.split(self.separator)
        while len(cells) > self.columns and not cells[-1].strip():
            cells.pop()
        is_short = len(cells) < self.columns
        if len(cells) > self.columns or (is_short and not self.allow_short):
            what = f"the line has {len(cells)} cells, but the header has {self.columns}{self._hint(text)}"
            if self.on_bad == "raise":
                raise ForeignFileError(self.path, what, line)
            bad = abs(len(cells) - self.columns)
        cells = [*cells[: self.columns], *[""] * (self.columns - len(cells))]
        shifts = self.shifts or [0] * self.columns
        numbers = [self._number(cell, by, line, at) for at, (cell, by) in enumerate(zip(cells, shifts, strict=True), 1)]
        return [math.nan if one is None else one for one in numbers], bad + numbers.count(None)

    def _number(self, cell: str, shift: int, line: int, column: int) -> float | None:
        """Return the number that a cell spells, NaN if it is empty; None if it is no number and may be left out."""
        text = cell.strip()
        if text in MISSING:
            return math.nan
        try:
            if "_" in text:
                raise ValueError
            mantissa, _, exponent = text.lower().partition("e")
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
        if ";" in text and self.separator != ";":
            return "; it seems to be separated by ';', as some languages export it: export with commas and points"
        if "," in text and self.separator != ",":
            return "; it seems to have decimal commas, as some languages export it: export with decimal points"
        return ""
