"""The tracks of a session, with dreamlake's names: points with an index, and counts of appended points."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from itertools import islice
from typing import TYPE_CHECKING, Any, Literal, TypedDict, TypeVar, overload

from ..capture.channels import ChannelInfo
from ..capture.topic_context import TopicContext
from ..errors import RangeError
from ..rows.result_dicts import BytesFormat, Page, Take, TimePage
from ..timestamps import MISSING
from ..topic import Topic
from ..topic_reader import Columns, Json, Seconds
from . import pages
from .track_formats import render_track
from .tracks import BoundTopic

if TYPE_CHECKING:
    from typing_extensions import Unpack

SelfT = TypeVar("SelfT", bound="SessionTrack")

DEFAULT_LIMIT = 1000


class PointWindow(TypedDict, total=False):
    """The arguments of `read` besides the numbers of points."""

    start_timestamp: Seconds
    """First time stamp, included, in s."""
    end_timestamp: Seconds
    """Last time stamp, included, in s."""
    columns: Columns
    """Dotted names; None and an empty list are all."""


class SessionTrack(BoundTopic):
    """One track of a session. Any thread may append; reading flushes first.

    Time stamps (`_ts`, s): left out, the wall clock; -1, the last one used on any track of the session. Points of one
    time stamp merge into one, later fields win.

    Example:
        >>> session.track("train_loss").append(value=0.5, epoch=1)
        >>> session.track("train_loss").read(start_index=0, limit=10)["data"][0]["data"]["value"]
        0.5
    """

    __slots__ = ("_flushed", "_taken")

    def __init__(self, context: TopicContext, channel: ChannelInfo) -> None:
        super().__init__(context, channel)
        self._taken = self._flushed = 0

    def append(self: SelfT, /, *positional: Any, **fields: Any) -> SelfT:
        """Take one point; see `Topic.append`. It is counted, for the indexes that batches and flushes return."""
        Topic.append(self, *positional, **fields)
        self._taken += 1
        return self

    def append_columns(self: SelfT, /, *positional: Any, **columns: Any) -> SelfT:
        """Take many points at once, given as columns; see `Topic.append_columns`."""
        super().append_columns(*positional, **columns)
        self._taken += len(next(iter(columns.values()), ()))
        return self

    def append_message(self: SelfT, message: Any, /, *, _ts: Any = MISSING) -> SelfT:
        """Take one protobuf message as a point; see `Topic.append_message`."""
        super().append_message(message, _ts=_ts)
        self._taken += 1
        return self

    def append_batch(self, rows: Iterable[Mapping[str, Any]]) -> dict[str, Any]:  # type: ignore[override]  # dreamlake's
        """Take several points, each a dict of fields. If one of them is bad, none is taken.

        `_ts` means in each what it means for `append`, and the points keep their place among those of `append`.

        Returns:
            `trackId`, `startIndex`, `endIndex`, `count` and more; the indexes count points before any merge.

        Raises:
            RangeError: There is none; a ValueError.
            As `append`; the message names the point's place in the batch.
        """
        batch = [] if isinstance(rows, Mapping) else list(rows)
        if isinstance(rows, Mapping):
            super().append_batch(rows)  # raises the error for a dict
        if not batch:
            raise RangeError(f"append_batch() on track {self.name!r}: the batch is empty; pass at least one point")
        super().append_batch(batch)
        start = self._earlier() + self._taken
        self._taken += len(batch)
        return pages.appended(self.name, start, len(batch))

    def flush(self) -> dict[str, Any] | None:  # type: ignore[override]  # dreamlake's returns what was flushed
        """Write what was appended to the file before returning.

        Returns:
            What `append_batch` returns, for the points since the last flush; None if there were none.
        """
        taken, flushed = self._taken, self._flushed
        super().flush()
        self._flushed = taken
        return pages.appended(self.name, self._earlier() + flushed, taken - flushed) if taken > flushed else None

    def note_flush(self) -> None:
        """Learn that everything appended so far was flushed together with other tracks."""
        self._flushed = self._taken

    @overload
    def read(
        self, start_index: int = 0, limit: int | None = None, *, format: Json = "json", **part: Unpack[PointWindow]
    ) -> Page: ...
    @overload
    def read(
        self, start_index: int = 0, limit: int | None = None, *, format: BytesFormat, **part: Unpack[PointWindow]
    ) -> bytes: ...
    @overload
    def read(
        self, start_index: int = 0, limit: int | None = None, *, format: Literal["mocap"], **part: Unpack[PointWindow]
    ) -> Take: ...
    @overload
    def read(
        self, start_index: int = 0, limit: int | None = None, *, format: str = "json", **part: Unpack[PointWindow]
    ) -> Any: ...
    def read(
        self,
        start_index: int = 0,
        limit: int | None = None,
        *,
        start_timestamp: Seconds = None,
        end_timestamp: Seconds = None,
        columns: Columns = None,
        format: str = "json",
    ) -> Any:
        """Return points by index, by time, or both.

        Args:
            start_index: The first one wanted, counted from the first point of the time range.
            limit: How many at most; by default 1000 points as JSON, and everything in the other formats.
            start_timestamp: The first time wanted, in s, included; None is the beginning.
            end_timestamp: The last time wanted, in s, included; None is the end.
            columns: The fields wanted, nested ones under dotted names. None and an empty list are all.
            format: "json" for the dict below; "jsonl", "parquet", "mocap" and "mcap" as `Track.read` has them.

        Returns:
            `data`, a list of `{"index", "data", "createdAt"}` whose data are nested as given and have `_ts`;
            `startIndex`; `endIndex`; `total`, the number of points returned; `hasMore`.

        Raises:
            RangeError: An index is negative, a time is no number, or the end lies before the start.
            FormatError: The format is none of these; a ValueError.
            NotFoundError: As JSON: no point has such a column; a KeyError.
            StateError: The session is closed.
        """
        pages.check_range(start_index, 0 if limit is None else limit)
        self.flush()
        if format == "json":
            most = DEFAULT_LIMIT if limit is None else limit
            points = self._readback.points(self.name, start_timestamp, end_timestamp, columns)
            return pages.page(points, start_index, most, self._readback.begun_s)
        part = self._readback.part(self.name, start_timestamp, end_timestamp, columns, start_index, limit)
        return render_track(part, format)

    def read_by_time(
        self,
        start_time: float | None = None,
        end_time: float | None = None,
        limit: int = DEFAULT_LIMIT,
        reverse: bool = False,
    ) -> TimePage:
        """Return the points of a time range.

        Args:
            start_time: The first time wanted, in seconds, included; None is the beginning.
            end_time: Where to end, in seconds, not included; None is the end.
            limit: How many at most.
            reverse: Whether to begin with the last one.

        Returns:
            `data`, as `read` has it, with indexes counted from the first point of the range; `startTime`; `endTime`;
            `total`, the number of points returned; `hasMore`.

        Raises:
            RangeError: A time is no number, or the limit is negative.
            StateError: The session is closed.
        """
        pages.check_range(0, limit)
        self.flush()
        last = None if end_time is None else _just_before(end_time)
        empty = start_time is not None and last is not None and last < start_time
        rows = iter(()) if empty else self._readback.part(self.name, start_time, last).rows()
        # Rows come in time order only, so the last ones are known when all have been read.
        wanted = list(rows if reverse else islice(rows, limit + 1))
        points = [pages.point(place, row, self._readback.begun_s) for place, row in enumerate(wanted)]
        data = (points[::-1] if reverse else points)[:limit]
        more = len(points) > limit
        return {"data": data, "startTime": start_time, "endTime": end_time, "total": len(data), "hasMore": more}

    def stats(self) -> dict[str, Any]:
        """Return the number of points, their times, and what was said about the track (see `pages.stats`)."""
        self.flush()
        about = self._readback.about(self.name)
        return pages.stats("trackId", self.name, about.described, about.count, about.times_s, self._readback.begun_s)

    def _earlier(self) -> int:
        """Points that the track had before this session."""
        return self._readback.earlier_count(self.name)


def _just_before(end_time: float) -> float:
    try:
        # dreamlake excludes the end and our ranges include it: the double before it gives the same rows.
        return math.nextafter(end_time, -math.inf)
    except TypeError as error:
        raise RangeError(f"end_time={end_time!r} is not a number of seconds") from error
