"""The methods that `Experiment` and `Session` have in common: logs, episodes and figures."""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, overload

from ..capture.stats import Stats
from .episode_marks import OpenEpisode
from .live import Live
from .logs import Logs


class RunMethods(ABC):
    """What can be done with an open run in both APIs."""

    @abstractmethod
    def _open_live(self, use: str) -> Live[Any]:
        """Return what the open run consists of.

        Args:
            use: What it is wanted for, for the error message.

        Raises:
            StateError: The run is not open.
        """

    @overload
    def log(
        self, message: None = None, level: None = None, metadata: Mapping[str, Any] | None = None, **beside: Any
    ) -> Logs: ...

    @overload
    def log(
        self, message: object, level: str | None = None, metadata: Mapping[str, Any] | None = None, **beside: Any
    ) -> None: ...

    def log(
        self,
        message: Any = None,
        level: str | None = None,
        metadata: Mapping[str, Any] | None = None,
        **beside: Any,
    ) -> Logs | None:
        """Log a message, or, without one, return a log whose messages get the given fields.

        Args:
            message: Text; it is recorded, not printed.
            level: "info" (the default), "warn", "error", "debug" or "fatal".
            metadata: Fields to keep with it, like `beside`.

        Raises:
            FieldError: The level is none of these, or a field cannot be stored.
            StateError: The run is not open.
        """
        logs, fields = self._open_live("log").logs, {**(metadata or {}), **beside}
        if message is None:
            return logs.beside(fields)
        logs.write(level, message, fields, sys._getframe(1))
        return None

    def episode(
        self,
        task: str | None = None,
        *,
        success: bool | None = None,
        metadata: Mapping[str, Any] | None = None,
        _ts: float | None = None,
    ) -> OpenEpisode:
        """Begin an episode: a try at a task, from here to its `end`, to the next episode, or to the end of the run.

        Its rows are those that are appended meanwhile; `Recording.episodes` gives their times. As a context manager it
        ends with the block, which may set its `success`; an exception marks it as failed, and goes on.

        Args:
            task: What is tried, in words.
            success: Whether it succeeds, if that is known already.
            metadata: Anything else, as JSON can say it.
            _ts: First time stamp of its rows, in s; by default, the next one behind the last row.

        Raises:
            FieldError: The task, success or metadata cannot be stored.
            TimestampError: `_ts` is not a time stamp.
            StateError: The run is not open.

        Example:
            >>> with exp.episode(task="pick the cube", metadata={"seed": 7}) as episode:
            ...     exp.tracks("robot").append(q=[0.1, 0.2], _ts=0.0)
            ...     episode.success = True
        """
        return self._open_live("episode").episodes.begin(task, success, metadata, _ts)

    def stats(self) -> Stats:
        """Return the recorder's figures: rows accepted, written, waiting and dropped, and more."""
        return self._open_live("stats").recorder.stats()
