"""The topics of a recording, by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, overload

from . import renamed_arguments
from .errors import StateError, UsageError
from .file_names import OWN_TOPICS
from .inspect import topics
from .inspect.topics import TopicInfo
from .opening import Opened
from .query import topic_rows
from .query.file import File
from .query.lazy_mapping import Lookup
from .query.stored_topic import StoredTopic
from .query.topic_part import Row
from .rows.result_dicts import BytesFormat, Entries, Take
from .suggestions import not_found
from .topic_reader import Columns, Json, Seconds, TopicReader


class RecordedTopics(Mapping[str, TopicReader]):
    """The part of a `Recording` that is about its topics: a mapping from their names to their readers."""

    def __init__(self, files: Opened) -> None:
        """Take the open files.

        Args:
            files: Closed by whoever opened them.
        """
        self._files = files
        self._closed = False
        self._infos: dict[str, TopicInfo] = {}

    @property
    def path(self) -> Path:
        """The path that was opened; of several paths, the first. In a store, a pure path."""
        return self._files.paths[0]

    @property
    def topics(self) -> Mapping[str, TopicInfo]:
        """Topic names, sorted, to what is known about them; each is looked up when it is asked for."""
        return Lookup("topic", self._topic_names(), self._info, str(self.path))

    def __getitem__(self, topic: str) -> TopicReader:
        """Return the reader of a topic.

        Raises:
            NotFoundError: There is no such topic; the message names similar ones. Also a KeyError.
        """
        if topic not in self:
            raise not_found("topic", topic, self._topic_names(), str(self.path))
        return TopicReader(_View(self._opened, self._info), topic)

    def __iter__(self) -> Iterator[str]:
        """Yield the names of the topics, sorted."""
        return iter(self._topic_names())

    def __len__(self) -> int:
        """How many topics there are, without the library's own."""
        return len(self._topic_names())

    __eq__ = object.__eq__  # a mapping would compare readers, which are made anew when they are asked for
    __hash__ = object.__hash__

    def __contains__(self, topic: object) -> bool:
        """Whether there is such a topic."""
        files = self._opened()
        if any(topic in file.glance.channels_by_topic for file in files):
            return True
        verified = [file.verify() for file in files]  # a damaged summary may have misspelt it
        return any(verified) and topic in self._channel_names()

    @overload
    def read(
        self, topic: str, start: Seconds = None, end: Seconds = None, columns: Columns = None, format: Json = "json"
    ) -> Entries: ...
    @overload
    def read(
        self, topic: str, start: Seconds = None, end: Seconds = None, columns: Columns = None, *, format: BytesFormat
    ) -> bytes: ...
    @overload
    def read(
        self,
        topic: str,
        start: Seconds = None,
        end: Seconds = None,
        columns: Columns = None,
        *,
        format: Literal["mocap"],
    ) -> Take: ...
    @overload
    def read(
        self, topic: str, start: Seconds = None, end: Seconds = None, columns: Columns = None, format: str = "json"
    ) -> Any: ...
    def read(
        self,
        topic: str,
        start: Seconds = None,
        end: Seconds = None,
        columns: Columns = None,
        format: str = "json",
        **renamed: Any,
    ) -> Any:
        """Return a topic's rows: `recording[topic].read(...)`.

        Raises:
            NotFoundError: There is no such topic or column; also a KeyError.
        """
        start, end = renamed_arguments.take_range("Recording.read", start, end, renamed)
        return self[topic].read(start, end, columns, format)

    def _opened(self) -> list[File]:
        """Return the files, in the order of writing.

        Raises:
            StateError: The recording is closed.
        """
        if self._closed:
            raise StateError(f"the recording {str(self.path)!r} is closed; open it again to read")
        return self._files.segments.files

    def _stored(self, topic: str) -> StoredTopic:
        return StoredTopic(self._opened, topic)

    def _rows(self, topic: str) -> list[Row]:
        return list(topic_rows.read(self._stored(topic)))

    def _channel_names(self) -> set[str]:
        return {topic for file in self._opened() for topic in file.glance.channels_by_topic}

    def _topic_names(self) -> list[str]:
        return sorted(name for name in self._channel_names() if not name.startswith(OWN_TOPICS))

    def _chosen(self, topics: Iterable[str] | None) -> list[str]:
        """Return the names that a caller gave, each once and all there; None is all topics of a robot."""
        if topics is None:
            return self._topic_names()
        if isinstance(topics, str):
            raise UsageError(f"topics={topics!r}: pass a list of topics, such as topics=[{topics!r}]")
        names = list(dict.fromkeys(topics))
        for name in names:
            if name not in self:
                raise not_found("topic", name, self._topic_names(), str(self.path))
        return names

    def _info(self, topic: str) -> TopicInfo:
        info = self._infos.get(topic)
        if info is None:
            info = self._infos[topic] = topics.info(self._stored(topic))
        return info


def stored_topic(recording: RecordedTopics, topic: str) -> StoredTopic:
    """Return a topic as a recording's files have it, whether there is one or not."""
    return StoredTopic(recording._opened, topic)


@dataclass(frozen=True, slots=True)
class _View:
    """The part of a recording that the reader of a topic sees."""

    files: Callable[[], Sequence[File]]
    info: Callable[[str], TopicInfo]
