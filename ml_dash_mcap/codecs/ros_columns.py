"""The ROS messages of one channel, block by block, as columns of Arrow, in the types and order that their rows give."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..rows.dotted import flatten
from ..rows.field_choice import project
from ..rows.plain_row import TIME_KEY
from .codec import Columns
from .encoded_channel import Decoder
from .ros import arrow_columns
from .ros.message_decoder import MessageDecoder

LEAST_MESSAGES = 32
"""Fewer are as fast to read one by one: by columns, the first costs 0.3 to 0.5 ms, and the others next to nothing."""


class RosColumnReader:
    """Reads blocks of messages field by field."""

    def __init__(self, decoder: Callable[[], Decoder], columns: Sequence[str] | None) -> None:
        """Begin to read.

        Args:
            decoder: Returns what makes rows of the messages.
            columns: Dotted names of those that are wanted; None for all.
        """
        self._decoder = decoder
        self._columns = columns

    def read(self, payloads: Sequence[bytes]) -> Columns | None:
        """Return the columns of messages; None if they have to be decoded one by one.

        That is so for few messages, also for some more with long lists, which are faster to read one by one; for
        messages that are not what their definition says; and for what Arrow has no type for.
        """
        decode = self._decoder()
        if len(payloads) < LEAST_MESSAGES or not isinstance(decode, MessageDecoder):
            return None
        try:
            nested = arrow_columns.read(decode.definitions, list(payloads), is_ros1=decode.is_ros1)
        except (ValueError, OverflowError, RecursionError):
            return None
        if TIME_KEY in nested:
            return None  # each row tells its own time
        row = {**nested, TIME_KEY: None}
        arrays = flatten(row if self._columns is None else project(row, self._columns), TIME_KEY)
        del arrays[TIME_KEY]
        return Columns(arrays, np.empty(0, np.intp))

    def read_exactly(self, payloads: Sequence[bytes]) -> dict[str, Any] | None:
        """Return None: in columns, bytes and numbers that are not finite do not stand as formats of text have them."""
        return None
