"""The dialect of a text file: how it separates cells and spells decimals, as its tool or a spreadsheet wrote it."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace

BLANKS = " \t\r\n"
"""The characters that pad a cell. Other white space, such as a no-break space, is part of a name."""

_SEPARATORS = "\t;,"
_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")
_POINT = re.compile(r"[+-]?\d*\.\d*(?:[eE][+-]?\d+)?")
_NUMBER = re.compile(r"[+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][+-]?\d+)?")


@dataclass(frozen=True, slots=True)
class Dialect:
    """The separator of cells and the decimal mark of numbers."""

    separator: str
    """One letter; " " stands for any number of blanks and tabs."""
    decimal: str = "."
    """"." or ","."""

    def split(self, line: str) -> list[str]:
        """Return the cells of a line, without the blanks and quotes around them."""
        if self.separator == " ":
            return [_unquoted(cell) for cell in re.split(r"[ \t]+", line.strip(BLANKS)) if cell]
        # In files with tabs a cell may begin with a quote that nothing closes; the csv module would join cells.
        if self.separator == "\t" or '"' not in line:
            return [_unquoted(cell) for cell in line.split(self.separator)]
        try:
            cells = next(csv.reader([line], delimiter=self.separator, skipinitialspace=True), [])
        except csv.Error:
            cells = line.split(self.separator)
        return [cell.strip(BLANKS) for cell in cells]

    def is_blank(self, line: str) -> bool:
        """Whether a line has nothing but blanks, separators and empty quotes."""
        return not line.strip(f'{BLANKS}"{self.separator}')

    def with_decimal_of(self, lines: Iterable[str]) -> Dialect:
        """Return the dialect with the decimal mark of some lines of numbers: a comma where no number has a point."""
        commas = False
        for line in lines:
            for cell in self.split(line):
                if _POINT.fullmatch(cell):
                    return replace(self, decimal=".")
                commas = commas or _COMMA.fullmatch(cell) is not None
        return replace(self, decimal="," if commas else ".")


def of_line(line: str, default: str = "\t") -> Dialect:
    """Return the dialect of a line by the separator that it has most often; the default's if it has none."""
    counts = {separator: line.count(separator) for separator in _SEPARATORS}
    best = max(counts, key=lambda separator: counts[separator])
    return Dialect(best if counts[best] else default)


def number(text: str) -> float | None:
    """Return the number that a cell of a header spells, with a point or a comma; None if it spells none."""
    text = text.strip(BLANKS)
    return float(text.replace(",", ".")) if _NUMBER.fullmatch(text) else None


def _unquoted(cell: str) -> str:
    cell = cell.strip(BLANKS)
    if len(cell) > 1 and cell[0] == cell[-1] == '"':
        return cell[1:-1].replace('""', '"').strip(BLANKS)
    return cell
