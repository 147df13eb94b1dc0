"""The protocols of every bag, whatever its format: files with channels, and their messages as they are stored."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
import zstandard

from ...errors import DamagedFileError
from ...mcap.message import Connection, MessageBlock, Payload


class BagFile(Protocol):
    """One file of a bag, opened."""

    name: str
    """Without its folder and without the suffix of its compression."""

    @property
    def channels(self) -> Mapping[int, Connection]:
        """All channels by their numbers in the file, also those without messages."""

    @property
    def count(self) -> int:
        """Messages in all, as the file's index says."""

    @property
    def losses(self) -> list[str]:
        """Descriptions of the damaged parts that were left out so far."""

    @property
    def corrections(self) -> list[str]:
        """Wrong statements of the file about itself, in words; nothing is lost by them."""

    def blocks(self, wanted: Collection[int]) -> Iterator[MessageBlock]:
        """Yield the messages of some channels, in the order in which the file has them.

        Raises:
            DamagedFileError: The file is damaged further on.
        """

    def close(self) -> None:
        """Close the file. May be called twice."""


class Bag(Protocol):
    """A bag: its files, and what is known of all of them."""

    format: str
    """"rosbag1" or "rosbag2"."""
    distro: str
    """Name of the ROS distribution that recorded it; empty if it is not stated."""
    version: int
    """The version of its metadata; 0 without metadata."""
    text: str
    """The whole text of `metadata.yaml`; empty without the file."""
    custom: Mapping[str, str]
    """The custom data of the bag, by key."""
    channels: list[Connection]
    """Those of all files, each once."""
    count: int
    """Messages in all."""

    def files(self) -> Iterator[BagFile]:
        """Open the files one after the other; each is closed when the next one is asked for."""

    def close(self) -> None:
        """Remove what was unpacked. May be called twice."""


# A message of a few bytes may claim any size; more than this is refused before the memory is asked for.
_MOST_MESSAGE_BYTES = 1 << 30


def unpacked(block: MessageBlock, path: Path, losses: list[str] | None) -> MessageBlock:
    """Decompress messages, each of which is compressed by zstd.

    Args:
        block: The messages.
        path: Their file.
        losses: Takes in those that are damaged, which are left out; None to raise.

    Raises:
        DamagedFileError: A message cannot be decompressed.
    """
    unpack = zstandard.ZstdDecompressor().decompress
    payloads: list[Payload] = []
    kept = []
    for at, payload in enumerate(block.payloads):
        try:
            size = zstandard.frame_content_size(payload)  # unpack takes that much memory at once; -1 if it is not there
            if size > _MOST_MESSAGE_BYTES:
                raise zstandard.ZstdError(f"it says that it has {size} bytes; the limit is {_MOST_MESSAGE_BYTES}")
            payloads.append(unpack(payload, max_output_size=_MOST_MESSAGE_BYTES))
        except zstandard.ZstdError as error:
            what = f"the message at {block.times_ns[at]} ns cannot be decompressed: {error}"
            if losses is None:
                raise DamagedFileError(path, 0, what) from error
            losses.append(f"{path}: {what}")
        else:
            kept.append(at)
    whole = block if len(kept) == len(block) else block.pick(np.array(kept, np.intp))
    return replace(whole, payloads=payloads)


class ConnectionBatch(NamedTuple):
    """Messages of one channel, in the order of the bag."""

    channel: Connection
    times_ns: list[int]
    payloads: list[bytes]


def batches(file: BagFile, wanted: Collection[Connection]) -> Iterator[ConnectionBatch]:
    """Yield a file's messages of some channels, those of a block and channel together."""
    numbers = {number for number, channel in file.channels.items() if channel in wanted}
    for block in file.blocks(numbers):
        for number in np.unique(block.channels).tolist():
            part = block.pick(np.flatnonzero(block.channels == number))
            yield ConnectionBatch(
                file.channels[number], part.times_ns.tolist(), [bytes(payload) for payload in part.payloads]
            )
