"""Settles the channel of a topic: with its first row, or with a schema that is given before."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable
from typing import Any

from ..codecs.given.given_schema import GivenSchema
from ..errors import TopicError
from ..file_names import TRACK
from .channels import ChannelInfo
from .journal import Journal


class ChannelChoice:
    """The channel of one topic. Any thread may call any method.

    Attributes:
        channel: Of the rows so far, or of the first one.
    """

    __slots__ = ("_give", "_is_open", "_journal", "_lock", "channel")

    def __init__(
        self, channel: ChannelInfo, journal: Journal, give: Callable[[ChannelInfo, GivenSchema], ChannelInfo]
    ) -> None:
        """Begin without a row.

        Args:
            channel: Of a new topic.
            journal: Where it is announced.
            give: Announces a channel with a schema in the place of one without rows.
        """
        self.channel = channel
        self._journal = journal
        self._give = give
        self._is_open = channel.kind == TRACK and channel.schema is None
        self._lock = threading.RLock()
        """Guards `channel` while it is not settled."""

    @property
    def is_open(self) -> bool:
        """Whether the topic has no row and no schema yet."""
        return self._is_open

    def settle(self) -> ChannelInfo:
        """Return the channel of the rows; from here on it stays."""
        # In a forked child, whose journal is shut, another thread of the parent may hold the lock for ever.
        if self._is_open and not self._journal.is_shut:
            with self._lock:
                self._is_open = False
        return self.channel

    def give(self, schema: GivenSchema) -> ChannelInfo:
        """Return the channel of rows of a schema, which may be given again.

        Raises:
            TopicError: The topic has another schema, or rows without one.
            StateError: The recorder is closed, or this is a forked child.
        """
        if self._has(schema):
            return self.channel
        self._journal.check_open()
        with self._lock:
            # A signal handler may append to the topic at any call in here.
            while not self._has(schema):
                self._check_open_for(schema)
                channel = self._give(self.channel, schema)
                if self._is_open:  # no call between
                    self.channel = channel
                    self._is_open = False
            return self.channel

    def _has(self, schema: GivenSchema) -> bool:
        channel = self.channel
        return channel.schema == schema.data and channel.schema_name == (schema.name or channel.topic)

    def _check_open_for(self, schema: GivenSchema) -> None:
        if self._is_open or self._has(schema):
            return
        channel = self.channel
        if channel.schema is not None:
            raise TopicError(
                f"topic {channel.topic!r} has the schema {channel.schema_name!r} ({channel.schema_encoding}) already,"
                f" not {schema}; each schema has a topic of its own"
            )
        raise TopicError(
            f"topic {channel.topic!r} has rows without a given schema already, so it cannot take {schema}; give"
            " schema= before the first row, or use another topic"
        )


def until_first_row(encode: Callable[[dict[str, Any], Any], bytes]) -> Callable[[dict[str, Any], Any], bytes]:
    """Return the `dumps` of a topic without rows, so that `append` need not ask whether a row is the first.

    Args:
        encode: The topic's method that settles its channel and encodes the row. It is held weakly: a topic keeps its
            recorder alive, and in a cycle both would stay until the garbage collector came.
    """
    reference = weakref.WeakMethod(encode)

    def dumps(fields: dict[str, Any], default: Any) -> bytes:
        method = reference()
        if method is None:
            raise ReferenceError("the topic is gone")
        return method(fields, default)

    return dumps
