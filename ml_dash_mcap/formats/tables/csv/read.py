"""Reads CSV files with a column of times: our own as the rows that they were, those of others row by row."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from ....errors import ForeignFileError
from ....recorder import Recorder
from ....rows.plain_row import TIME_KEY
from ...foreign_names import distinct
from ...registry import Progress, detect
from .. import table_files, table_times
from ..table_about import TableAbout
from ..table_options import CsvReadOptions
from . import tokens
from . import types as csv_types
from .tokens import CellRows, Tokens

_SNIFFED_ROWS = 100
_ROW_BYTES = 40
"""The assumed size of a row, for the progress before the rows are counted."""

_OURS = TableAbout(is_ragged=True)
"""The description of a file whose first column is `_ts`, as `formats.tables.csv.write` writes it."""


def record(src: Path, recorder: Recorder, options: CsvReadOptions, progress: Progress | None) -> None:
    """Append CSV files, one topic a file.

    Each column has the type that holds all of its cells: integers, fractions, booleans, or text; empty cells are None.
    Numbers with zeros in front and what is quoted beside unquoted cells are text. A file whose first column is `_ts`
    gives the rows that `export(format="csv")` wrote it from: `q.0`, `q.1` are the vector `q`, dotted names are dicts,
    and empty cells are fields that the row does not have.

    Args:
        src: A file, or a folder of such.
        recorder: Where to.
        options: How to read it.
        progress: Called now and then with the rows done and the rows in all.

    Raises:
        ForeignFileError: A row has too many cells, no column is the time, or a time's unit is not plain; says where.
        NotFoundError: There is no such `time_column`.
    """

    def opened(path: Path) -> _CsvFile:
        format_name = "csv" if path == src else detect(path)
        if format_name != "csv":
            raise ForeignFileError(
                path, f"it is no plain table but of the format {format_name!r}; convert it by itself"
            )
        return _CsvFile(path, options)

    table_files.record(src, recorder, opened, options, progress, lambda path: path.stat().st_size // _ROW_BYTES)


class _CsvFile:
    """One CSV file, of which all cells were looked at once."""

    def __init__(self, path: Path, options: CsvReadOptions) -> None:
        self.path = path
        encoding = options.encoding
        self._separator = options.separator or tokens.separator_of(path, encoding)
        rows = tokens.first_rows(path, self._separator, encoding, _SNIFFED_ROWS)
        self._names = _names(path, rows)
        self._decimal = options.decimal or csv_types.decimal_of(rows[1:], self._separator)
        is_ours = bool(self._names) and self._names[0] == TIME_KEY and options.time_column in (None, TIME_KEY)
        self.about = _OURS if is_ours else None
        self._tokens = Tokens(
            path, self._separator, len(self._names), encoding=encoding, allow_short=options.on_bad == "missing"
        )
        self._first, self._lines = 0, np.empty(0, np.int64)
        """The number of the first row of the batch that was yielded last, and the line of each of its rows."""
        self._ranges: dict[str, tuple[float, float]] = {}
        self._types = self._learnt(options.time_column)
        fields = [csv_types.field(name, type_) for name, type_ in zip(self._names, self._types, strict=True)]
        self.schema = pa.schema(fields)

    def close(self) -> None:
        """Do nothing: the file is open while it is read."""

    def range_of(self, column: str) -> tuple[Any, Any]:
        """Return the least and the greatest number of a column; both None if it has none."""
        return self._ranges.get(column, (None, None))

    def batches(self) -> Iterator[pa.RecordBatch]:
        """Yield the rows, some at a time."""
        row = 0
        for rows in self._tokens.read():
            self._first, self._lines = row, rows.lines
            row += rows.height
            arrays = [self._values(rows, at) for at in range(len(self._names))]
            yield pa.RecordBatch.from_arrays(arrays, schema=self.schema)

    def place(self, row: int) -> str:
        """Return where a row of the last batch stands, in words."""
        return f"line {int(self._lines[row - self._first])}"

    def _learnt(self, time_column: str | None) -> list[pa.DataType | None]:
        """Return the type that holds each column's cells."""
        columns = [csv_types.CellTypes() for _ in self._names]
        times = [at for at, name in enumerate(self._names) if table_times.is_likely(name) or name == time_column]
        heeds_quotes = False
        for rows in self._tokens.read():
            for at, column in enumerate(columns):
                cells, quoted = self._cells(rows, at)
                column.add(cells, quoted, self._decimal)
                if at in times:
                    self._widen(self._names[at], cells)
            heeds_quotes = heeds_quotes or _has_plain(rows)
        is_ours = self.about is not None
        self._heeds_quotes = heeds_quotes
        return [column.type(heeds_quotes=heeds_quotes, is_ours=is_ours) for column in columns]

    def _widen(self, name: str, cells: pa.Array) -> None:
        numbers = csv_types.numbers(cells, self._decimal)
        if len(numbers):
            limits = pc.min_max(numbers).as_py()
            low, high = self._ranges.get(name, (limits["min"], limits["max"]))
            self._ranges[name] = (min(low, limits["min"]), max(high, limits["max"]))

    def _cells(self, rows: CellRows, at: int) -> tuple[pa.Array, Any]:
        # The cells lie row by row, so a column is every n-th of them.
        which = np.arange(at, rows.height * len(self._names), len(self._names))
        return rows.cells.take(pa.array(which)), None if rows.quoted is None else rows.quoted[which]

    def _values(self, rows: CellRows, at: int) -> pa.Array:
        cells, flags = self._cells(rows, at)
        quoted = flags if self._heeds_quotes else None
        try:
            return csv_types.converted(cells, quoted, self._types[at], self._decimal, is_ours=self.about is not None)
        except pa.ArrowInvalid as error:
            problem = f"the column {self._names[at]!r} changed while it was read: {error}"
            raise ForeignFileError(self.path, problem, int(rows.lines[0])) from error


def _has_plain(rows: CellRows) -> bool:
    """Whether some cell has text and no quotes."""
    plain = rows.cells if rows.quoted is None else rows.cells.filter(pa.array(~rows.quoted))
    return bool(pc.any(pc.not_equal(plain, "")).as_py())


def _names(path: Path, rows: list[list[str]]) -> list[str]:
    """Return the names of columns."""
    if not rows:
        raise ForeignFileError(path, "the file is empty; its first line should name the columns", 1)
    # Undoes the apostrophe that guards names against being taken for formulas; see `cells`.
    names = [re.sub(r"^'('*[=+\-@\t\r])", r"\1", name) for name in rows[0]]
    while len(names) > 1 and not names[-1].strip() and not any(any(row[len(names) - 1 :]) for row in rows[1:]):
        names.pop()
    return distinct([name.strip() for name in names])
