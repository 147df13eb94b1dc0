"""Selection: a part of a topic, which is read when its rows, columns or bytes are asked for."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from io import TextIOBase
from typing import TYPE_CHECKING, Any, BinaryIO, Literal, overload

import numpy.typing as npt

from .errors import RangeError, UsageError
from .formats.writers import render, stream
from .inspect.topics import TopicInfo
from .query import counts, neighbours
from .query.topic_part import Row, TopicPart
from .query.topic_rows import check_index
from .rows.dotted import FIELD_PREFIX
from .rows.plain_row import TIME_KEY
from .rows.result_dicts import BytesFormat, Entries, Take
from .suggestions import not_found

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl
    import pyarrow as pa

    from .rows.to_data_frames import TimeForm


@dataclass(frozen=True, slots=True)
class Selection:
    """A topic in a time range, some of its columns, some of its rows: `recording[topic].select(...)` makes it.

    Nothing is read before a method asks for it, and which bytes to read is planned once, however many methods do. Any
    thread may call them.

    Example:
        >>> window = rec["robot"].select(start=0.0, end=5.0, columns=["q"])
        >>> len(window)
        51
        >>> window.numpy()["q"].shape
        (51, 7)
    """

    _part: TopicPart
    """The part of the topic, in the form of the reading code."""
    _info: Callable[[], TopicInfo]

    @property
    def topic(self) -> str:
        """The topic's name."""
        return self._part.topic

    @property
    def start(self) -> float | None:
        """First time stamp, in s; None for the beginning."""
        return None if math.isinf(self._part.start) else self._part.start

    @property
    def end(self) -> float | None:
        """Last time stamp, included, in s; None for the end."""
        return None if math.isinf(self._part.end) else self._part.end

    @property
    def columns(self) -> Sequence[str] | None:
        """Dotted names of the columns; None for all."""
        return self._part.columns

    @property
    def start_index(self) -> int:
        """How many rows of the time range are left out at its beginning."""
        return self._part.start_index

    @property
    def limit(self) -> int | None:
        """How many rows at most; None for all."""
        return self._part.limit

    def rows(self) -> Iterator[Row]:
        """Yield the rows in time order as they were given, nested dicts as dicts, each with its time stamp as `_ts`.

        Reads on as it goes: memory holds a few chunks, not the topic.

        Raises:
            NotFoundError: The topic has no such column; the message names similar ones. Also a KeyError.
        """
        return self._checked().rows()

    def arrow(self) -> pa.Table:
        """Return the rows as an Arrow table: `_ts`, a double in s, first; nested dicts as columns with dotted names.

        Vectors of one length are lists of that fixed size. What a row does not have is null. A column whose values no
        one Arrow type holds is JSON text, and its metadata says so; nothing is dropped.
        """
        from .rows.table import to_table

        return to_table(list(self._checked().blocks()), topic=self.topic)

    def numpy(self) -> dict[str, npt.NDArray[Any]]:
        """Return the fields as arrays by dotted name: numbers [N], vectors [N, 7], matrices [N, 4, 4]; `_ts` [N], in s.

        A missing fraction is NaN. Integers and booleans of which some are missing are masked arrays, so that the others
        stay exact. Text, bytes, lists of various lengths and values of several kinds are object arrays, with None for
        what is missing.
        """
        from .rows.numpy_columns import from_table

        return from_table(self.arrow())

    def pandas(self, *, flatten: bool = False, time: TimeForm = "seconds") -> pd.DataFrame:
        """Return the rows as a pandas data frame; pandas must be installed.

        Integers and booleans of which some are missing have pandas' nullable types `Int64`, `UInt64` and `boolean`; a
        missing fraction is NaN. Values of several kinds are objects.

        Args:
            flatten: Make each element of a vector, a matrix or a list a column of its own, `q.0`, `q.1`, `m.0.0`, named
                as in CSV files.
            time: "seconds": the exact doubles, as the column `_ts`. "datetime": a DatetimeIndex in UTC with ns, named
                `_ts`, in place of the column. "timedelta": a TimedeltaIndex, for clocks that start near 0.

        Raises:
            OptionError: There is no such `time`; also a ValueError.
        """
        from .rows import to_data_frames

        return to_data_frames.to_pandas(to_data_frames.shaped(self.arrow(), flatten=flatten, time=time))

    def polars(self, *, flatten: bool = False, time: TimeForm = "seconds") -> pl.DataFrame:
        """Return the rows as a polars data frame; polars must be installed.

        Args:
            flatten: As in `pandas`.
            time: What the column `_ts` is: "seconds", the exact doubles; "datetime", instants in UTC; "timedelta",
                spans; both in ns.

        Raises:
            OptionError: There is no such `time`; also a ValueError.
        """
        from .rows import to_data_frames

        return to_data_frames.to_polars(to_data_frames.shaped(self.arrow(), flatten=flatten, time=time))

    def batches(self, rows: int = 16384) -> Iterator[pa.Table]:
        """Yield Arrow tables of some rows each, for data larger than memory.

        Each table has the columns that its rows, or some next to them, have values of, in types that hold these. The
        result is that of `arrow` in pieces.

        Args:
            rows: How many rows a table has, but the last.

        Raises:
            RangeError: That is less than one; also a ValueError.
        """
        from .rows.table import tables_of_size

        if check_index("rows", rows) < 1:
            raise RangeError(f"rows={rows!r}: a batch has one row or more")
        return tables_of_size(self._checked().blocks(), rows, topic=self.topic)

    @overload
    def read(self, format: Literal["json"] = "json") -> Entries: ...
    @overload
    def read(self, format: BytesFormat) -> bytes: ...
    @overload
    def read(self, format: Literal["mocap"]) -> Take: ...
    @overload
    def read(self, format: str) -> Any: ...
    def read(self, format: str = "json") -> Any:
        """Return the rows in one of the formats; nested dicts become dotted names.

        Args:
            format: "json" (dict with `entries` and `count`), "jsonl" (bytes), "parquet" (bytes), "mocap" (dict) or
                "mcap" (bytes).

        Raises:
            FormatError: The format is none of these; also a ValueError.
        """
        return render(self._checked(), format)

    def write(self, out: BinaryIO, format: str = "jsonl") -> None:
        """Write the rows to a binary file or pipe as they are read; memory holds a few chunks, not the topic.

        Args:
            out: What to write to; it stays open.
            format: "jsonl", the lines of `read`, or "csv", as `Recording.export` writes it; the header takes a pass
                over the rows of its own.

        Raises:
            FormatError: The format is neither; also a ValueError.
            UsageError: `out` takes text; also a TypeError.
        """
        if isinstance(out, TextIOBase):
            raise UsageError(
                'write() takes a binary file: open(path, "wb"), or sys.stdout.buffer for the standard output'
            )
        stream(self._checked(), self._info(), out, format)

    def with_neighbours(self, most_s: float | None = None) -> Selection:
        """Return the same rows and the nearest row on each side of them.

        With `start_index` or `limit` the times of the rows are read to know where they end, and rows that share the
        time of the first or the last one are on a side of it too.

        Args:
            most_s: A row farther than this from the range is left out, in s; None for any distance. With
                `start_index` or `limit` the range is that of the rows.

        Raises:
            RangeError: `most_s` is not a number from 0 on; also a ValueError.
        """
        distance_s = _distance(most_s)
        part = self._part
        if not part.has_all_rows:
            times_s = replace(self, _part=replace(part, columns=(TIME_KEY,))).arrow()[TIME_KEY]
            if not len(times_s):
                return self
            part = replace(part, start=times_s[0].as_py(), end=times_s[-1].as_py(), start_index=0, limit=None)
        low, high = neighbours.widen(part.stored, part.start, part.end)
        wider = replace(part, start=max(low, part.start - distance_s), end=min(high, part.end + distance_s))
        return replace(self, _part=wider)

    def __iter__(self) -> Iterator[Row]:
        return self.rows()

    def __len__(self) -> int:
        """How many rows there are; of a whole topic, what the indexes say."""
        part = self._part
        if part.has_all_rows and self.start is None and self.end is None:
            return counts.count(part.stored)
        return sum(block.count for block in replace(part, columns=(TIME_KEY,)).blocks())

    def __repr__(self) -> str:
        asked = {name: getattr(self, name) for name in ("start", "end", "columns", "limit")}
        asked["start_index"] = self.start_index or None
        listed = "".join(f", {name}={value!r}" for name, value in asked.items() if value is not None)
        return f"<Selection of {self.topic!r}{listed}>"

    def _checked(self) -> TopicPart:
        """Return what to read, once it is known that the recording is open and that the topic has the columns."""
        self._part.stored.check_open()
        for name in self._part.columns or ():
            if not self._has(name):
                raise not_found("column", name, self._info().fields, f"topic {self.topic!r}")
        return self._part

    def _has(self, column: str) -> bool:
        """Whether any row has such a field, or one inside it."""
        names = (column, column.removeprefix(FIELD_PREFIX))
        fields = self._info().fields
        if column == TIME_KEY or any(
            field == name or field.startswith(name + ".") for field in fields for name in names
        ):
            return True
        # Rows are read only for a name that the schema lacks, before it is called an error.
        rare = TopicPart(self._part.stored, columns=(column,))  # one that the schema cannot express
        return any(len(row) > 1 for row in rare.rows())


def _distance(most_s: Any) -> float:
    """Return a distance in s; None is any."""
    if most_s is None:
        return math.inf
    try:
        distance_s = math.nan if isinstance(most_s, (str, bytes)) else float(most_s)
    except (TypeError, ValueError):
        distance_s = math.nan
    if not distance_s >= 0:  # NaN too
        raise RangeError(f"with_neighbours(most_s={most_s!r}): pass a number of seconds, 0 or more, or None for any")
    return distance_s
