"""Reads a recording's episodes from the marks that their recorders left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ..codecs.encoded_channel import Row
from ..file_names import EPISODE_TOPIC, OWN_TOPICS
from ..query import counts, topic_rows
from ..query.file import File
from ..query.stored_topic import StoredTopic
from ..rows.plain_row import TIME_KEY
from . import writing_order


@dataclass(frozen=True, slots=True)
class Episode:
    """A try at a task: the rows of all topics with time stamps from `start` to `end`, both included.

    Example:
        >>> for episode in rec.episodes:
        ...     rows = rec["robot"].read(episode.start, episode.end)
    """

    index: int
    """Among all of the recording, from 0."""
    task: str | None
    start: float
    """First time stamp, in s."""
    end: float | None
    """Last time stamp, included, in s; None if it goes on, or if its recording died."""
    success: bool | None
    """None where it is not known."""
    metadata: Mapping[str, Any] = field(default_factory=dict)

    @property
    def duration(self) -> float | None:
        """From start to end, in s; None without an end."""
        return None if self.end is None else self.end - self.start


def read(files: Sequence[File]) -> list[Episode]:
    """Return all episodes: those of each recorder in the order in which they began.

    Args:
        files: In the order of writing.
    """
    latest: dict[tuple[str, int], Row] = {}
    for file in files:
        for row in topic_rows.read(StoredTopic([file], EPISODE_TOPIC)):
            if _is_mark(row):
                key = (row["run"], row["number"])
                # A mark is written again when its episode changes; the last revision tells all.
                if key not in latest or row["revision"] > latest[key]["revision"]:
                    latest[key] = row
    places = {run: place for place, run in enumerate(dict.fromkeys(run for run, _ in latest))}
    ordered = sorted(latest.items(), key=lambda item: (places[item[0][0]], item[0][1]))
    begins = _Begins(files)
    return [_episode(index, row, begins) for index, (_, row) in enumerate(ordered)]


def _is_mark(row: Row) -> bool:
    return isinstance(row.get("run"), str) and all(type(row.get(name)) is int for name in ("number", "revision"))


class _Begins:
    """The times of recorders' first rows, looked up when they are asked for."""

    def __init__(self, files: Sequence[File]) -> None:
        self._files = files
        self._first_by_run: dict[str, float | None] = {}

    def of(self, run: str) -> float | None:
        """Return a recorder's first time stamp on a topic of the user's, in s; None if it took no row."""
        if run not in self._first_by_run:
            files = [file for file in self._files if writing_order.run_of(file) == run]
            topics = {topic for file in files for topic in file.glance.channels_by_topic}
            users = [StoredTopic(files, topic) for topic in topics if not topic.startswith(OWN_TOPICS)]
            starts = [counts.first(topic)[0] for topic in users]
            self._first_by_run[run] = min((start for start in starts if start is not None), default=None)
        return self._first_by_run[run]


def _episode(index: int, row: Row, begins: _Begins) -> Episode:
    end = _number(row.get("end"))
    start = _number(row.get("start"))
    if start is None:
        first = begins.of(row["run"])
        start = row[TIME_KEY] if first is None else first
    if end is not None:
        start = min(start, end)
    task, success, metadata = row.get("task"), row.get("success"), row.get("metadata")
    return Episode(
        index=index,
        task=task if isinstance(task, str) else None,
        start=start,
        end=end,
        success=success if isinstance(success, bool) else None,
        metadata=metadata if isinstance(metadata, dict) else {},
    )


def _number(value: Any) -> float | None:
    return float(value) if type(value) in (int, float) else None
