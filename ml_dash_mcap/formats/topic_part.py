"""The part of a topic that is asked for."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any

from ..query import row_positions
from ..query import topic_rows as rows
from ..query.file import File
from ..rows.dotted import flatten, project
from ..rows.encode import TIME_KEY

if TYPE_CHECKING:
    from ..rows.table import Block

Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Selection:
    """A topic, a time range, some columns, some of its rows. The topic need not exist: then there are no rows."""

    files: Sequence[File]
    """Of the recording, in the order of writing."""
    topic: str
    low: float = -math.inf
    """First time stamp, in s."""
    high: float = math.inf
    """Last time stamp, included, in s."""
    columns: Sequence[str] | None = None
    """Dotted names; None for all."""
    start: int = 0
    """How many of the rows in that range are left out at its beginning."""
    limit: int | None = None
    """How many rows at most; None for all."""

    @property
    def is_whole(self) -> bool:
        """Whether all rows of the time range are wanted."""
        return self.start == 0 and self.limit is None

    def rows(self) -> Iterator[Row]:
        """Yield the rows as they were given, nested, each with `_ts`; merged and in time order."""
        place = self._place()
        found = rows.read(self.files, self.topic, place.low, place.high)
        if not self.is_whole:
            found = islice(found, place.skip, None if self.limit is None else place.skip + self.limit)
        columns = self.columns
        if columns is None:
            return found
        return (project(row, columns) for row in found)

    def flat_rows(self, time_name: str) -> Iterator[Row]:
        """Yield the rows with dotted names and their time stamp first, under the name given."""
        return (flatten(row, time_name) for row in self.rows())

    def blocks(self, time_name: str = TIME_KEY) -> Iterator[Block]:
        """Yield the same rows as columns, some at a time."""
        from ..query import topic_columns as columns

        place = self._place()
        found = columns.read(self.files, self.topic, place.low, place.high, self.columns, time_name)
        return found if self.is_whole else _cut(found, place.skip, self.limit)

    def _place(self) -> row_positions.Place:
        if self.is_whole:
            return row_positions.Place(self.low, self.high, 0)
        return row_positions.find(self.files, self.topic, self.low, self.high, self.start, self.limit)


def _cut(blocks: Iterator[Block], skip: int, limit: int | None) -> Iterator[Block]:
    for block in blocks:
        if skip >= block.count:
            skip -= block.count
            continue
        cut = block.slice(skip, block.count - skip if limit is None else min(limit, block.count - skip))
        skip = 0
        if limit is not None:
            limit -= cut.count
        if cut.count:
            yield cut
        if limit == 0:
            return
