"""Recording: what was recorded, by topic."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import orjson

from . import clock
from .errors import FormatError, StateError
from .export import FORMATS, Selection
from .layout import (
    ABOUT_RECORD,
    FILE_TOPIC,
    LOG_TOPIC,
    METRIC_TOPICS,
    OWN_TOPICS,
    PARAMETERS_RECORD,
    RUN_RECORD,
    SESSION_GLOB,
)
from .lookup import Lookup, not_found
from .read import rows, topics
from .read.file import File
from .read.records import Chunk
from .read.segments import Segments
from .read.topics import TopicInfo
from .rows.columns import check_columns

Row = dict[str, Any]


class Recording:
    """A run's folder, or one MCAP file: finished, cut by a crash, or still being recorded.

    Opening reads the indexes and no message. Any thread may read; `refresh` and `close` are for one at a time.

    Example:
        >>> with Recording("runs/alice/franka/demo-001") as rec:
        ...     rec.topics["robot"].count
        ...     rec["robot"].read(start_timestamp=0.0, end_timestamp=5.0, columns=["q"])
        ...     for row in rec["robot"].rows():
        ...         print(row["_ts"], row["q"])
    """

    def __init__(self, path: str | Path) -> None:
        """Open a recording.

        Args:
            path: A run's folder or one file.

        Raises:
            MissingRecordingError: There is none; also a FileNotFoundError.
            DamagedFileError: A file is no MCAP file, or a finished one is broken.
        """
        self.path = Path(path)
        self._closed = False
        self._infos: dict[str, TopicInfo] = {}
        if self.path.is_dir():
            _fold_in_leftovers(self.path)
        self._segments = Segments(self.path)

    @property
    def segments(self) -> list[Path]:
        """The files, in the order of writing."""
        return [file.path for file in self._opened()]

    @property
    def topics(self) -> Mapping[str, TopicInfo]:
        """Topic names, sorted, to what is known about them; each is looked up when it is asked for."""
        return Lookup("topic", self._topic_names(), self._info)

    def __getitem__(self, topic: str) -> TopicReader:
        """Return the reader of a topic.

        Raises:
            NotFoundError: There is no such topic; the message names similar ones. Also a KeyError.
        """
        if topic not in self:
            raise not_found("topic", topic, self._topic_names())
        return TopicReader(self, topic)

    def __contains__(self, topic: object) -> bool:
        """Whether there is such a topic."""
        return topic in self._channel_names()

    def read(
        self,
        topic: str,
        start_timestamp: float | None = None,
        end_timestamp: float | None = None,
        columns: Iterable[str] | None = None,
        format: str = "json",
    ) -> Any:
        """Return a topic's rows like `TopicReader.read`; without any rows if there is no such topic."""
        render = FORMATS.get(format)
        if render is None:
            raise FormatError(f"Unsupported format: {format}. The formats are {', '.join(sorted(FORMATS))}")
        low, high = rows.check_range(start_timestamp, end_timestamp)
        return render(Selection(self._opened(), topic, low, high, check_columns(columns)))

    def refresh(self) -> bool:
        """Take in what was written since; costs as much as there is new.

        Returns:
            Whether anything was.
        """
        self._opened()
        changed = self._segments.refresh()
        if changed:
            self._infos.clear()
        return changed

    @property
    def start(self) -> float | None:
        """Time of the first message on any topic, in s; None without messages."""
        times = [chunk.start_ns for chunk in self._chunks()]
        return clock.to_seconds(min(times)) if times else None

    @property
    def end(self) -> float | None:
        """Time of the last message on any topic, in s; None without messages."""
        times = [chunk.end_ns for chunk in self._chunks()]
        return clock.to_seconds(max(times)) if times else None

    @property
    def duration(self) -> float:
        """From the first message to the last, in s."""
        start, end = self.start, self.end
        return 0.0 if start is None or end is None else end - start

    @property
    def metadata(self) -> list[tuple[str, dict[str, str]]]:
        """All metadata records, in the order of writing."""
        return [(record.name, dict(record.values)) for file in self._opened() for record in file.metadata()]

    @property
    def run(self) -> dict[str, str]:
        """What is known about the run, such as its `status`: what was said last counts."""
        return self._merged(RUN_RECORD)

    @property
    def params(self) -> dict[str, Any]:
        """The parameters, by dotted name: what was set last counts."""
        params: dict[str, Any] = {}
        for name, values in self.metadata:
            if name == ABOUT_RECORD:  # each segment repeats what was set before it
                repeated = _from_json(values.get("parameters", "{}"))
                params.update(repeated if isinstance(repeated, dict) else {})
            elif name == PARAMETERS_RECORD:
                params.update({name: _from_json(text) for name, text in values.items()})
        return params

    @property
    def logs(self) -> list[Row]:
        """The rows of the log, in time order."""
        return list(rows.read(self._opened(), LOG_TOPIC))

    @property
    def metrics(self) -> Mapping[str, list[Row]]:
        """Metric names, sorted, to their rows; each is read when it is asked for."""
        topics = [name for name in self._channel_names() if name.startswith(METRIC_TOPICS)]
        names = sorted(name.removeprefix(METRIC_TOPICS) for name in topics)
        return Lookup("metric", names, lambda name: list(rows.read(self._opened(), METRIC_TOPICS + name)))

    @property
    def files(self) -> list[Row]:
        """What was said about the files that were saved with the run, in time order."""
        return list(rows.read(self._opened(), FILE_TOPIC))

    def close(self) -> None:
        """Close the files. May be called twice."""
        self._closed = True
        self._segments.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Recording({str(self.path)!r}, {len(self._segments.files)} segments)"

    def _opened(self) -> list[File]:
        if self._closed:
            raise StateError(f"the recording {str(self.path)!r} is closed; open it again to read")
        return self._segments.files

    def _chunks(self) -> list[Chunk]:
        """Return the chunks with messages in them (the times of others mean nothing)."""
        chunks = [chunk for file in self._opened() for chunk in file.index.chunks]
        return [chunk for chunk in chunks if chunk.counts != {} and chunk.uncompressed_size]

    def _channel_names(self) -> set[str]:
        return {channel.topic for file in self._opened() for channel in file.index.channels.values()}

    def _topic_names(self) -> list[str]:
        return sorted(name for name in self._channel_names() if not name.startswith(OWN_TOPICS))

    def _info(self, topic: str) -> TopicInfo:
        known = self._infos.get(topic)
        if known is None:
            known = self._infos[topic] = topics.info(self._opened(), topic)
        return known

    def _merged(self, name: str) -> dict[str, str]:
        merged: dict[str, str] = {}
        for file in self._opened():
            if any(entry.name == name for entry in file.index.metadata):
                for record in file.metadata():
                    if record.name == name:
                        merged.update(record.values)
        return merged


class TopicReader:
    """Reads one topic of a recording."""

    def __init__(self, recording: Recording, topic: str) -> None:
        """Made by `recording[topic]`."""
        self._recording = recording
        self.name = topic

    @property
    def info(self) -> TopicInfo:
        """Count, times, fields and what else is known without reading the rows."""
        return self._recording._info(self.name)

    def read(
        self,
        start_timestamp: float | None = None,
        end_timestamp: float | None = None,
        columns: Iterable[str] | None = None,
        format: str = "json",
    ) -> Any:
        """Return rows in one of the formats; nested dicts become dotted names.

        Args:
            start_timestamp: First time stamp, in s; None for the beginning.
            end_timestamp: Last time stamp, included, in s; None for the end.
            columns: Dotted names; that of a nested dict takes all of it. None and [] mean all.
            format: "json" (dict with `entries` and `count`), "jsonl" (bytes), "parquet" (bytes), "mocap" (dict) or
                "mcap" (bytes).

        Raises:
            FormatError: The format is none of these; also a ValueError.
            RangeError: The range's start lies after its end, or is not a number; also a ValueError.

        Example:
            >>> rec["robot"].read(end_timestamp=0.0, columns=["q"])
            {'entries': [{'timestamp': 0.0, 'q': [0.1, 0.2]}], 'count': 1}
        """
        return self._recording.read(self.name, start_timestamp, end_timestamp, columns, format)

    def rows(
        self,
        start_timestamp: float | None = None,
        end_timestamp: float | None = None,
        columns: Iterable[str] | None = None,
    ) -> Iterator[Row]:
        """Yield rows in time order as they were given, nested dicts as dicts, each with its time stamp as `_ts`.

        Reads on as it goes: memory holds a chunk or two, not the topic. The arguments are those of `read`.
        """
        low, high = rows.check_range(start_timestamp, end_timestamp)
        return Selection(self._recording._opened(), self.name, low, high, check_columns(columns)).rows()

    def __iter__(self) -> Iterator[Row]:
        return self.rows()

    def __len__(self) -> int:
        """How many rows it has after merging."""
        return self.info.count

    def __repr__(self) -> str:
        return f"TopicReader({self.name!r} of {str(self._recording.path)!r})"


def _fold_in_leftovers(folder: Path) -> None:
    """Give the rows that a dead recorder left in its journal a place in the recording."""
    if next(folder.glob(SESSION_GLOB), None) is not None:
        from .recovery import recover  # which loads the writing side, and is hardly ever needed

        recover(folder)


def _from_json(text: str) -> Any:
    """Return the value of a parameter's text, which is JSON or a literal such as NaN; what is neither stays text."""
    try:
        return orjson.loads(text)
    except orjson.JSONDecodeError:
        pass
    try:
        return json.loads(text)
    except ValueError:
        return text
