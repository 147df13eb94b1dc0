"""ROS 1 messages, as rosbag serialises them: read only."""

from __future__ import annotations

from . import ros_channel
from .codec import MessageCodec
from .encoded_channel import Decoder, EncodedChannel


class Ros1Codec(MessageCodec):
    """Messages whose schema is a ROS 1 definition."""

    def decoder(self, channel: EncodedChannel) -> Decoder | None:
        """Return what makes rows of a channel's messages."""
        is_described = ros_channel.is_described(channel.schema, ("ros1msg",))
        return ros_channel.decoder(channel, is_ros1=True) if is_described else None


CODEC = Ros1Codec()
