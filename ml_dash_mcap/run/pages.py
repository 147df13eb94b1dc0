"""Pages of rows by index, in the shapes that dreamlake's tracks and ml-dash's metrics return."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice
from operator import index
from typing import Any, SupportsIndex

from .. import clock
from ..errors import RangeError
from ..rows.result_dicts import Page, Point
from . import utc

CHUNK_SIZE = 10_000
"""The number of points after which both packages' servers archive them. It is reported, and has no effect here."""


def page(rows: Iterable[dict[str, Any]], start_index: int, limit: int, begun_s: float) -> Page:
    """Return some rows by their place.

    Args:
        rows: All of them, the first has index 0.
        start_index: The first one wanted.
        limit: How many at most.
        begun_s: When the recording was begun, s since 1970: see `created`.

    Returns:
        `data`, a list of `{"index", "data", "createdAt"}`; `startIndex`; `endIndex`, the last one's index;
        `total`, the number of rows returned; `hasMore`.

    Raises:
        RangeError: The start or the limit is negative or no integer.
    """
    check_range(start_index, limit)
    # One row more than wanted tells whether there are more.
    wanted = list(islice(rows, start_index, start_index + limit + 1))
    points = [point(start_index + place, row, begun_s) for place, row in enumerate(wanted[:limit])]
    return {
        "data": points,
        "startIndex": start_index,
        "endIndex": start_index + len(points) - 1,
        "total": len(points),
        "hasMore": len(wanted) > limit,
    }


def point(index: int, row: dict[str, Any], begun_s: float) -> Point:
    """Return one row with its index and the time of its making."""
    return {"index": index, "data": row, "createdAt": created(row["_ts"], begun_s)}


def created(seconds: float, begun_s: float) -> str:
    """Return when a row was made, ISO 8601, UTC.

    That is its time stamp where this is wall-clock time. Where the tracks run on a clock that starts near 0, nothing
    better is known than when the recording was begun.
    """
    return utc.text_of(seconds if clock.is_epoch_like(seconds) else begun_s)


def appended(track: str, start_index: int, count: int) -> dict[str, Any]:
    """Return the report of a batch, or of a flush, that added rows to a track.

    Args:
        track: Its name.
        start_index: Index of the first row; like all counts here, before rows of one time are merged.
        count: How many rows, at least 1.
    """
    return {
        "trackId": track,
        "startIndex": str(start_index),
        "endIndex": str(start_index + count - 1),
        "count": count,
        "bufferedDataPoints": str(start_index + count),
        "chunkSize": CHUNK_SIZE,
    }


def stats(
    id_key: str,
    name: str,
    described: dict[str, Any],
    count: int,
    times_s: tuple[float, float] | None,
    begun_s: float,
) -> dict[str, Any]:
    """Return the description of a track or metric as a whole.

    Args:
        id_key: "trackId" or "metricId".
        name: Of the track or metric.
        described: Any of `description`, `tags` and `metadata`.
        count: Rows.
        times_s: The first and the last time stamp, None without rows.
        begun_s: When the recording was begun, s since 1970.

    Returns:
        Both packages' keys, counts as text as theirs. All points count as buffered and none as chunked: those words
        are about a server's hot and cold storage.
    """
    first, last = (created(seconds, begun_s) for seconds in times_s) if times_s else (None, None)
    return {
        id_key: name,
        "name": name,
        "description": described.get("description"),
        "tags": described.get("tags") or [],
        "metadata": described.get("metadata"),
        "totalDataPoints": str(count),
        "bufferedDataPoints": str(count),
        "chunkedDataPoints": "0",
        "totalChunks": 0,
        "chunkSize": CHUNK_SIZE,
        "firstDataAt": first,
        "lastDataAt": last,
        "createdAt": first or utc.text_of(begun_s),
        "updatedAt": last or utc.text_of(begun_s),
    }


def check_range(start_index: int, limit: int) -> None:
    """Raise RangeError unless both are integers from 0 on."""
    for name, value in (("start_index", start_index), ("limit", limit)):
        if not isinstance(value, SupportsIndex) or index(value) < 0:
            raise RangeError(f"{name}={value!r}: it must be an integer, 0 or more")
