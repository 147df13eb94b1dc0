"""MCAP files with ROS messages: those of a rosbag2 folder, or one alone."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping
from pathlib import Path

from ..read import messages
from ..read.file import File
from ..read.records import Channel as McapChannel
from ..read.rows import LAST_NS
from .bag_messages import BATCH_BYTES, BATCH_MESSAGES, Batch, Channel

MAGIC = b"\x89MCAP0\r\n"
CUSTOM_RECORD = "rosbag2"


class McapBag:
    """An opened file."""

    def __init__(self, path: Path) -> None:
        """Open a file.

        Raises:
            DamagedFileError: It is no MCAP file, or broken.
        """
        self._file = File(path)
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
    def serialized_metadata(self) -> str:
        """The folder's `metadata.yaml`, as far as the file repeats it."""
        for record in self._file.metadata():
            if record.name == CUSTOM_RECORD and "serialized_metadata" in record.values:
                return record.values["serialized_metadata"]
        return ""

    def batches(self) -> Iterator[Batch]:
        """Yield all messages, each channel's by time.

        Raises:
            DamagedFileError: The file is damaged further on.
        """
        waiting: list[tuple[int, int, Batch, Iterator[Batch]]] = []
        for number, topic in enumerate(dict.fromkeys(channel.topic for channel in self.channels)):
            _push(waiting, number, self._of_topic(topic))
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

    def _of_topic(self, topic: str) -> Iterator[Batch]:
        for found in messages.read([self._file], topic, 0, LAST_NS):
            by_channel: dict[int, Batch] = {}
            size = 0
            origins = [origin.channel.id for origin in found.origins]
            for which, time_ns, payload in zip(
                found.origin_of.tolist(), found.times_ns.tolist(), found.payloads, strict=True
            ):
                number = origins[which]
                batch = by_channel.get(number)
                if batch is None:
                    batch = by_channel[number] = Batch(self._channels[number], [], [])
                batch.times_ns.append(time_ns)
                batch.payloads.append(payload)
                size += len(payload)
                if len(batch.times_ns) >= BATCH_MESSAGES or size >= BATCH_BYTES:
                    yield from by_channel.values()
                    by_channel, size = {}, 0
            yield from by_channel.values()


def _push(waiting: list[tuple[int, int, Batch, Iterator[Batch]]], number: int, more: Iterator[Batch]) -> None:
    batch = next(more, None)
    if batch is not None:
        heapq.heappush(waiting, (batch.times_ns[0], number, batch, more))
