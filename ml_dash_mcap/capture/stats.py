"""The figures of a recorder and of its sinks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

_Figures = dict[str, Any]


@dataclass(frozen=True, slots=True)
class SinkStats:
    """The figures of one sink; the rows offered to it are rows + waiting + missed."""

    name: str
    """The class of the sink."""
    rows: int
    """Rows of the blocks that it took, as they are in the file: after merging."""
    waiting: int
    """Rows of the blocks that wait for it, and of the block that it is busy with."""
    missed: int
    """Rows of the blocks that it did not take: it was too slow, it failed, or it was not done when the recorder
    closed."""
    errors: int
    """How often it raised."""
    failure: str | None
    """The first of these errors."""


@dataclass(frozen=True, slots=True, eq=False)
class Stats(Mapping[str, Any]):
    """The figures of a recorder; accepted = written + waiting + dropped at any moment.

    Each can be had as an attribute and by its name in brackets.
    """

    accepted: int
    """Rows offered."""
    written: int
    """Rows in the file, as they were appended."""
    waiting: int
    """Rows in the journal."""
    dropped: int
    """Rows refused."""
    dropped_by_topic: Mapping[str, int]
    merged: int
    """Rows of the written ones that became part of another row of the same topic and time; the file has
    written - merged."""
    steps_back: int
    """How often the time of a row in the file lay more than 50 ms before that of the row appended to the topic before
    it."""
    steps_back_by_topic: Mapping[str, int]
    bytes_written: int
    segments: list[str]
    """The paths of the finished ones."""
    failure: str | None
    """Why nothing can be written now, or None."""
    fallbacks: Mapping[str, int]
    """How often the writer had to take a slower way, by what failed; empty if all is well."""
    sinks: tuple[SinkStats, ...] = ()
    """The sinks beside the file, in the order in which they were given."""

    def dict(self) -> _Figures:
        """Return the figures by name; `sinks` only where there are any."""
        figures = asdict(self)
        if not self.sinks:
            del figures["sinks"]
        return figures

    def __getitem__(self, name: str) -> Any:
        return self.dict()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.dict())

    def __len__(self) -> int:
        return len(self.dict())

    def __or__(self, other: Mapping[str, Any]) -> _Figures:
        """Return the figures by name, with others that take their place."""
        return {**self.dict(), **other}
