"""Episodes of a run: where a try at a task began and ended, as rows of topic `ml_dash/episodes`."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Mapping
from types import TracebackType
from typing import Any

from ..capture.topic_registry import TopicAbout
from ..codecs.own_rows import own_schema
from ..errors import FieldError, RangeError
from ..file_names import EPISODE, EPISODE_TOPIC
from ..recorder import Recorder, open_topic
from ..topic import EventTopic
from .endings import status_by

_log = logging.getLogger("ml_dash_mcap")


class Episodes:
    """Begins the episodes of a run, one after the other; any thread may call it."""

    __slots__ = ("_begun", "_lock", "_open", "_recorder")

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self._lock = threading.RLock()
        """Guards `_open` and `_begun`."""
        self._open: OpenEpisode | None = None
        self._begun = 0

    def begin(
        self, task: str | None, success: bool | None, metadata: Mapping[str, Any] | None, time: float | None
    ) -> OpenEpisode:
        """Begin an episode, and end the one that is still open; see `Experiment.episode`."""
        stated = _check(task, success, metadata)
        about = TopicAbout(schema=own_schema("ml_dash.episode"))
        topic = open_topic(self._recorder, EPISODE_TOPIC, EPISODE, EventTopic, about)
        start = None if time is None else topic.time_of(time)
        with self._lock:
            self.end_open()
            episode = OpenEpisode(topic, self._recorder.session, self._begun, start, *stated)
            self._begun += 1
            self._open = episode
        return episode

    def end_open(self, *, has_failed: bool = False) -> None:
        """End the episode that is still open, if there is one.

        Args:
            has_failed: Whether the run has failed. An open episode without a stated success then fails too.
        """
        with self._lock:
            episode, self._open = self._open, None
        if episode is not None and episode.is_open:
            if has_failed and episode.success is None:
                episode.success = False
            episode.end()


class OpenEpisode:
    """An episode that is being recorded. `end` ends it; so does the next one, and the end of the run.

    As a context manager it ends with the block; an exception marks it as failed, and goes on. Of one that Ctrl-C ends
    nobody knows, unless its `success` was set.

    Example:
        >>> with exp.episode(task="pick the cube") as episode:
        ...     exp.tracks("robot").append(q=[0.1, 0.2], _ts=0.0)
        ...     episode.success = True
        ...     episode.metadata["reward"] = 0.9
    """

    __slots__ = ("_end", "_lock", "_number", "_revision", "_run", "_topic", "metadata", "start", "success", "task")

    def __init__(
        self,
        topic: EventTopic,
        run: str,
        number: int,
        start: float | None,
        task: str | None,
        success: bool | None,
        metadata: dict[str, Any],
    ) -> None:
        """Mark the begin; done by `Experiment.episode`.

        Args:
            topic: Where the marks go.
            run: The recorder's session.
            number: Among its episodes, from 0.
            start: Its first time stamp, in s; by default, the next one behind the last row.
            task: What is tried.
            success: Whether it succeeds, if that is known already.
            metadata: Anything else.
        """
        self._topic = topic
        self._run = run
        self._number = number
        self._revision = 0
        self._end: float | None = None
        self._lock = threading.RLock()
        """Guards the marks, which are written one after the other."""
        last = topic.last_s
        # The next double behind the last row, so that a range with both ends included holds the episode's rows only
        # (docs/decisions, 0012).
        self.start = start if start is not None or last is None else math.nextafter(last, math.inf)
        """First time stamp of its rows, in s; None if the recorder has had no row yet: then its first one."""
        self.task = task
        self.success = success
        """Whether it succeeded; may be set until it ends. None if that is not stated."""
        self.metadata = metadata
        """Anything else; may be changed until it ends."""
        self._mark(start)

    @property
    def is_open(self) -> bool:
        """Whether it has not ended yet."""
        return self._end is None

    def end(self, success: bool | None = None, *, _ts: float | None = None) -> None:
        """End it with the last row. Once it has ended, only what is said of its success changes.

        Args:
            success: Whether it succeeded; may be said later, too. None leaves it at what `episode.success` says.
            _ts: Last time stamp of its rows, included, in s; that of the last row by default.

        Raises:
            FieldError: `success`, `task` or `metadata` cannot be stored; it has ended without them.
            RangeError: `_ts` lies before its start; also a ValueError.
            StateError: The recording is closed.
        """
        with self._lock:
            if success is not None:
                self.success = success
            if not self.is_open:
                if success is not None:
                    self._mark(None)
                return
            time = None if _ts is None else self._topic.time_of(_ts)
            if time is not None and self.start is not None and time < self.start:
                raise RangeError(f"an episode that starts at {self.start!r} cannot end at _ts={_ts!r}")
            self._end = self._last() if time is None else time
            self._mark(time)

    def __enter__(self) -> OpenEpisode:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.end()
            return
        if not self.is_open:
            return
        if status_by(error) == "failed":
            self.success = False
        try:
            self.end()
        except Exception as trouble:  # the block's exception goes on; what came of marking the end must not replace it
            _log.error("marking the end of an episode failed: %s: %s", type(trouble).__name__, trouble)

    def __repr__(self) -> str:
        return f"<episode {self._number} of this run, task {self.task!r}, {'open' if self.is_open else 'ended'}>"

    def _last(self) -> float:
        """Return the time stamp of its last row, in s; where there is none, of a place without rows."""
        last = self._topic.last_s
        if last is None:
            self.start = self._topic.now()
            return self.start
        return last if self.start is None else max(last, self.start)

    def _mark(self, time: float | None) -> None:
        """Write what is known of it, at a time, in s, or now."""
        mark = {"run": self._run, "number": self._number, "revision": self._revision}
        mark |= {name: value for name, value in (("start", self.start), ("end", self._end)) if value is not None}
        self._revision += 1
        try:
            stated = dict(zip(_WORDS, _check(self.task, self.success, self.metadata), strict=True))
            self._topic.add(
                {**mark, **{name: value for name, value in stated.items() if value not in (None, {})}}, time
            )
        except FieldError:
            if not self.is_open:
                # The end counts more than the words beside it, so it is recorded without them.
                self._topic.add(mark, time)
            raise


_WORDS = ("task", "success", "metadata")


def _check(task: Any, success: Any, metadata: Any) -> tuple[str | None, bool | None, dict[str, Any]]:
    """Return the checked description of an episode.

    Raises:
        FieldError: A value has a wrong type.
    """
    if task is not None and not isinstance(task, str):
        raise FieldError(f"task={task!r}: the task of an episode is a text")
    if getattr(getattr(success, "dtype", None), "kind", "") == "b" and getattr(success, "ndim", 1) == 0:
        # `numpy.bool_` is no `bool`, and comparisons of arrays return it.
        success = bool(success)  # numpy's
    if success is not None and not isinstance(success, bool):
        raise FieldError(f"success={success!r}: an episode's success is True, False, or None where nobody knows")
    if metadata is not None and not isinstance(metadata, Mapping):
        raise FieldError(f"metadata={metadata!r}: pass a dict")
    return task, success, dict(metadata or {})
