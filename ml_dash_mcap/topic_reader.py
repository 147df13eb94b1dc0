"""TopicReader: one topic of a recording, as rows or columns."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, BinaryIO, Literal, Protocol, TypedDict, overload

import numpy.typing as npt

from . import renamed_arguments
from .errors import NotFoundError
from .inspect import topic_proto
from .inspect.topics import TopicInfo
from .query import row_positions
from .query.file import File
from .query.stored_topic import StoredTopic
from .query.topic_part import Row, TopicPart
from .query.topic_rows import check_index, check_range
from .rows.field_choice import check_columns
from .rows.result_dicts import BytesFormat, Entries, Take
from .selection import Selection

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl
    import pyarrow as pa
    from typing_extensions import Unpack

    from .rows.to_data_frames import TimeForm

Seconds = float | None
"""A time stamp; None where a range is open."""

Columns = Iterable[str] | None
"""Dotted names; that of a nested dict takes all of it. None and [] mean all."""


Json = Literal["json"]


class Numbers(TypedDict, total=False):
    """Which rows of a time range: what every read takes besides the range and the columns."""

    start_index: int
    """How many rows of the time range to leave out at its beginning."""
    limit: int | None
    """How many rows at most; None for all."""


class Source(Protocol):
    """The part of a recording that a reader needs."""

    def files(self) -> Sequence[File]:
        """Return the files, in the order of writing.

        Raises:
            StateError: The recording is closed.
        """

    def info(self, topic: str) -> TopicInfo:
        """Return what is known about a topic."""


class TopicReader:
    """Reads one topic of a recording.

    `select` chooses a part of it; the other methods take what `select` takes and are short for a method of the
    `Selection` that it returns.

    Example:
        >>> rec["robot"].select(end=0.0, columns=["q"]).arrow().column_names
        ['_ts', 'q']
        >>> rec["robot"].to_arrow(end=0.0, columns=["q"]).column_names
        ['_ts', 'q']
    """

    def __init__(self, source: Source, topic: str) -> None:
        """Made by `recording[topic]`."""
        self._source = source
        self.name = topic

    @property
    def info(self) -> TopicInfo:
        """Count, times, fields and what else is known without reading the rows."""
        return self._source.info(self.name)

    def proto(self) -> str:
        """Return the .proto text of the message type, for a compiler of protobuf.

        Of rows that this library recorded, it is complete; comments say the shapes of lists, units, and the keys that
        are no identifiers. Of other messages it may import further files, see `proto_files`.

        Raises:
            EncodingError: The messages are not protobuf, or segments contradict each other; also a ValueError.

        Example:
            >>> Path("robot.proto").write_text(rec["robot"].proto())
        """
        return next(iter(self.proto_files().values()))

    def proto_files(self) -> dict[str, str]:
        """Return the text of each .proto file by its name, that of the message type first.

        Those that each compiler brings (`google/protobuf/...`) are left out.

        Raises:
            EncodingError: The messages are not protobuf, or segments contradict each other; also a ValueError.

        Example:
            >>> for name, text in rec["camera"].proto_files().items():
            ...     path = Path("protos", name)
            ...     path.parent.mkdir(parents=True, exist_ok=True)
            ...     path.write_text(text)
        """
        return topic_proto.files(StoredTopic(self._source.files, self.name), self.info)

    def select(
        self,
        start: Seconds = None,
        end: Seconds = None,
        columns: Columns = None,
        *,
        start_index: int = 0,
        limit: int | None = None,
        **renamed: Seconds,
    ) -> Selection:
        """Choose a part of the topic; nothing is read before the selection is asked for its rows.

        Args:
            start: First time stamp, included, in s; None for the beginning.
            end: Last time stamp, included, in s; None for the end.
            columns: Dotted names; that of a nested dict takes all of it. None and [] mean all.
            start_index: How many rows of that time range to leave out at its beginning.
            limit: How many rows at most; None for all.
            renamed: `start_timestamp` and `end_timestamp`, which `start` and `end` were called before.

        Raises:
            RangeError: The range's start lies after its end, or one is not a number; also a ValueError.

        Example:
            >>> window = rec["robot"].select(0.0, 5.0, ["q"])
            >>> window.pandas(flatten=True).plot(x="_ts")
        """
        return self._select("select", start, end, columns, {"start_index": start_index, "limit": limit, **renamed})

    @overload
    def read(
        self, start: Seconds = None, end: Seconds = None, columns: Columns = None, format: Json = "json"
    ) -> Entries: ...
    @overload
    def read(
        self, start: Seconds = None, end: Seconds = None, columns: Columns = None, *, format: BytesFormat
    ) -> bytes: ...
    @overload
    def read(
        self, start: Seconds = None, end: Seconds = None, columns: Columns = None, *, format: Literal["mocap"]
    ) -> Take: ...
    @overload
    def read(
        self, start: Seconds = None, end: Seconds = None, columns: Columns = None, format: str = "json"
    ) -> Any: ...
    def read(
        self,
        start: Seconds = None,
        end: Seconds = None,
        columns: Columns = None,
        format: str = "json",
        **renamed: Any,
    ) -> Any:
        """Return rows in one of the formats, see `Selection.read`; the other arguments are those of `select`.

        Raises:
            FormatError: The format is none of these; also a ValueError.
            NotFoundError: The topic has no such column; also a KeyError.
            RangeError: A range makes no sense; also a ValueError.

        Example:
            >>> rec["robot"].read(end=0.0, columns=["q"])
            {'entries': [{'timestamp': 0.0, 'q': [0.1, 0.2]}], 'count': 1}
        """
        return self._select("read", start, end, columns, renamed).read(format)

    def rows(
        self, start: Seconds = None, end: Seconds = None, columns: Columns = None, **numbers: Unpack[Numbers]
    ) -> Iterator[Row]:
        """Yield rows, see `Selection.rows`; the arguments are those of `select`."""
        return self._select("rows", start, end, columns, numbers).rows()

    def write(
        self,
        out: BinaryIO,
        start: Seconds = None,
        end: Seconds = None,
        columns: Columns = None,
        *,
        format: str = "jsonl",
        **numbers: Unpack[Numbers],
    ) -> None:
        """Write rows as they are read, see `Selection.write`; the other arguments are those of `select`.

        Example:
            >>> rec["robot"].write(sys.stdout.buffer, end=0.0, columns=["q"], format="csv")
            _ts,q.0,q.1
            0.0,0.1,0.2
        """
        self._select("write", start, end, columns, numbers).write(out, format)

    def to_arrow(
        self, start: Seconds = None, end: Seconds = None, columns: Columns = None, **numbers: Unpack[Numbers]
    ) -> pa.Table:
        """Return rows as an Arrow table, see `Selection.arrow`; the arguments are those of `select`."""
        return self._select("to_arrow", start, end, columns, numbers).arrow()

    def to_numpy(
        self, start: Seconds = None, end: Seconds = None, columns: Columns = None, **numbers: Unpack[Numbers]
    ) -> dict[str, npt.NDArray[Any]]:
        """Return fields as arrays, see `Selection.numpy`; the arguments are those of `select`.

        Example:
            >>> rec["robot"].to_numpy(columns=["stamp_ns"])["stamp_ns"]
            masked_array(data=[1700000000123456789, --], mask=[False, True], fill_value=999999)
        """
        return self._select("to_numpy", start, end, columns, numbers).numpy()

    def to_pandas(
        self,
        start: Seconds = None,
        end: Seconds = None,
        columns: Columns = None,
        *,
        flatten: bool = False,
        time: TimeForm = "seconds",
        **numbers: Unpack[Numbers],
    ) -> pd.DataFrame:
        """Return rows as a pandas data frame, see `Selection.pandas`; the other arguments are those of `select`.

        Example:
            >>> rec["robot"].to_pandas(flatten=True, time="datetime").resample("100ms").mean()
        """
        return self._select("to_pandas", start, end, columns, numbers).pandas(flatten=flatten, time=time)

    def to_polars(
        self,
        start: Seconds = None,
        end: Seconds = None,
        columns: Columns = None,
        *,
        flatten: bool = False,
        time: TimeForm = "seconds",
        **numbers: Unpack[Numbers],
    ) -> pl.DataFrame:
        """Return rows as a polars data frame, see `Selection.polars`; the other arguments are those of `select`."""
        return self._select("to_polars", start, end, columns, numbers).polars(flatten=flatten, time=time)

    def batches(
        self,
        start: Seconds = None,
        end: Seconds = None,
        columns: Columns = None,
        *,
        rows: int = 16384,
        **numbers: Unpack[Numbers],
    ) -> Iterator[pa.Table]:
        """Yield Arrow tables of so many `rows`, see `Selection.batches`; the other arguments are those of `select`."""
        return self._select("batches", start, end, columns, numbers).batches(rows)

    def at(self, time: float) -> Row:
        """Return the last row at or before a time, in s.

        Raises:
            NotFoundError: The topic has none so early; also a KeyError.
        """
        _, high = check_range(None, time, ("time", "time"))
        row = row_positions.last_at(StoredTopic(self._source.files, self.name), high)
        if row is None:
            raise NotFoundError(f"topic {self.name!r} has no row at or before {time!r}; it starts at {self.info.start}")
        return row

    def last(self) -> Row:
        """Return the last row.

        Raises:
            NotFoundError: The topic has no rows; also a KeyError.
        """
        return self.at(math.inf)

    def _select(
        self, method: str, start: Seconds, end: Seconds, columns: Columns, others: Mapping[str, Any]
    ) -> Selection:
        """Return what `select` does; `method` is the one that was called, and `others` its other arguments."""
        renamed = dict(others)
        start_index, limit = renamed.pop("start_index", 0), renamed.pop("limit", None)
        start, end = renamed_arguments.take_range(f"TopicReader.{method}", start, end, renamed)
        low, high = check_range(start, end)
        names = check_columns(columns)
        part = TopicPart(
            StoredTopic(self._source.files, self.name),
            low,
            high,
            None if names is None else tuple(names),
            check_index("start_index", start_index),
            None if limit is None else check_index("limit", limit),
        )
        return Selection(part, lambda: self.info)

    def __iter__(self) -> Iterator[Row]:
        return self.rows()

    def __len__(self) -> int:
        """How many rows it has after merging."""
        return self.info.count

    def __repr__(self) -> str:
        return f"<topic {self.name!r}: {self.info.count} rows of {', '.join(self.info.fields) or 'no fields'}>"
