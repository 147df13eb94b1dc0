"""Puts several topics of a recording on one clock: chooses the rows to read and the times to ask for."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from .errors import AlignmentError, UsageError
from .query.topic_rows import check_range
from .rows.align import align as align_tables
from .rows.align import grid
from .rows.align_methods import Methods
from .rows.field_choice import check_columns
from .rows.plain_row import TIME_KEY

if TYPE_CHECKING:
    from .topic_reader import TopicReader

_ROUNDING_S = 1e-5
"""More than doubles round a difference of time stamps by."""


def align(
    reader: Callable[[str], TopicReader],
    topics: Iterable[str] | Mapping[str, Iterable[str] | None],
    *,
    on: str | None,
    hz: float | None,
    how: str | Mapping[str, str],
    tolerance_s: float | None,
    start: float | None,
    end: float | None,
) -> pa.Table:
    """Return topics on one clock, see `Recording.align`.

    Args:
        reader: Returns the reader of a topic; raises NotFoundError if there is none.
    """
    chosen = _columns_by_topic(topics)
    methods = Methods(how)
    tolerance = _tolerance(tolerance_s)
    low, high = check_range(start, end)
    readers = {topic: reader(topic) for topic in chosen}
    tables: dict[str, pa.Table] = {}
    if hz is None and on is not None:
        own = reader(on)
        # A topic that gives only its times is read without its other columns.
        base = own.to_arrow(low, high, chosen.get(on, [TIME_KEY]))
        times: npt.NDArray[np.float64] = base.column(TIME_KEY).to_numpy()
        if on in chosen:
            tables[on] = base
    elif hz is not None and on is None:
        times = _grid(readers.values(), _number("hz", hz), low, high)
    else:
        given = "neither" if on is None else f"both, on={on!r} and hz={hz!r}"
        raise UsageError(f"align() needs on=, a topic whose times to take, or hz=, a rate; got {given}")
    for topic in chosen:
        if topic not in tables:
            tables[topic] = _around(readers[topic], times, chosen[topic], tolerance)
    tables = {topic: _with(tables[topic], chosen[topic]) for topic in chosen}
    if methods.has_names:
        methods.check_names(
            {topic: [*table.column_names[1:], *readers[topic].info.fields] for topic, table in tables.items()}
        )
    return align_tables(times, tables, methods, tolerance_s=tolerance, own=on)


def _columns_by_topic(topics: Any) -> dict[str, list[str] | None]:
    """Return the columns wanted of each topic; None for all."""
    if isinstance(topics, Mapping):
        return {topic: check_columns(columns) for topic, columns in topics.items()}
    if isinstance(topics, (str, bytes)) or not isinstance(topics, Iterable):
        raise UsageError(f"topics={topics!r}: pass a list of topics, or a dict of topics to lists of columns")
    return dict.fromkeys(topics)


def _tolerance(given: Any) -> float:
    if given is None:
        return math.inf
    tolerance = _number("tolerance_s", given)
    if not tolerance >= 0:
        raise AlignmentError(f"tolerance_s={given!r}: it must be 0 or more, in seconds")
    return tolerance


def _number(name: str, given: Any) -> float:
    try:
        return float(given)
    except (TypeError, ValueError) as error:
        raise AlignmentError(f"{name}={given!r} is not a number") from error


def _grid(readers: Iterable[TopicReader], hz: float, low: float, high: float) -> npt.NDArray[np.float64]:
    """Return times at a constant rate; an open end is where the last topic starts, or where the first one ends."""
    infos = [reader.info for reader in readers] if math.isinf(low) or math.isinf(high) else []
    if math.isinf(low):
        low = max((math.inf if info.start is None else info.start for info in infos), default=math.inf)
    if math.isinf(high):
        high = min((-math.inf if info.end is None else info.end for info in infos), default=-math.inf)
    return grid(low, high, hz)


def _around(
    reader: TopicReader,
    times: npt.NDArray[np.float64],
    columns: list[str] | None,
    tolerance: float,
) -> pa.Table:
    """Read the rows of a topic that values at these times can come from."""
    if not len(times):
        return reader.to_arrow(0.0, 0.0, columns, limit=0)
    window = reader.select(float(times[0]), float(times[-1]), columns)
    return window.with_neighbours(tolerance + _ROUNDING_S).arrow()


def _with(table: pa.Table, columns: list[str] | None) -> pa.Table:
    """Add the columns that were asked for and that none of the rows has; all of their values are missing."""
    for column in columns or ():
        if not any(name == column or name.startswith(f"{column}.") for name in table.column_names):
            table = table.append_column(column, pa.nulls(table.num_rows))
    return table
