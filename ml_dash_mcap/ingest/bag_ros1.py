"""A ROS 1 bag, read with rosbags."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

from rosbags.rosbag1 import Reader
from rosbags.rosbag1.reader import ReaderError

from ..errors import DamagedFileError
from .bag_messages import Batch, Channel, Collector

MAGIC = b"#ROSBAG V"


class Ros1Bag:
    """An opened ROS 1 bag."""

    custom: Mapping[str, str] = {}
    """Such bags have no place for it."""

    def __init__(self, path: Path) -> None:
        """Open a bag.

        Raises:
            DamagedFileError: It is no ROS 1 bag, is cut, or has no index.
        """
        self._path = path
        self.losses: list[str] = []
        try:
            self._reader = Reader(path)
            self._reader.open()
        except Exception as error:  # rosbags lets many kinds of error out of damaged bags
            hint = "; `rosbag reindex` makes an index where that is missing" if isinstance(error, ReaderError) else ""
            raise DamagedFileError(path, 0, f"this ROS 1 bag cannot be read: {_why(error)}{hint}") from error
        self._channels = {
            connection.id: Channel(
                connection.topic, connection.msgtype, "ros1msg", connection.msgdef.data, is_ros1=True
            )
            for connection in self._reader.connections
        }

    @property
    def channels(self) -> list[Channel]:
        """All channels."""
        return list(self._channels.values())

    @property
    def count(self) -> int:
        """Messages in all."""
        return int(self._reader.message_count)

    def batches(self, wanted: Collection[Channel]) -> Iterator[Batch]:
        """Yield the messages of some channels, each channel's by time.

        Raises:
            DamagedFileError: A chunk cannot be read.
        """
        collector = Collector()
        try:
            connections = [one for one in self._reader.connections if self._channels[one.id] in wanted]
            for connection, time_ns, payload in self._reader.messages(connections) if connections else ():
                channel = self._channels[connection.id]
                yield from collector.add(channel.topic, channel, time_ns, bytes(payload))
        except Exception as error:
            raise DamagedFileError(self._path, 0, f"this ROS 1 bag cannot be read on: {_why(error)}") from error
        yield from collector.rest()

    def close(self) -> None:
        """Close the file. May be called twice."""
        if self._reader.bio is not None:
            self._reader.close()


def _why(error: Exception) -> str:
    return str(error) or type(error).__name__
