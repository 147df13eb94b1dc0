"""What a bag is made of, whatever its format: channels, and their messages some at a time."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

BATCH_MESSAGES = 2048
BATCH_BYTES = 4_000_000
"""Messages of a channel are handed on by about so many at most."""


@dataclass(frozen=True, slots=True)
class Channel:
    """Messages of one type on one topic."""

    topic: str
    type: str
    """As the bag has it, such as "sensor_msgs/msg/JointState"."""
    encoding: str = ""
    """Of `text`: "ros1msg", "ros2msg" or "ros2idl"; empty if the bag does not say what the type is made of."""
    text: str = field(default="", repr=False)
    is_ros1: bool = False
    """Whether messages are in ROS 1's serialization format, or else in CDR."""


class Batch(NamedTuple):
    """Messages of one channel, in the order of the bag."""

    channel: Channel
    times_ns: list[int]
    payloads: list[bytes]


class Bag(Protocol):
    """An opened bag."""

    @property
    def channels(self) -> list[Channel]:
        """All channels, also those without messages."""

    @property
    def count(self) -> int:
        """Messages in all."""

    @property
    def custom(self) -> Mapping[str, str]:
        """What somebody wrote about the bag, by key."""

    @property
    def losses(self) -> list[str]:
        """What was left out because it is damaged, in words."""

    def batches(self, wanted: Collection[Channel]) -> Iterator[Batch]:
        """Yield the messages of some channels, each channel's by time as far as the bag's index has them so."""

    def close(self) -> None:
        """Close the files. May be called twice."""


class Collector:
    """Puts messages that come one by one into batches."""

    def __init__(self) -> None:
        self._waiting: dict[Any, Batch] = {}
        self._sizes: dict[Any, int] = {}
        self._total = 0

    def add(self, key: Any, channel: Channel, time_ns: int, payload: bytes) -> Iterator[Batch]:
        """Take a message; yields what is ready."""
        batch = self._waiting.get(key)
        if batch is None:
            batch = self._waiting[key] = Batch(channel, [], [])
            self._sizes[key] = 0
        batch.times_ns.append(time_ns)
        batch.payloads.append(payload)
        self._sizes[key] += len(payload)
        self._total += len(payload)
        if len(batch.times_ns) >= BATCH_MESSAGES or self._sizes[key] >= BATCH_BYTES:
            self._total -= self._sizes.pop(key)
            yield self._waiting.pop(key)
        elif self._total >= 4 * BATCH_BYTES:
            yield from self.rest()

    def rest(self) -> Iterator[Batch]:
        """Yield all that is left."""
        waiting, self._waiting = self._waiting, {}
        self._sizes.clear()
        self._total = 0
        yield from waiting.values()
