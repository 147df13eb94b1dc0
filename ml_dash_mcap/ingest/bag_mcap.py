"""MCAP files with ROS messages: those of a rosbag2 folder, or one alone."""

from __future__ import annotations

import heapq
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import numpy as np

from ..errors import DamagedFileError
from ..read import messages
from ..read.file import File
from ..read.records import Channel as McapChannel
from ..read.rows import LAST_NS
from .bag_messages import BATCH_MESSAGES, Batch, Channel

MAGIC = b"\x89MCAP0\r\n"
CUSTOM_RECORD = "rosbag2"


class McapBag:
    """An opened file."""

    def __init__(self, path: Path, *, salvages: bool = False) -> None:
        """Open a file.

        Args:
            path: Of the file.
            salvages: Whether to leave out what is damaged, and note it in `losses`.

        Raises:
            DamagedFileError: It is no MCAP file, or cut, or broken.
        """
        self._file = File(path, salvages=salvages)
        index = self._file.index
        if not index.finished and not salvages:
            self._file.close()
            what = "the file has no end: it was cut, or is still being written; on_damage='skip' takes what it has"
            raise DamagedFileError(path, index.end, what)
        self.custom: Mapping[str, str] = {}
        self._channels = {number: self._channel(one) for number, one in self._file.index.channels.items()}

    @property
    def channels(self) -> list[Channel]:
        """All channels."""
        return list(self._channels.values())

    @property
    def count(self) -> int:
        """Messages in all."""
        return sum(self._file.index.message_counts.values())

    @property
    def losses(self) -> list[str]:
        """What was left out so far, in words."""
        return [f"{loss.path}, byte {loss.offset}: {loss.what}" for loss in self._file.losses]

    @property
    def serialized_metadata(self) -> str:
        """The folder's `metadata.yaml`, as far as the file repeats it."""
        for record in self._file.metadata():
            if record.name == CUSTOM_RECORD and "serialized_metadata" in record.values:
                return record.values["serialized_metadata"]
        return ""

    def batches(self, wanted: Collection[Channel]) -> Iterator[Batch]:
        """Yield the messages of some channels, each channel's by time.

        Raises:
            DamagedFileError: The file is damaged further on.
        """
        waiting: list[tuple[int, int, Batch, Iterator[Batch]]] = []
        topics = dict.fromkeys(channel.topic for channel in self.channels if channel in wanted)
        for number, topic in enumerate(topics):
            _push(waiting, number, self._of_topic(topic, wanted))
        while waiting:
            _, number, batch, more = heapq.heappop(waiting)
            yield batch
            _push(waiting, number, more)

    def close(self) -> None:
        """Close the file. May be called twice."""
        self._file.close()

    def _channel(self, one: McapChannel) -> Channel:
        schema = self._file.index.schema_of(one)
        encoding = schema.encoding if schema is not None and schema.data else ""
        text = schema.data.decode("utf-8", "replace") if schema is not None and encoding else ""
        return Channel(
            one.topic, schema.name if schema is not None else "", encoding, text, one.message_encoding == "ros1"
        )

    def _of_topic(self, topic: str, wanted: Collection[Channel]) -> Iterator[Batch]:
        for found in messages.read([self._file], topic, 0, LAST_NS):
            numbers = np.array([origin.channel.id for origin in found.origins])[found.origin_of]
            times_ns = found.times_ns.tolist()
            for number in np.unique(numbers).tolist():
                channel = self._channels[number]
                if channel not in wanted:
                    continue
                which = np.flatnonzero(numbers == number).tolist()
                for first in range(0, len(which), BATCH_MESSAGES):
                    part = which[first : first + BATCH_MESSAGES]
                    yield Batch(channel, [times_ns[at] for at in part], [found.payloads[at] for at in part])


def _push(waiting: list[tuple[int, int, Batch, Iterator[Batch]]], number: int, more: Iterator[Batch]) -> None:
    batch = next(more, None)
    if batch is not None:
        heapq.heappush(waiting, (batch.times_ns[0], number, batch, more))
