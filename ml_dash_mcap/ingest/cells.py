"""Tables of numbers out of text files: parsed in bulk, and cell by cell where something is wrong."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pv

from ..errors import ForeignFileError

Floats = npt.NDArray[np.float64]

MISSING = ("", "nan", "NaN", "NAN", "-nan")
"""How files spell that there is no number."""

_CHUNK_BYTES = 1 << 22
_LONGEST_LINE_BYTES = 1 << 24
_SHOWN = 40
_BLANKS = re.compile(rb"[ \t]+")
_EDGES = re.compile(rb"^ | (?=\r?$)", re.MULTILINE)


@dataclass
class Cells:
    """The numbers of a table.

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
            if data.strip():
                yield self._parse(data, line), file.tell()
            ended = data.count(b"\n")
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

    def _parse(self, data: bytes, line: int) -> Floats:
        if self.separator == " ":
            data = _EDGES.sub(b"", _BLANKS.sub(b" ", data))
        values = self._fast(data)
        return self._slow(data, line) if values is None else values

    def _fast(self, data: bytes) -> Floats | None:
        """Return the numbers of lines that are as they should be; None if any is not."""
        names = [str(number) for number in range(self.columns)]
        shifts = self.shifts or [0] * self.columns
        types = {name: pa.string() if by else pa.float64() for name, by in zip(names, shifts, strict=True)}
        try:
            table = pv.read_csv(
                pa.py_buffer(data),
                pv.ReadOptions(column_names=names, block_size=1 << 20),
                pv.ParseOptions(delimiter=self.separator, quote_char=False),
                pv.ConvertOptions(
                    column_types=types, null_values=list(MISSING), strings_can_be_null=True, check_utf8=False
                ),
            )
            values = np.empty((table.num_rows, self.columns))
            for number, by in enumerate(shifts):
                column = table.column(number)
                if by:
                    text = pc.utf8_trim_whitespace(column)
                    column = pc.binary_join_element_wise(text, f"e{by}", "").cast(pa.float64())
                values[:, number] = column.to_numpy()
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
            return None
        return None if np.isinf(values).any() else values

    def _slow(self, data: bytes, line: int) -> Floats:
        rows: list[list[float]] = []
        for number, raw in enumerate(data.split(b"\n"), line):
            text = raw.decode("utf-8", "replace").rstrip("\r")
            if text.strip():
                rows.append(self._line(text, number))
        return np.array(rows, np.float64).reshape(-1, self.columns)

    def _line(self, text: str, line: int) -> list[float]:
        cells = text.split(self.separator)
        while len(cells) > self.columns and not cells[-1].strip():
            cells.pop()
        is_short = len(cells) < self.columns
        if len(cells) > self.columns or (is_short and not self.allow_short):
            what = f"the line has {len(cells)} cells, but the header has {self.columns}{self._hint(text)}"
            if self.on_bad == "raise":
                raise ForeignFileError(self.path, what, line)
            self.bad += abs(len(cells) - self.columns)
        cells = [*cells[: self.columns], *[""] * (self.columns - len(cells))]
        shifts = self.shifts or [0] * self.columns
        return [self._number(cell, by, line, at) for at, (cell, by) in enumerate(zip(cells, shifts, strict=True), 1)]

    def _number(self, cell: str, shift: int, line: int, column: int) -> float:
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
            self.bad += 1
            return math.nan
        return value

    def _hint(self, text: str) -> str:
        if ";" in text and self.separator != ";":
            return "; it seems to be separated by ';', as some languages export it: export with commas and points"
        if "," in text and self.separator != ",":
            return "; it seems to have decimal commas, as some languages export it: export with decimal points"
        return ""
