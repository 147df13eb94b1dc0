"""Records log messages as rows of topic `ml_dash/log`, which viewers show in their log panel."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from types import FrameType
from typing import Any

from .. import clock
from ..capture.topic_registry import TopicAbout
from ..codecs.own_rows import own_schema
from ..errors import FieldError
from ..file_names import LOG, LOG_TOPIC
from ..recorder import Recorder, open_topic
from ..topic import EventTopic

LEVELS = {"info": 2, "warn": 3, "error": 4, "debug": 1, "fatal": 5}
"""ml-dash's names of the levels, and the numbers that foxglove.Log has for them."""


class Logs:
    """Writes log messages; any thread may call it.

    Nothing is printed. The message, its level, the place of the call and the fields given beside it are recorded.

    Example:
        >>> exp.logs.info("Training started", epoch=1)
        >>> exp.logs.error("Gripper lost the object", force_n=0.2)
    """

    __slots__ = ("_beside", "_name", "_recorder", "_topic")

    def __init__(self, recorder: Recorder, name: str, beside: Mapping[str, Any] | None = None) -> None:
        """Make a log.

        Args:
            recorder: Where the messages go.
            name: What viewers show as their source.
            beside: Fields that every message gets.
        """
        self._recorder = recorder
        self._name = name
        self._beside = dict(beside or {})
        self._topic: EventTopic | None = None

    def __repr__(self) -> str:
        fields = f", with {', '.join(self._beside)}" if self._beside else ""
        return f"<Logs of {self._name!r}{fields}>"

    def info(self, message: Any, **beside: Any) -> None:
        """Log what went as it should."""
        # The frame of the caller: viewers show the file and the line of the user's own call.
        self.write("info", message, beside, sys._getframe(1))

    def warn(self, message: Any, **beside: Any) -> None:
        """Log what may be wrong."""
        self.write("warn", message, beside, sys._getframe(1))

    def error(self, message: Any, **beside: Any) -> None:
        """Log what went wrong."""
        self.write("error", message, beside, sys._getframe(1))

    def debug(self, message: Any, **beside: Any) -> None:
        """Log what only helps to find a mistake."""
        self.write("debug", message, beside, sys._getframe(1))

    def fatal(self, message: Any, **beside: Any) -> None:
        """Log what ends the program."""
        self.write("fatal", message, beside, sys._getframe(1))

    def beside(self, fields: Mapping[str, Any]) -> Logs:
        """Return a log that gives every message these fields too."""
        return Logs(self._recorder, self._name, {**self._beside, **fields})

    def write(self, level: str | None, message: Any, beside: Mapping[str, Any], caller: FrameType) -> None:
        """Log a message.

        Args:
            level: One of `LEVELS`, in upper or lower case; None is "info".
            message: Text; anything else is turned into it.
            beside: Fields to keep with it.
            caller: Where it comes from.

        Raises:
            FieldError: The level is none of `LEVELS`, or a field cannot be stored.
            StateError: The recording is closed.
        """
        number = LEVELS.get(level.lower()) if isinstance(level, str) else LEVELS["info"] if level is None else None
        if number is None:
            raise FieldError(f"Invalid log level: {level!r}. Must be one of: {', '.join(LEVELS)}")
        topic = self._topic
        if topic is None:
            about = TopicAbout(schema=own_schema("ml_dash.log", "foxglove.Log"))
            topic = open_topic(self._recorder, LOG_TOPIC, LOG, EventTopic, about)
            self._topic = topic
        row = {
            "timestamp": clock.sec_nsec(time.time_ns()),
            "level": number,
            "message": message if isinstance(message, str) else str(message),
            "name": self._name,
            "file": caller.f_code.co_filename,
            "line": caller.f_lineno,
        }
        fields = {**self._beside, **beside}
        topic.add({**row, "metadata": fields} if fields else row)
