"""The part of a topic that a caller asks for: a time range, some columns, some of the rows."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any

from ..rows.dotted import flatten
from ..rows.field_choice import project
from ..rows.plain_row import TIME_KEY
from . import row_positions, topic_rows
from .stored_topic import StoredTopic

if TYPE_CHECKING:
    from ..rows.table import Block

Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class TopicPart:
    """A topic, a time range, some columns, some of its rows. The topic need not exist: then there are no rows."""

    stored: StoredTopic
    """The topic in the recording's files."""
    start: float = -math.inf
    """First time stamp, in s."""
    end: float = math.inf
    """Last time stamp, included, in s."""
    columns: Sequence[str] | None = None
    """Dotted names; None for all."""
    start_index: int = 0
    """How many of the rows in that range are left out at its beginning."""
    limit: int | None = None
    """How many rows at most; None for all."""

    @property
    def topic(self) -> str:
        """The topic's name."""
        return self.stored.name

    @property
    def has_all_rows(self) -> bool:
        """Whether all rows of the time range are wanted."""
        return self.start_index == 0 and self.limit is None

    def rows(self) -> Iterator[Row]:
        """Yield the rows as they were given, nested, each with `_ts`; merged and in time order."""
        place = self._place()
        rows = topic_rows.read(self.stored, place.low, place.high)
        if not self.has_all_rows:
            rows = islice(rows, place.skip, None if self.limit is None else place.skip + self.limit)
        columns = self.columns
        return rows if columns is None else (project(row, columns) for row in rows)

    def flat_rows(self, time_name: str) -> Iterator[Row]:
        """Yield the rows with dotted names and their time stamp first, under the name given."""
        return (flatten(row, time_name) for row in self.rows())

    def blocks(self, time_name: str = TIME_KEY) -> Iterator[Block]:
        """Yield the same rows as columns, some at a time."""
        from . import topic_columns

        place = self._place()
        blocks = topic_columns.read(self.stored, place.low, place.high, self.columns, time_name)
        return blocks if self.has_all_rows else _cut(blocks, place.skip, self.limit)

    def _place(self) -> row_positions.Place:
        if self.has_all_rows:
            return row_positions.Place(self.start, self.end, 0)
        return row_positions.find(self.stored, self.start, self.end, self.start_index, self.limit)


def _cut(blocks: Iterator[Block], skip: int, limit: int | None) -> Iterator[Block]:
    """Leave out rows at the beginning, and all but `limit` of the others."""
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
