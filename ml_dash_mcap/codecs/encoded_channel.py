"""A channel whose messages are to be decoded, and the warnings about messages that cannot be decoded."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

from ..errors import EncodingError, UndecodedWarning
from ..mcap.records import Channel, Schema
from .decoding import Decoding
from .ros.distros import Likely

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

Row = dict[str, Any]

Decoder = Callable[[bytes], "Row | None"]
"""Returns a message's row; None for a message that is left out."""

RAW_FIELD = "data"
"""Holds the payload of messages that are not decoded."""

ODD_FIELD = "_data"
"""Holds the payload of a message that is not decoded among others that are, and may have a field `data`."""

_ROS = ("ros1", "cdr")


class DecodedRun(NamedTuple):
    """Consecutive messages of a block."""

    start: int
    end: int
    """Numbers of the first message, and of the one behind the last."""
    decode: Callable[[int, int], list[Row]] | None
    """Decodes some of them at once, by the numbers of the first one and of the one behind the last; None where each has
    to be decoded by itself. It raises a `ValueError` where one does not fit its schema."""


class DecodableBlock(Protocol):
    """Messages of one channel that were looked at together."""

    times: npt.NDArray[np.float64]
    """The rows' own time stamps, [N], in s; NaN where these have to be decoded one by one."""

    def runs(self, among: npt.NDArray[np.bool_]) -> Iterator[DecodedRun]:
        """Yield runs of consecutive messages, which together are all messages.

        Args:
            among: The messages that may be decoded with others, [N]; of these, all have a time stamp.
        """


@runtime_checkable
class BlockDecoder(Protocol):
    """A `Decoder` that decodes many messages faster than one by one."""

    def block(self, payloads: Sequence[bytes]) -> DecodableBlock | None:
        """Look at the messages of a block; None if they should be decoded one by one."""


@dataclass(frozen=True, slots=True)
class EncodedChannel:
    """A channel, its schema, and how to decode messages for which these lack definitions."""

    channel: Channel
    schema: Schema
    decoding: Decoding
    likely: Callable[[], Likely]
    """Returns the distributions of ROS 2 that the messages may come from."""

    def warn(self, category: type[Warning], what: str) -> None:
        """Tell the user something about the topic."""
        warnings.warn(f"topic {self.channel.topic!r}{what}", category, stacklevel=2)

    @property
    def hint(self) -> str:
        """The argument to pass so that the messages are decoded, as text; empty if there is none."""
        if self.channel.message_encoding not in _ROS:
            return ""
        return f"; pass definitions={{{self.schema.name!r}: <its .msg text>}} to decode it"

    def give_up(self, why: str, hint: str = "", field: str = RAW_FIELD) -> Decoder:
        """Return a stand-in for a decoder that cannot be made, and warn the user.

        Raises:
            EncodingError: The option `on_unknown` is "raise".
        """
        how = self.decoding.on_unknown
        if how == "raise":
            raise EncodingError(f"topic {self.channel.topic!r}{why}{hint}")
        if how == "skip":
            self.warn(UndecodedWarning, f"{why}; it is left out{hint}")
            return _leave_out
        self.warn(UndecodedWarning, f"{why}; its rows have the bytes of each as {field!r}{hint}")
        return lambda payload: {field: payload}

    def misfit(self, field: str = ODD_FIELD) -> Callable[[bytes, Exception], Row | None]:
        """Return a function for messages that do not fit their schema. It warns the user of the first of them."""
        carriers: list[Decoder] = []

        def take(payload: bytes, why: Exception) -> Row | None:
            if not carriers:
                encoding = self.channel.message_encoding
                what = f" has a message of {len(payload)} bytes that is no {self.schema.name} in {encoding}: {why}"
                carriers.append(self.give_up(f"{what}; such a message is not decoded", self.hint, field))
            return carriers[0](payload)

        return take


def _leave_out(payload: bytes) -> None:
    return None
