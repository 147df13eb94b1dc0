"""Decodes ROS 2 and DDS messages that are serialised as CDR; nothing is recorded in them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from . import ros_channel
from .codec import ColumnReader, MessageCodec
from .encoded_channel import Decoder, EncodedChannel


class CdrCodec(MessageCodec):
    """Messages whose schema is a ROS 2 definition or IDL."""

    def decoder(self, channel: EncodedChannel) -> Decoder | None:
        """Return the decoder of a channel's messages."""
        is_described = ros_channel.is_described(channel.schema, ("ros2msg", "ros2idl", "omgidl"))
        return ros_channel.decoder(channel, is_ros1=False) if is_described else None

    def column_reader(self, decoder: Callable[[], Decoder], columns: Sequence[str] | None) -> ColumnReader:
        """Return a reader that makes columns of messages, field by field."""
        from .ros_columns import RosColumnReader  # pyarrow, which only readers of columns wait for

        return RosColumnReader(decoder, columns)


CODEC = CdrCodec()
