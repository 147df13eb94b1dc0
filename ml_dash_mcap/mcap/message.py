"""Messages as values: undecoded bytes of any encoding, on their way from one file to another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np
import numpy.typing as npt

CHUNK_BYTES = 1 << 20
"""Chunks have about as many bytes, uncompressed, which suits viewers."""

Payload = bytes | memoryview


@dataclass(frozen=True, slots=True)
class Connection:
    """Messages of one type on one topic, or on one connection to it."""

    topic: str
    type: str = ""
    """The schema's name, as its file has it, such as "sensor_msgs/msg/JointState"."""
    schema_encoding: str = ""
    """Of `definition`: "ros1msg", "ros2msg" or "ros2idl"; empty where the type has no definition."""
    definition: bytes = field(default=b"", repr=False)
    """What the type is made of, followed by the types in it."""
    message_encoding: str = "cdr"
    """"cdr" in ROS 2, "ros1" in ROS 1."""
    metadata: tuple[tuple[str, str], ...] = ()
    """Further metadata by name: `offered_qos_profiles` and `topic_type_hash` in ROS 2, `md5sum`, `callerid`
    and `latching` in ROS 1. These are the names that rosbag2 and ROS 1 give them."""

    @property
    def text(self) -> str:
        """The definition as text; comments may be in any encoding."""
        return self.definition.decode("utf-8", "replace")

    @property
    def is_ros1(self) -> bool:
        """Whether its messages are in ROS 1's serialization format."""
        return self.message_encoding == "ros1"


@dataclass(frozen=True, slots=True)
class MessageBlock:
    """Some messages, in the order in which their file has them."""

    channels: npt.NDArray[np.int64]
    """The number of each one's channel, [N]."""
    times_ns: npt.NDArray[np.uint64]
    """Log times, [N]."""
    published_ns: npt.NDArray[np.uint64]
    """Publish times, [N]."""
    sequences: npt.NDArray[np.uint32]
    """Sequence numbers, [N]."""
    payloads: list[Payload]
    """Their content, [N]."""

    def __len__(self) -> int:
        """How many there are."""
        return len(self.payloads)

    @property
    def size(self) -> int:
        """Bytes of all payloads."""
        return sum(map(len, self.payloads))

    def pick(self, which: npt.NDArray[np.intp]) -> MessageBlock:
        """Return some of them."""
        return MessageBlock(
            self.channels[which],
            self.times_ns[which],
            self.published_ns[which],
            self.sequences[which],
            [self.payloads[at] for at in which.tolist()],
        )

    def part(self, first: int, last: int) -> MessageBlock:
        """Return the messages from number `first` up to `last`, which is not included."""
        which = slice(first, last)
        return MessageBlock(
            self.channels[which],
            self.times_ns[which],
            self.published_ns[which],
            self.sequences[which],
            self.payloads[which],
        )

    def renumbered(self, numbers: Mapping[int, int]) -> MessageBlock:
        """Return the same with other numbers of channels.

        Args:
            numbers: The old numbers of all its channels, to the new numbers. They may be any numbers.
        """
        old = np.array(sorted(numbers), np.int64)
        new = np.array([numbers[number] for number in old.tolist()], np.int64)
        return replace(self, channels=new[np.searchsorted(old, self.channels)])

    @staticmethod
    def joined(blocks: Sequence[MessageBlock]) -> MessageBlock:
        """Return blocks, one or more, one behind the other."""
        if len(blocks) == 1:
            return blocks[0]
        return MessageBlock(
            np.concatenate([block.channels for block in blocks]),
            np.concatenate([block.times_ns for block in blocks]),
            np.concatenate([block.published_ns for block in blocks]),
            np.concatenate([block.sequences for block in blocks]),
            list(chain.from_iterable(block.payloads for block in blocks)),
        )
