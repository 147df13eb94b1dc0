"""ROS 1 messages, as rosbag serialises them: read only."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from . import ros_channel
from .codec import ColumnReader, MessageCodec
from .encoded_channel import Decoder, EncodedChannel


class Ros1Codec(MessageCodec):
    """Messages whose schema is a ROS 1 definition."""

    def decoder(self, channel: EncodedChannel) -> Decoder | None:
        """Return the decoder of a channel's messages."""
        is_described = ros_channel.is_described(channel.schema, ("ros1msg",))
        return ros_channel.decoder(channel, is_ros1=True) if is_described else None

    def column_reader(self, decoder: Callable[[], Decoder], columns: Sequence[str] | None) -> ColumnReader:
        """Return a reader that makes columns of messages, field by field."""
        from .ros_columns import RosColumnReader  # pyarrow, which only readers of columns wait for

        return RosColumnReader(decoder, columns)


CODEC = Ros1Codec()
