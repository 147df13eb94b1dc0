"""TopicReader: one topic of a recording, as rows or columns."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from io import TextIOBase
from typing import TYPE_CHECKING, Any, BinaryIO, Literal, Protocol, overload

import numpy.typing as npt

from .errors import NotFoundError, RangeError, UsageError
from .formats.topic_part import Selection
from .formats.writers import render, stream
from .inspect.topics import TopicInfo
from .query import row_positions
from .query.file import File
from .query.topic_rows import check_index, check_range
from .rows.dotted import FIELD_PREFIX, check_columns
from .rows.result_dicts import BytesFormat, Entries, Take
from .suggestions import not_found

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl
    import pyarrow as pa

    from .rows.to_data_frames import TimeForm

Row = dict[str, Any]


class Source(Protocol):
    """What a reader knows of its recording."""

    def files(self) -> Sequence[File]:
        """Return the files, in the order of writing.

        Raises:
            StateError: The recording is closed.
        """

    def info(self, topic: str) -> TopicInfo:
        """Return what is known about a topic."""


def read(
    files: Sequence[File],
    topic: str,
    start_timestamp: float | None,
    end_timestamp: float | None,
    columns: Iterable[str] | None,
    format: str,
) -> Any:
    """Return a topic's rows in a format, see `TopicReader.read`; without any rows if there is no such topic."""
    low, high = check_range(start_timestamp, end_timestamp)
    return render(Selection(files, topic, low, high, check_columns(columns)), format)


class TopicReader:
    """Reads one topic of a recording."""

    def __init__(self, source: Source, topic: str) -> None:
        """Made by `recording[topic]`."""
        self._source = source
        self.name = topic

    @property
    def info(self) -> TopicInfo:
        """Count, times, fields and what else is known without reading the rows."""
        return self._source.info(self.name)

    @overload
    def read(
        self,
        start_timestamp: float | None = None,
        end_timestamp: float | None = None,
        columns: Iterable[str] | None = None,
        format: Literal["json"] = "json",
    ) -> Entries: ...

    @overload
    def read(
        self,
        start_timestamp: float | None = None,
        end_timestamp: float | None = None,
        columns: Iterable[str] | None = None,
        *,
        format: BytesFormat,
    ) -> bytes: ...

    @overload
    def read(
        self,
        start_timestamp: float | None = None,
        end_timestamp: float | None = None,
        columns: Iterable[str] | None = None,
        *,
        format: Literal["mocap"],
    ) -> Take: ...

    @overload
    def read(
        self,
        start_timestamp: float | None = None,
        end_timestamp: float | None = None,
        columns: Iterable[str] | None = None,
        format: str = "json",
    ) -> Any: ...

    def read(
        self,
        start_timestamp: float | None = None,
        end_timestamp: float | None = None,
        columns: Iterable[str] | None = None,
        format: str = "json",
    ) -> Any:
        """Return rows in one of the formats; nested dicts become dotted names.

        Args:
            start_timestamp: First time stamp, in s; None for the beginning.
            end_timestamp: Last time stamp, included, in s; None for the end.
            columns: Dotted names; that of a nested dict takes all of it. None and [] mean all.
            format: "json" (dict with `entries` and `count`), "jsonl" (bytes), "parquet" (bytes), "mocap" (dict) or
                "mcap" (bytes).

        Raises:
            FormatError: The format is none of these; also a ValueError.
            RangeError: The range's start lies after its end, or is not a number; also a ValueError.

        Example:
            >>> rec["robot"].read(end_timestamp=0.0, columns=["q"])
            {'entries': [{'timestamp': 0.0, 'q': [0.1, 0.2]}], 'count': 1}
        """
        return read(self._source.files(), self.name, start_timestamp, end_timestamp, columns, format)

    def rows(
        self,
        start_timestamp: float | None = None,
        end_timestamp: float | None = None,
        columns: Iterable[str] | None = None,
        *,
        start_index: int = 0,
        limit: int | None = None,
    ) -> Iterator[Row]:
        """Yield rows in time order as they were given, nested dicts as dicts, each with its time stamp as `_ts`.

        Reads on as it goes: memory holds a few chunks, not the topic.

        Args:
            start_timestamp: First time stamp, in s; None for the beginning.
            end_timestamp: Last time stamp, included, in s; None for the end.
            columns: Dotted names; that of a nested dict takes all of it. None and [] mean all.
            start_index: How many rows of that time range to leave out at its beginning.
            limit: How many rows at most; None for all.

        Raises:
            NotFoundError: The topic has no such column; the message names similar ones. Also a KeyError.
            RangeError: A range makes no sense; also a ValueError.
        """
        return self._select(start_timestamp, end_timestamp, columns, start_index, limit).rows()

    def write(
        self,
        out: BinaryIO,
        start_timestamp: float | None = None,
        end_timestamp: float | None = None,
        columns: Iterable[str] | None = None,
        *,
        start_index: int = 0,
        limit: int | None = None,
        format: str = "jsonl",
    ) -> None:
        """Write rows to a binary file or pipe as they are read; memory holds a few chunks, not the topic.

        The other arguments are those of `rows`.

        Args:
            out: What to write to; it stays open.
            format: "jsonl", the lines of `read`, or "csv", as `Recording.export` writes it; the header takes a pass
                over the rows of its own.

        Raises:
            FormatError: The format is neither; also a ValueError.
            UsageError: `out` takes text; also a TypeError.

        Example:
            >>> rec["robot"].write(sys.stdout.buffer, end_timestamp=0.0, columns=["q"], format="csv")
            _ts,q.0,q.1
            0.0,0.1,0.2
        """
        if isinstance(out, TextIOBase):
            raise UsageError(
                'write() takes a binary file: open(path, "wb"), or sys.stdout.buffer for the standard output'
            )
        stream(self._select(start_timestamp, end_timestamp, columns, start_index, limit), self.info, out, format)

    def to_arrow(
        self,
        start_timestamp: float | None = None,
        end_timestamp: float | None = None,
        columns: Iterable[str] | None = None,
        *,
        start_index: int = 0,
        limit: int | None = None,
    ) -> pa.Table:
        """Return rows as an Arrow table: `_ts`, a double in s, first; nested dicts as columns with dotted names.

        Vectors of one length are lists of that fixed size. What a row does not have is null. A column whose values no
        one Arrow type holds is JSON text, and its metadata says so; nothing is dropped. The arguments are those of
        `rows`.

        Example:
            >>> rec["robot"].to_arrow(end_timestamp=0.0, columns=["q"]).column_names
            ['_ts', 'q']
        """
        from .rows.table import to_table

        selection = self._select(start_timestamp, end_timestamp, columns, start_index, limit)
        return to_table(list(selection.blocks()), topic=self.name)

    def to_numpy(
        self,
        start_timestamp: float | None = None,
        end_timestamp: float | None = None,
        columns: Iterable[str] | None = None,
        *,
        start_index: int = 0,
        limit: int | None = None,
    ) -> dict[str, npt.NDArray[Any]]:
        """Return fields as arrays by dotted name: numbers [N], vectors [N, 7], matrices [N, 4, 4]; `_ts` is [N], in s.

        A missing fraction is NaN. Integers and booleans of which some are missing are masked arrays, so that the others
        stay exact. Text, bytes, lists of various lengths and values of several kinds are object arrays, with None for
        what is missing. The arguments are those of `rows`.

        Example:
            >>> rec["robot"].to_numpy(columns=["stamp_ns"])["stamp_ns"]
            masked_array(data=[1700000000123456789, --], mask=[False, True], fill_value=999999)
        """
        from .rows.numpy_columns import from_table

        table = self.to_arrow(start_timestamp, end_timestamp, columns, start_index=start_index, limit=limit)
        return from_table(table)

    def to_pandas(
        self,
        start_timestamp: float | None = None,
        end_timestamp: float | None = None,
        columns: Iterable[str] | None = None,
        *,
        start_index: int = 0,
        limit: int | None = None,
        flatten: bool = False,
        time: TimeForm = "seconds",
    ) -> pd.DataFrame:
        """Return rows as a pandas data frame; pandas must be installed. The other arguments are those of `rows`.

        Integers and booleans of which some are missing have pandas' nullable types `Int64`, `UInt64` and `boolean`; a
        missing fraction is NaN. Values of several kinds are objects.

        Args:
            flatten: Make each element of a vector, a matrix or a list a column of its own, `q.0`, `q.1`, `m.0.0`, named
                as in CSV files.
            time: "seconds": the exact doubles, as the column `_ts`. "datetime": a DatetimeIndex in UTC with ns, named
                `_ts`, in place of the column. "timedelta": a TimedeltaIndex, for clocks that start near 0.

        Raises:
            OptionError: There is no such `time`; also a ValueError.

        Example:
            >>> rec["robot"].to_pandas(flatten=True, time="datetime").resample("100ms").mean()
        """
        from .rows import to_data_frames

        table = self.to_arrow(start_timestamp, end_timestamp, columns, start_index=start_index, limit=limit)
        return to_data_frames.to_pandas(to_data_frames.shaped(table, flatten=flatten, time=time))

    def to_polars(
        self,
        start_timestamp: float | None = None,
        end_timestamp: float | None = None,
        columns: Iterable[str] | None = None,
        *,
        start_index: int = 0,
        limit: int | None = None,
        flatten: bool = False,
        time: TimeForm = "seconds",
    ) -> pl.DataFrame:
        """Return rows as a polars data frame; polars must be installed. The other arguments are those of `rows`.

        Args:
            flatten: As in `to_pandas`.
            time: What the column `_ts` is: "seconds", the exact doubles; "datetime", instants in UTC; "timedelta",
                spans; both in ns.

        Raises:
            OptionError: There is no such `time`; also a ValueError.
        """
        from .rows import to_data_frames

        table = self.to_arrow(start_timestamp, end_timestamp, columns, start_index=start_index, limit=limit)
        return to_data_frames.to_polars(to_data_frames.shaped(table, flatten=flatten, time=time))

    def batches(
        self,
        start_timestamp: float | None = None,
        end_timestamp: float | None = None,
        columns: Iterable[str] | None = None,
        *,
        rows: int = 16384,
        start_index: int = 0,
        limit: int | None = None,
    ) -> Iterator[pa.Table]:
        """Yield Arrow tables of some rows each, for data larger than memory.

        Each table has the columns that its rows, or some next to them, have values of, in types that hold these. The
        other arguments are those of `rows`, the result is that of `to_arrow` in pieces.

        Args:
            rows: How many rows a table has, but the last.
        """
        from .rows.table import tables_of_size

        if check_index("rows", rows) < 1:
            raise RangeError(f"rows={rows!r}: a batch has one row or more")
        selection = self._select(start_timestamp, end_timestamp, columns, start_index, limit)
        return tables_of_size(selection.blocks(), rows, topic=self.name)

    def at(self, time: float) -> Row:
        """Return the last row at or before a time, in s.

        Raises:
            NotFoundError: The topic has none so early; also a KeyError.
        """
        _, high = check_range(None, time, ("time", "time"))
        found = row_positions.last_at(self._source.files(), self.name, high)
        if found is None:
            raise NotFoundError(f"topic {self.name!r} has no row at or before {time!r}; it starts at {self.info.start}")
        return found

    def last(self) -> Row:
        """Return the last row.

        Raises:
            NotFoundError: The topic has no rows; also a KeyError.
        """
        return self.at(math.inf)

    def _select(
        self,
        start_timestamp: float | None,
        end_timestamp: float | None,
        columns: Iterable[str] | None,
        start_index: int,
        limit: int | None,
    ) -> Selection:
        low, high = check_range(start_timestamp, end_timestamp)
        names = check_columns(columns)
        for name in names or ():
            if not self._has(name):
                raise not_found("column", name, self.info.fields, f"topic {self.name!r}")
        first = check_index("start_index", start_index)
        most = None if limit is None else check_index("limit", limit)
        return Selection(self._source.files(), self.name, low, high, names, first, most)

    def _has(self, column: str) -> bool:
        """Whether any row has such a field, or one inside it."""
        names = (column, column.removeprefix(FIELD_PREFIX))
        if any(known == name or known.startswith(name + ".") for known in self.info.fields for name in names):
            return True
        rare = Selection(self._source.files(), self.name, columns=[column])  # one that the schema cannot express
        return any(len(row) > 1 for row in rare.rows())

    def __iter__(self) -> Iterator[Row]:
        return self.rows()

    def __len__(self) -> int:
        """How many rows it has after merging."""
        return self.info.count

    def __repr__(self) -> str:
        return f"<topic {self.name!r}: {self.info.count} rows of {', '.join(self.info.fields) or 'no fields'}>"
