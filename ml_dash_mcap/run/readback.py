"""Reads the recording that this process is writing."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

from ..errors import DamagedFileError, MissingRecordingError, StateError
from ..query.topic_part import TopicPart
from ..query.topic_rows import check_range
from ..recorded_topics import stored_topic
from ..recorder import Recorder
from ..recording import Recording
from ..rows.field_choice import check_columns
from ..selection import Selection


@dataclass(frozen=True, slots=True)
class About:
    """The description of one topic."""

    count: int = 0
    """Rows, after merging those of one time stamp."""
    times_s: tuple[float, float] | None = None
    """First and last time stamp; None without rows."""
    described: dict[str, Any] = field(default_factory=dict)
    """Its description, tags and metadata."""


class Readback:
    """Reads a run's folder, flushing first, so that every row appended so far is there; any thread may call it."""

    __slots__ = ("_earlier", "_opening_lock", "_recorder", "_recording", "begun_s")

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self._opening_lock = threading.Lock()
        """Guards the opening and refreshing of the recording."""
        self._recording: Recording | None = None
        self.begun_s = time.time()
        """When this process began to record, s since 1970."""
        self._earlier: Recording | DamagedFileError | None = None

    def recording(self) -> Recording:
        """Return the folder as a recording, which knows of everything appended so far.

        Raises:
            StateError: The recorder is closed.
        """
        self.check_open()
        self._recorder.flush()
        with self._opening_lock:
            if self._recording is None:
                self._recording = Recording(self._recorder.path)
            else:
                # Refreshing costs as much as there is new, while opening reads all indexes again.
                self._recording.refresh()
            return self._recording

    def check_open(self) -> None:
        """Raise StateError if the recorder is closed."""
        if self._recorder.closed:
            path = str(self._recorder.path)
            raise StateError(f"the recording in {path} is closed; Recording({path!r}) reads it")

    def remember_earlier(self) -> None:
        """Keep what the folder holds now apart from what will be recorded; damage in it keeps no run from starting."""
        try:
            self._earlier = Recording(self._recorder.path)
        except MissingRecordingError:
            self._earlier = None
        except DamagedFileError as error:
            self._earlier = error

    def earlier_parameters(self) -> dict[str, Any]:
        """Return the parameters of earlier runs in this folder, by dotted name.

        Raises:
            DamagedFileError: A file of theirs is damaged.
        """
        if isinstance(self._earlier, DamagedFileError):
            raise self._earlier
        return {} if self._earlier is None else self._earlier.params

    def earlier_count(self, topic: str) -> int:
        """Return how many rows a topic has from earlier runs in this folder; 0 if damage hides it."""
        earlier = self._earlier
        if not isinstance(earlier, Recording) or topic not in earlier:
            return 0
        try:
            return earlier[topic].info.count
        except DamagedFileError:
            return 0

    def part(
        self,
        topic: str,
        start_timestamp: float | None = None,
        end_timestamp: float | None = None,
        columns: Iterable[str] | None = None,
        start_index: int = 0,
        limit: int | None = None,
    ) -> TopicPart:
        """Return a part of a topic, as the two packages' `read` choose one: what is not there has no rows.

        Args:
            topic: Its name.
            start_timestamp: The first time wanted, in s, included; None is the beginning.
            end_timestamp: The last time wanted, in s, included; None is the end.
            columns: The fields wanted, nested ones under dotted names; None and an empty list are all.
            start_index: How many rows of the time range to leave out at its beginning.
            limit: How many rows at most; None for all.

        Raises:
            RangeError: A time is no number, or the end lies before the start.
            StateError: The recorder is closed.
        """
        recording = self.recording()
        start, end = check_range(start_timestamp, end_timestamp, ("start_timestamp", "end_timestamp"))
        return TopicPart(stored_topic(recording, topic), start, end, check_columns(columns), start_index, limit)

    def points(
        self,
        topic: str,
        start_timestamp: float | None = None,
        end_timestamp: float | None = None,
        columns: Iterable[str] | None = None,
    ) -> Iterator[dict[str, Any]]:
        """Yield the rows of a part of a topic, as dreamlake's `read` does; none if there is no such topic.

        Raises:
            NotFoundError: No row of the topic has such a column; also a KeyError.
        """
        part = self.part(topic, start_timestamp, end_timestamp, columns)
        recording = self.recording()
        return Selection(part, lambda: recording[topic].info).rows() if topic in recording else iter(())

    def rows(self, topic: str) -> Iterator[dict[str, Any]]:
        """Yield a topic's rows, nested as they were given and with `_ts`, in time order; none if it has none."""
        return self.part(topic).rows()

    def about(self, topic: str) -> About:
        """Return what is known of a topic."""
        recording = self.recording()
        if topic not in recording:
            return About()
        info = recording[topic].info
        times_s = None if info.start is None or info.end is None else (info.start, info.end)
        stated = {"description": info.description, "tags": list(info.tags), "metadata": dict(info.metadata) or None}
        return About(info.count, times_s, stated)

    def tracks(self) -> list[str]:
        """Return the names of the tracks that have rows, sorted."""
        return [name for name, info in self.recording().topics.items() if info.count]

    def metrics(self) -> list[str]:
        """Return the names of the metrics, sorted."""
        return list(self.recording().metrics)

    def close(self) -> None:
        """Close the recording's files; may be called twice."""
        with self._opening_lock:
            for recording in (self._recording, self._earlier):
                if isinstance(recording, Recording):
                    recording.close()
            self._recording = self._earlier = None
