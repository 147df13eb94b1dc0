"""The part of a topic that is asked for."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from ..read import rows
from ..read.file import File
from ..rows.columns import flatten, project

Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Selection:
    """A topic, a time range, some columns. The topic need not exist: then there are no rows."""

    files: Sequence[File]
    """Of the recording, in the order of writing."""
    topic: str
    low: float = -math.inf
    """First time stamp, in s."""
    high: float = math.inf
    """Last time stamp, included, in s."""
    columns: Sequence[str] | None = None
    """Dotted names; None for all."""

    def rows(self) -> Iterator[Row]:
        """Yield the rows as they were given, nested, each with `_ts`; merged and in time order."""
        found = rows.read(self.files, self.topic, self.low, self.high)
        columns = self.columns
        if columns is None:
            return found
        return (project(row, columns) for row in found)

    def flat_rows(self, time_name: str) -> Iterator[Row]:
        """Yield the rows with dotted names and their time stamp first, under the name given."""
        return (flatten(row, time_name) for row in self.rows())
