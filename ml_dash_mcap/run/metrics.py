"""Metrics: points that are numbered instead of timed, as rows of topics `ml_dash/metrics/<name>`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from ..capture.topic_names import check_topic
from ..capture.topic_registry import TopicAbout
from ..errors import FieldError, UsageError
from ..file_names import METRIC, METRIC_TOPICS
from ..recorder import Recorder, open_topic
from ..rows.plain_row import EXACT_KEY, TIME_KEY
from ..rows.result_dicts import Page
from ..topic import EventTopic
from . import pages
from .readback import Readback


class Metric:
    """One metric of a run, such as the training loss.

    Points are never merged. A point's index is its place by time, then by the order in which they were logged.
    """

    __slots__ = ("_readback", "_topic", "name")

    def __init__(self, name: str, topic: EventTopic, readback: Readback) -> None:
        self.name = name
        self._topic = topic
        self._readback = readback

    def __repr__(self) -> str:
        return f"<Metric {self.name!r}>"

    def log(self, values: Mapping[str, Any] | None = None, /, **fields: Any) -> Metric:
        """Log one point; any fields.

        Args:
            values: A dict of fields.
            **fields: Fields by name; they win over those of `values`. `_ts` sets the point's time stamp, in seconds; by
                default it is the time of the recording: wall-clock time, or the latest time stamp of a track where
                those are not of now.

        Raises:
            FieldError: A value cannot be stored.
            UsageError: `values` is no dict.
            StateError: The recording is closed.

        Example:
            >>> exp.metrics("train").log({"loss": 0.5, "epoch": 3})
        """
        if values is not None:
            fields = {**self._checked(values), **fields}
        if EXACT_KEY in fields:
            raise FieldError(f"log() on metric {self.name!r}: the field name {EXACT_KEY!r} is reserved; rename it")
        if fields.get(TIME_KEY) is None:
            self._topic.add(fields)
        else:
            self._topic.append(**fields)
        return self

    def _checked(self, values: object) -> Mapping[str, Any]:
        """Return a dict of fields that was given instead of fields by name."""
        if not isinstance(values, Mapping):
            raise UsageError(f"log() on metric {self.name!r} takes a dict or fields by name, as in log(loss=0.5)")
        for name in values:
            if not isinstance(name, str):
                raise FieldError(f"log() on metric {self.name!r}: the name of a field is text, not {name!r}")
        return values

    def flush(self) -> Metric:
        """Write what was logged to the file before returning."""
        self._topic.flush()
        return self

    def read(self, start_index: int = 0, limit: int = 1000) -> Page:
        """Return points by index, flushed first.

        Args:
            start_index: The first one wanted.
            limit: How many at most.

        Returns:
            `data`, a list of `{"index", "data", "createdAt"}` whose data have `_ts` too; `startIndex`; `endIndex`;
            `total`, the number of points returned; `hasMore`.

        Raises:
            RangeError: The start or the limit is negative.
            StateError: The recording is closed.
        """
        return pages.page(self._readback.rows(self._topic.name), start_index, limit, self._readback.begun_s)

    def stats(self) -> dict[str, Any]:
        """Return the number of points, their times, and what was said about the metric (see `pages.stats`)."""
        about = self._readback.about(self._topic.name)
        return pages.stats("metricId", self.name, about.described, about.count, about.times_s, self._readback.begun_s)


class Metrics:
    """Gives the metrics of a run by name; any thread may call it.

    Example:
        >>> exp.metrics("train").log(loss=0.5, accuracy=0.92, epoch=10)
        >>> exp.metrics("train").read(start_index=0, limit=10)["data"]
    """

    __slots__ = ("_opened", "_readback", "_recorder")

    def __init__(self, recorder: Recorder, readback: Readback) -> None:
        self._recorder = recorder
        self._readback = readback
        self._opened: dict[str, Metric] = {}

    def __repr__(self) -> str:
        """Name the metrics that were opened so far; `list` finds those of earlier runs, too."""
        return f"<Metrics: {', '.join(map(repr, list(self._opened))) or 'none yet'}>"

    def __call__(
        self,
        name: str,
        description: str | None = None,
        tags: Iterable[str] | None = None,
        metadata: Mapping[str, Any] | None = None,
    ) -> Metric:
        """Return the metric of that name, the same object each time.

        Raises:
            TopicError: The name cannot be a topic's.
            StateError: The recording is closed.
        """
        metric = self._opened.get(name) if isinstance(name, str) else None
        if metric is not None and description is None and tags is None and metadata is None:
            return metric
        check_topic(name)
        about = TopicAbout(description=description, tags=tags, metadata=metadata)
        topic = open_topic(self._recorder, METRIC_TOPICS + name, METRIC, EventTopic, about)
        # Another thread may have opened the metric meanwhile; then its object stays the only one.
        return self._opened.setdefault(name, metric or Metric(name, topic, self._readback))

    def list(self) -> list[str]:
        """Return the names of all metrics with points, sorted; flushed first."""
        return self._readback.metrics()

    def flush(self) -> Metrics:
        """Write what was logged to the file before returning."""
        self._recorder.flush()
        return self
