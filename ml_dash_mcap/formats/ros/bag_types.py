"""Finds the definitions of a bag's types: the bag's, the caller's, or those of ROS's own packages."""

from __future__ import annotations

import warnings
from dataclasses import replace

from ...codecs.decoding import Decoding
from ...codecs.ros.definition_sources import Supply, complete
from ...codecs.ros.distros import Likely
from ...codecs.ros_channel import DIGEST_KEYS
from ...errors import ConversionWarning, EncodingError
from ...mcap.message import Connection


class Types:
    """The definitions of a bag's types."""

    def __init__(self, decoding: Decoding, likely: Likely) -> None:
        """Begin.

        Args:
            decoding: The caller's definitions, and the treatment of unknown types.
            likely: The distributions of ROS 2 that may have recorded the bag.
        """
        self.decoding = decoding
        self.likely = likely
        self._supply = Supply(decoding.definitions)
        self._known: dict[Connection, Connection] = {}

    def described(self, channel: Connection) -> Connection:
        """Return a channel with its type's definition: the caller's, the bag's own, or else ROS's."""
        if channel not in self._known:
            self._known[channel] = self._described(channel)
        return self._known[channel]

    def is_unknown(self, channel: Connection) -> bool:
        """Whether a channel has messages of ROS whose definition is unknown."""
        described = self.described(channel)
        return channel.message_encoding in ("cdr", "ros1") and not (described.definition or described.schema_encoding)

    def name_unknown(self, channel: Connection) -> None:
        """Warn of, or refuse, a type that is unknown although there are messages of it.

        Raises:
            EncodingError: `on_unknown` is "raise".
        """
        what = (
            f"topic {channel.topic!r} of type {channel.type!r}: the bag does not define it, and it is no standard"
            " message"
        )
        how = f"pass definitions={{{channel.type!r}: <its .msg text>}}"
        if self.decoding.on_unknown == "raise":
            raise EncodingError(f"{what}; {how}, or on_unknown='skip' to leave it out, or 'bytes' to keep its bytes")
        warnings.warn(f"{what}; its messages are kept as bytes; {how}", ConversionWarning, stacklevel=2)

    def _described(self, channel: Connection) -> Connection:
        if channel.message_encoding not in ("cdr", "ros1"):
            return channel
        encoding = "ros1msg" if channel.is_ros1 else "ros2msg"
        digest = dict(channel.metadata).get(DIGEST_KEYS[channel.is_ros1], "")
        if self.decoding.definitions and (channel.definition or self._supply.text(channel.type) is not None):
            return self._completed(channel, digest)
        if channel.definition:
            return channel
        # Imported only for a bag without definitions, because it loads rosbags.
        from ...codecs.ros import standard_types

        try:
            standard = standard_types.find(channel.type, self.likely, is_ros1=channel.is_ros1, digest=digest)
        except EncodingError:
            return channel  # an encoding without a text says that the type has no fields
        if standard.others:
            warnings.warn(
                f"topic {channel.topic!r}: {channel.type} is taken for that of {standard.distro}; that of"
                f" {', '.join(standard.others)} has other fields, and the bag does not say which it is; pass"
                f" definitions={{{channel.type!r}: <its .msg text>}} to say it",
                ConversionWarning,
                stacklevel=2,
            )
        return replace(channel, schema_encoding=encoding, definition=standard.text.encode())

    def _completed(self, channel: Connection, digest: str) -> Connection:
        """Return a channel whose definition is the caller's, or has those of the caller's types that it lacks."""
        supply = replace(self._supply, likely=self.likely, is_ros1=channel.is_ros1, digest=digest)
        given = self._supply.text(channel.type)
        try:
            encoding, text = complete(channel.type, channel.schema_encoding, channel.text, supply)
        except EncodingError:  # a type in it is unknown; the schema stays as it is
            if given is None:
                return channel
            encoding, text = "ros1msg" if channel.is_ros1 else "ros2msg", given
        if given is None and text == channel.text:
            return channel
        return replace(channel, schema_encoding=encoding, definition=text.encode())
