"""One export: the rows to write, their destination, and the progress."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ..inspect.topics import TopicInfo
from ..query.file import File
from ..query.lazy_mapping import Lookup
from ..query.stored_topic import StoredTopic
from ..query.topic_part import TopicPart
from .registry import Progress


@dataclass(frozen=True, slots=True)
class Job:
    """One call of `Recording.export`: some topics of a recording, a time range, a destination."""

    dest: Path
    """The path to write to. Nothing is there yet."""
    files: Sequence[File]
    """The files of the recording, in the order of writing."""
    topics: Mapping[str, TopicInfo]
    """The topics to export, by name; each is looked up when it is asked for."""
    low: float = -math.inf
    """First time stamp, in s."""
    high: float = math.inf
    """Last time stamp, included, in s."""
    about: Mapping[str, Any] = field(default_factory=dict)
    """The description of the run: `params`, and the entries of `Recording.run`."""
    progress: Progress | None = None
    has_all_topics: bool = False
    """Whether no topics were chosen."""

    @property
    def is_whole(self) -> bool:
        """Whether all of the recording is wanted."""
        return self.has_all_topics and self.low == -math.inf and self.high == math.inf

    def stored(self, topic: str) -> StoredTopic:
        """Return a topic as the files have it."""
        return StoredTopic(self.files, topic)

    def part(self, topic: str, columns: Sequence[str] | None = None) -> TopicPart:
        """Return the part of a topic that is to be exported."""
        return TopicPart(self.stored(topic), self.low, self.high, columns)

    def without(self, topics: Collection[str]) -> Job:
        """Return the same job without some of its topics."""
        names = [name for name in self.topics if name not in topics]
        return replace(self, topics=Lookup("topic", names, self.topics.__getitem__))

    def counter(self) -> RowCounter:
        """Return a counter that reports to `progress`."""
        return RowCounter(self.progress, sum(info.count for info in self.topics.values()) if self.progress else 0)


class RowCounter:
    """Counts the rows that are written, and reports them."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress = progress
        self._total = total
        self._done = 0

    def add(self, rows: int) -> None:
        """Count some more rows."""
        self._done += rows
        if self._progress is not None:
            self._progress(min(self._done, self._total), self._total)

    def finish(self) -> None:
        """Report that all rows are written, although a time range may have left some out."""
        if self._progress is not None:
            self._progress(self._total, self._total)


class RestartableCounter:
    """Counts each row once, although an export may have to begin again from its first row."""

    def __init__(self, counter: RowCounter) -> None:
        self._counter = counter
        self._done = 0
        self._most = 0

    def begin(self) -> None:
        """Count from the first row again."""
        self._done = 0

    def add(self, rows: int) -> None:
        """Count some more rows. Those that were counted before the export began again are left out."""
        self._done += rows
        if self._done > self._most:
            self._counter.add(self._done - self._most)
            self._most = self._done

    def finish(self) -> None:
        """Report that all rows are written."""
        self._counter.finish()
