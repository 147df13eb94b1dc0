"""Writes one MCAP file of a rosbag2 folder, a block of messages at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt
import zstandard

from ....codecs.ros import distros
from ....codecs.ros_channel import DIGEST_KEYS
from ....mcap import stored_messages
from ....mcap.chunk_writer import Compressor, PackedChunk, build_block, compressor, pack
from ....mcap.file_output import FileOutput
from ....mcap.file_writer import FileWriter
from ....mcap.message import CHUNK_BYTES, Connection, MessageBlock
from ....mcap.message_records import MESSAGE_HEAD_BYTES, index_entries, message_heads
from ....options import RecorderOptions
from ....query.file import File
from ..bag_metadata.qos_profiles import OFFERED
from ..bag_plan import Outlet
from ..carry_out import foreign_metadata
from ..rows_out import Sent


class _MessageZstd:
    """Compresses so that a standard message refers to the equal numbers of our own message before it.

    The result is two thirds smaller than that of level 1, and compression is faster.
    """

    name = "zstd"

    def __init__(self) -> None:
        parameters = zstandard.ZstdCompressionParameters(
            window_log=20, hash_log=16, min_match=5, strategy=zstandard.STRATEGY_FAST
        )
        self._zstd = zstandard.ZstdCompressor(compression_params=parameters)

    def __call__(self, block: memoryview) -> bytes:
        return self._zstd.compress(block)


class McapBagWriter:
    """A file that takes messages until it is finished."""

    room = MESSAGE_HEAD_BYTES
    """Bytes that each message needs before it."""

    def __init__(
        self, path: Path, outlets: Sequence[Outlet], qos: Callable[[Outlet], str], distro: str, compression: str
    ) -> None:
        """Begin a file.

        Args:
            path: Of the file.
            outlets: All topics.
            qos: What a topic was offered with, as YAML.
            distro: Of ROS 2.
            compression: Of chunks: "zstd", "lz4" or "none".
        """
        self._compression = compression
        self._compress = self._compressor()
        self._distro = distro
        self._file = FileWriter(FileOutput.create(path))
        self._file.begin(profile="ros2")
        for outlet in outlets:
            self._file.add_connection(outlet.number, _connection(outlet, qos(outlet)))

    @property
    def size(self) -> int:
        """Bytes so far."""
        return self._file.size

    @property
    def counts(self) -> dict[int, int]:
        """Messages so far, by the number of their outlet."""
        return {number: count for number, count in self._file.contents.counts.items() if count}

    @property
    def start_ns(self) -> int:
        """Time of the first message, ns; 0 without messages."""
        return min((chunk.start_ns for chunk in self._file.contents.chunks), default=0)

    @property
    def end_ns(self) -> int:
        """Time of the last message, ns; 0 without messages."""
        return max((chunk.end_ns for chunk in self._file.contents.chunks), default=0)

    def write(self, sent: Sequence[Sent]) -> None:
        """Write messages, as one chunk or a few."""
        total = sum(len(messages.packed.data) for messages in sent)
        # `-(-a // b)` is the division of integers that rounds up.
        pieces = max(1, min(-(-total // CHUNK_BYTES), max((len(messages.times_ns) for messages in sent), default=1)))
        for part in _slices(sent, pieces):
            self._chunk(part)

    def pack(self, block: MessageBlock) -> PackedChunk:
        """Return messages that are carried as a chunk; threads may do this while others are written."""
        return build_block(block, self._compressor())

    def write_packed(self, chunk: PackedChunk) -> None:
        """Write a chunk that `pack` made."""
        self._file.add_chunk(chunk)

    def add_beside(self, files: Sequence[File]) -> None:
        """Copy what other people put into files beside messages: attachments and metadata records."""
        for file in files:
            for record, entry in stored_messages.attachments(file):
                self._file.add_attachment(record, entry)
            for metadata in foreign_metadata(file):
                self._file.add_metadata(metadata.name, metadata.values)

    def finish(self, information: str) -> None:
        """Write the file's end.

        Args:
            information: The metadata of the file, as YAML.
        """
        values = {distros.DISTRO_KEY: self._distro, distros.TEXT_KEY: information}
        self._file.add_metadata(distros.RECORD, values)
        self._file.write_end()
        self.close()

    def close(self) -> None:
        """Close the file, finished or not. May be called twice."""
        self._file.output.close()

    def _compressor(self) -> Compressor:
        if self._compression == "zstd":
            return _MessageZstd()
        return compressor(RecorderOptions(compression=self._compression))  # type: ignore[arg-type]  # checked

    def _chunk(self, sent: Sequence[Sent]) -> None:
        block = np.concatenate([messages.packed.data for messages in sent])
        start_ns = min(int(messages.times_ns[0]) for messages in sent)
        end_ns = max(int(messages.times_ns[-1]) for messages in sent)
        entries: dict[int, npt.NDArray[np.void]] = {}
        at = 0
        for messages in sent:
            number = messages.outlet.number
            _put_heads(block[at : at + len(messages.packed.data)], messages, self._file.contents.counts[number])
            entries[number] = index_entries(messages.times_ns, messages.packed.starts + at)
            at += len(messages.packed.data)
        view = memoryview(block)  # type: ignore[arg-type]  # numpy's stubs know no buffers before 3.12
        self._file.add_chunk(pack(view, start_ns, end_ns, entries, self._compress))


def _connection(outlet: Outlet, qos: str) -> Connection:
    """Return what a topic of the bag is: one that is carried keeps what is known of it."""
    carried = outlet.carried
    if carried is None:
        metadata = {OFFERED: qos, DIGEST_KEYS[False]: outlet.digest}
        return Connection(outlet.topic, outlet.type, "ros2msg", outlet.text.encode(), "cdr", tuple(metadata.items()))
    return replace(carried, metadata=tuple({**dict(carried.metadata), OFFERED: qos}.items()))


def _put_heads(block: npt.NDArray[np.uint8], sent: Sent, before: int) -> None:
    """Write the heads of Message records into the room before each message."""
    packed = sent.packed
    heads = message_heads(packed.sizes, sent.outlet.number, sent.times_ns)
    # MCAP's sequence number has 32 bits, so it starts again at 0.
    heads["sequence"] = (np.arange(before, before + len(heads)) & 0xFFFFFFFF).astype(np.uint32)
    data = heads.view(np.uint8).reshape(len(heads), MESSAGE_HEAD_BYTES)
    size = MESSAGE_HEAD_BYTES + int(packed.sizes[0])
    # Messages of one size form a matrix whose first columns are set at once, without an index of every byte.
    if len(block) == size * len(heads) and bool((packed.sizes == packed.sizes[0]).all()):
        block.reshape(len(heads), size)[:, :MESSAGE_HEAD_BYTES] = data
    else:
        block[packed.starts[:, None] + np.arange(MESSAGE_HEAD_BYTES)] = data


def _slices(sent: Sequence[Sent], pieces: int) -> list[list[Sent]]:
    """Cut messages into pieces by time."""
    if pieces == 1:
        return [list(sent)] if sent else []
    longest = max(sent, key=lambda messages: len(messages.times_ns))
    rows = np.linspace(0, len(longest.times_ns), pieces + 1).astype(np.int64)[1:-1]
    edges = longest.times_ns[rows]
    slices: list[list[Sent]] = [[] for _ in range(pieces)]
    for messages in sent:
        cuts = [0, *np.searchsorted(messages.times_ns, edges, "left").tolist(), len(messages.times_ns)]
        for piece, (start, end) in zip(slices, pairwise(cuts), strict=True):
            if end > start:
                piece.append(Sent(messages.outlet, messages.times_ns[start:end], messages.packed.slice(start, end)))
    return [piece for piece in slices if piece]
