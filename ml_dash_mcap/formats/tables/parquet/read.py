"""Reads Parquet files: our own as the rows that they were, those of others row by row."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from ....errors import ConversionWarning, ForeignFileError
from ....recorder import Recorder
from ...registry import Progress
from .. import table_files
from ..table_about import ABOUT_KEY, TableAbout
from ..table_options import ParquetReadOptions

_BATCH_ROWS = 8192
_BATCH_BYTES = 16 * 2**20
_BUFFER_BYTES = 2**20
"""Columns are read so many bytes at a time, so that a large row group need not be in memory."""


def record(src: Path, recorder: Recorder, options: ParquetReadOptions, progress: Progress | None) -> None:
    """Append Parquet files, one topic a file.

    A file that this library wrote gives the rows, units and metadata that it was written from. Of any other, each row
    is a row of its own with all its columns; null is None. What JSON has no type for keeps all that it says:
    `arrow_values` tells how.

    Args:
        src: A file, or a folder of such.
        recorder: Where to.
        options: How to read it.
        progress: Called now and then with the rows done and the rows in all.

    Raises:
        ForeignFileError: It is no Parquet file, has no column of times, or one whose unit is not plain; says which
            columns there are.
        NotFoundError: There is no such `time_column`.
    """

    def opened(path: Path) -> _ParquetFile:
        return _ParquetFile(path, skips=options.on_damage == "skip")

    table_files.record(src, recorder, opened, options, progress, _rows)


def _rows(path: Path) -> int:
    file = _ParquetFile(path)
    try:
        return file.rows
    finally:
        file.close()


class _ParquetFile:
    """One Parquet file."""

    def __init__(self, path: Path, *, skips: bool = False) -> None:
        self.path, self._skips = path, skips
        try:
            self._file = pq.ParquetFile(
                path, buffer_size=_BUFFER_BYTES, pre_buffer=False, page_checksum_verification=True
            )
            self.schema: pa.Schema = self._file.schema_arrow
        except (pa.ArrowException, OSError) as error:
            raise ForeignFileError(path, f"it cannot be read as Parquet: {error}") from error
        metadata = dict(self.schema.metadata or {})
        self.about = _about(metadata.get(ABOUT_KEY.encode()), self.schema)

    @property
    def rows(self) -> int:
        """How many there are."""
        return int(self._file.metadata.num_rows)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def range_of(self, column: str) -> tuple[Any, Any]:
        """Return the least and the greatest value of a column; both None if it has none."""
        low: Any = None
        high: Any = None
        at = self.schema.names.index(column)
        for batch in self._of_column(column):
            array = batch.column(0 if batch.num_columns == 1 else at)
            limits = pc.min_max(array.dictionary_decode() if pa.types.is_dictionary(array.type) else array).as_py()
            if limits["min"] is not None:
                low = limits["min"] if low is None else min(low, limits["min"])
                high = limits["max"] if high is None else max(high, limits["max"])
        return low, high

    def _of_column(self, column: str) -> Iterator[pa.RecordBatch]:
        """Yield a column, or all of them if its name is there twice."""
        wanted = [column] if self.schema.names.count(column) == 1 else None
        for group in range(self._file.metadata.num_row_groups):
            try:
                yield from self._batches(wanted, [group])
            except ForeignFileError:
                if not self._skips:
                    raise

    def batches(self) -> Iterator[pa.RecordBatch]:
        """Yield the rows, some at a time."""
        lost = 0
        for group in range(self._file.metadata.num_row_groups):
            # Row group by row group, so that damage in one costs only the rest of that one.
            rest: int = self._file.metadata.row_group(group).num_rows
            try:
                for batch in self._batches(None, [group]):
                    yield batch
                    rest -= batch.num_rows
            except ForeignFileError:
                if not self._skips:
                    raise
                lost += rest
        if lost:
            problem = f"{self.path}: {lost} of {self.rows} rows are damaged and were left out"
            warnings.warn(problem, ConversionWarning, stacklevel=4)

    def place(self, row: int) -> str:
        """Return where a row stands, in words."""
        return f"row {row}"

    def _batches(self, columns: list[str] | None, groups: list[int]) -> Iterator[pa.RecordBatch]:
        metadata = self._file.metadata
        size = sum(metadata.row_group(at).total_byte_size for at in range(metadata.num_row_groups))
        each = max(1, size // max(1, metadata.num_rows))
        # Rows with images or long lists are read in smaller batches, so that memory stays bounded.
        rows = _BATCH_ROWS if columns else max(1, min(_BATCH_ROWS, _BATCH_BYTES // each))
        try:
            yield from self._file.iter_batches(batch_size=rows, columns=columns, row_groups=groups)
        except (pa.ArrowException, OSError) as error:
            raise ForeignFileError(self.path, f"it is damaged, or has what cannot be read: {error}") from error


def _about(text: bytes | None, schema: pa.Schema) -> TableAbout | None:
    """Return what this library wrote into a file's metadata; None if it did not, or if somebody changed the columns."""
    about = TableAbout.from_json(text) if text is not None else None
    if about is None or about.time_name not in schema.names:
        return None
    return about if pa.types.is_floating(schema.field(about.time_name).type) else None
