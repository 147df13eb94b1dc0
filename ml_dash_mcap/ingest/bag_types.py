"""What the types of a bag's messages are made of: as the bag says, as the caller says, or as ROS's own packages do."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace

from ..errors import ConversionWarning, EncodingError
from ..messages import Channel


class Types:
    """The definitions of a bag's types."""

    def __init__(self, given: Mapping[str, str], distro: str, on_unknown: str) -> None:
        """Begin.

        Args:
            given: Definitions of the caller, by `package/Name`.
            distro: The distribution that recorded the bag; empty if nobody says.
            on_unknown: What happens where nobody knows a type: "keep", "raise" or "skip".
        """
        self._given = given
        self._distro = distro
        self.on_unknown = on_unknown
        self._known: dict[Channel, Channel] = {}

    def described(self, channel: Channel) -> Channel:
        """Return a channel with its type's definition: the caller's, the bag's own, or else ROS's."""
        if channel not in self._known:
            self._known[channel] = self._described(channel)
        return self._known[channel]

    def is_unknown(self, channel: Channel) -> bool:
        """Whether nobody knows what its messages, which are ROS's, are made of."""
        described = self.described(channel)
        return channel.message_encoding in ("cdr", "ros1") and not (described.definition or described.schema_encoding)

    def name_unknown(self, channel: Channel) -> None:
        """Say that nobody knows a type of which there are messages.

        Raises:
            EncodingError: That is an error.
        """
        what = (
            f"topic {channel.topic!r} of type {channel.type!r}: the bag does not define it, and it is no standard"
            " message"
        )
        how = f"pass definitions={{{channel.type!r}: <its .msg text>}}"
        if self.on_unknown == "raise":
            raise EncodingError(f"{what}; {how}, or on_unknown='skip' to leave it out, or 'keep' to keep its bytes")
        warnings.warn(f"{what}; its messages are kept as bytes; {how}", ConversionWarning, stacklevel=2)

    def _described(self, channel: Channel) -> Channel:
        if channel.message_encoding not in ("cdr", "ros1"):
            return channel
        encoding = "ros1msg" if channel.is_ros1 else "ros2msg"
        given = self._given.get(canonical(channel.type))
        if given is not None:
            return replace(channel, schema_encoding=encoding, definition=given.encode())
        if channel.definition:
            return channel
        from ..ros import stores  # which loads rosbags

        try:
            text = stores.known(channel.type)
        except EncodingError:
            return channel  # an encoding without a text says that the type has no fields
        return replace(channel, schema_encoding=encoding, definition=text.encode())


def canonical(name: str) -> str:
    """Return a type's name as `package/Name`, whether `msg` stood in between or not."""
    parts = name.split("/")
    return f"{parts[0]}/{parts[-1]}"
