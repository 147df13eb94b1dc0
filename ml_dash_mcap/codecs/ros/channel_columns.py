"""The messages of one ROS channel as flat columns of Arrow, in the types and order that their rows would give."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ...rows.dotted import flatten
from ...rows.encode import TIME_KEY
from ...rows.field_choice import project
from . import arrow_columns
from .message_types import Definitions


class ChannelColumns:
    """Reads blocks of messages. Any thread may call it."""

    def __init__(
        self, definitions: Definitions, *, is_ros1: bool, columns: Sequence[str] | None, time_name: str = TIME_KEY
    ) -> None:
        """Prepare to read.

        Args:
            definitions: What the messages are made of.
            is_ros1: Whether they are in ROS 1's format, instead of CDR.
            columns: Dotted names of those that are wanted; None for all.
            time_name: What the column of time stamps will be called, which is not among these.
        """
        self._definitions = definitions
        self._is_ros1 = is_ros1
        self._columns = columns
        self._time_name = time_name

    def read(self, payloads: Sequence[bytes]) -> dict[str, Any] | None:
        """Return the columns of messages by dotted name; None if they have to be decoded one by one.

        That is so for messages that are not what their definition says, for what Arrow has no type for, and for few
        messages with long lists, which are faster to read one by one.
        """
        if not payloads:
            return None
        try:
            nested = arrow_columns.read(self._definitions, list(payloads), is_ros1=self._is_ros1)
        except (ValueError, OverflowError, RecursionError):
            return None
        if TIME_KEY in nested:
            return None  # each row tells its own time
        row = {**nested, TIME_KEY: None}
        flat = flatten(row if self._columns is None else project(row, self._columns), self._time_name)
        return {name: array for name, array in flat.items() if name != self._time_name}
