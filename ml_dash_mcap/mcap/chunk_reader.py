"""From a chunk's bytes to its messages."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np
import numpy.typing as npt

from ..errors import DamagedFileError
from . import records
from .limits import Limits, of_file
from .message_records import MESSAGE_FIXED_BYTES, MESSAGE_HEAD, MESSAGE_HEAD_BYTES, MessageIndex
from .record_layout import PREFIX_BYTES, Bytes, Fields, read_prefix, record_at
from .records import Chunk, ChunkHead, Opcode

_MESSAGE_START = struct.Struct("<BQH4xQ")


class LimitError(DamagedFileError):
    """A chunk would take more memory than the limits allow; the message says which to raise, and to what."""


class NoChunkError(DamagedFileError):
    """Where an index says that a chunk starts, none does."""


@dataclass(frozen=True, slots=True)
class Messages:
    """Messages of one channel out of one chunk, not copied out of it."""

    channel_id: int
    times_ns: npt.NDArray[np.uint64]
    published_ns: npt.NDArray[np.uint64]
    sequences: npt.NDArray[np.uint32]
    offsets: npt.NDArray[np.int64]
    """In the chunk's records: their order is the order of writing."""
    ends: npt.NDArray[np.int64]
    """Where each record ends, in the chunk's records."""
    data: bytes
    """The chunk's records."""

    def __len__(self) -> int:
        """How many there are."""
        return len(self.offsets)

    @property
    def payloads(self) -> list[bytes]:
        """The payload of each, copied out."""
        data = self.data
        starts = (self.offsets + MESSAGE_HEAD_BYTES).tolist()
        return [data[start:end] for start, end in zip(starts, self.ends.tolist(), strict=True)]

    def pick(self, which: npt.NDArray[np.intp]) -> Messages:
        """Return some of them."""
        return Messages(
            self.channel_id,
            self.times_ns[which],
            self.published_ns[which],
            self.sequences[which],
            self.offsets[which],
            self.ends[which],
            self.data,
        )


@dataclass(frozen=True, slots=True)
class Scan:
    """What walking a chunk's own records brings to light."""

    schemas: Mapping[int, records.Schema]
    channels: Mapping[int, records.Channel]
    indexes: Mapping[int, MessageIndex]

    @property
    def counts(self) -> dict[int, int]:
        """Channel to how many messages."""
        return {channel_id: len(index.offsets) for channel_id, index in self.indexes.items()}


def check_size(chunk: Chunk, path: str, limits: Limits) -> None:
    """Refuse a chunk that would take too much memory, by what is announced, before anything of it is read.

    Raises:
        DamagedFileError: It is beyond the limits.
    """
    size, packed = chunk.uncompressed_size, chunk.compressed_size
    if max(size, chunk.length - limits.record_bytes) > limits.chunk_bytes:
        largest = max(size, chunk.length)
        what = f"a chunk of {largest} bytes; the limit is {limits.chunk_bytes} (Limits.chunk_bytes)"
        raise LimitError(path, chunk.offset, f"{what}; limits=Limits(chunk_bytes={largest}) reads it")
    allowed = of_file(limits, 0).any_ratio_bytes or 0
    if size > allowed and size > limits.ratio * packed:
        what = f"a chunk that unpacks {packed} bytes to {size}; the limit is {limits.ratio} times (Limits.ratio)"
        what = f"{what} beyond {allowed} bytes (Limits.any_ratio_bytes)"
        raise LimitError(path, chunk.offset, f"{what}; limits=Limits(any_ratio_bytes={size}) reads it")


def unpack(
    record: Bytes, chunk: Chunk, path: str, limits: Limits, note: Callable[[str], None] = lambda what: None
) -> bytes:
    """Return a chunk's records, uncompressed and checked.

    Args:
        record: The whole Chunk record (or, for loose messages, just these).
        chunk: What the index says about it.
        path: The file, for error messages.
        limits: Checked before memory is taken.
        note: Called with what the index says wrongly; the chunk itself counts.

    Raises:
        DamagedFileError: The record is no chunk, contradicts itself, is beyond the limits, or its CRC does not match.
    """
    check_size(chunk, path, limits)
    if chunk.compression == records.LOOSE:
        return bytes(record)
    opcode, length = read_prefix(record, 0) if len(record) >= PREFIX_BYTES else (0, 0)
    if opcode != Opcode.CHUNK or length != len(record) - PREFIX_BYTES:
        raise NoChunkError(path, chunk.offset, "the index says that a chunk starts here, but none does")
    fields = Fields(record, path, chunk.offset, PREFIX_BYTES)
    head = records.CHUNK_HEAD.read(fields)
    if head.records_length > len(record) - fields.at:  # a later version may add fields behind them
        raise DamagedFileError(path, chunk.offset, "a chunk whose content is longer than its record")
    said = (chunk.compression, chunk.compressed_size, chunk.uncompressed_size)
    true = (head.compression, head.records_length, head.uncompressed_size)
    if true != said:
        note(f"the chunk's index says (compression, compressed and uncompressed bytes) {said}, the chunk {true}")
        check_size(replace(chunk, compressed_size=true[1], uncompressed_size=true[2]), path, limits)
    packed = memoryview(record)[fields.at : fields.at + head.records_length]
    data = _decompress(packed, head, path, chunk.offset)
    if len(data) != head.uncompressed_size:
        raise DamagedFileError(
            path, chunk.offset, f"a chunk of {len(data)} bytes that announces {head.uncompressed_size} bytes"
        )
    if head.uncompressed_crc and crc32(data) != head.uncompressed_crc:
        raise DamagedFileError(path, chunk.offset, "a chunk whose checksum (CRC-32) does not match its content")
    return data


def _decompress(packed: memoryview, head: ChunkHead, path: str, offset: int) -> bytes:
    if head.compression == "":
        return bytes(packed)
    try:
        if head.compression == "zstd":
            return _unpack_zstd(packed, head.uncompressed_size)
        if head.compression == "lz4":
            return _unpack_lz4(packed, head.uncompressed_size)
    except Exception as error:  # each decompressor has its own error types, some of them plain RuntimeErrors
        raise DamagedFileError(path, offset, f"a chunk that cannot be uncompressed: {error}") from error
    raise DamagedFileError(path, offset, f"a chunk with the unknown compression {head.compression!r}")


def _unpack_zstd(packed: memoryview, size: int) -> bytes:
    import zstandard

    announced = zstandard.frame_content_size(packed)
    if announced not in (-1, size):  # the decompressor believes the frame, whatever max_output_size says
        raise ValueError(f"its frame announces {announced} bytes, the chunk {size}")
    if size == 0:
        return b""
    return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)


def _unpack_lz4(packed: memoryview, size: int) -> bytes:
    import lz4.frame

    decompressor = lz4.frame.LZ4FrameDecompressor()
    data: bytes = decompressor.decompress(packed, max_length=size + 1)
    return data


def scan(data: bytes, chunk: Chunk, path: str) -> Scan:
    """Walk a chunk's own records: for chunks without a message index, and for channels that stand inside."""
    return _scan(data, chunk, path, [(0, len(data))])


def _scan(data: bytes, chunk: Chunk, path: str, stretches: Iterable[tuple[int, int]]) -> Scan:
    """Walk the records that lie in some stretches of a chunk, each from where to where."""
    schemas: dict[int, records.Schema] = {}
    channels: dict[int, records.Channel] = {}
    entries: dict[int, array[int]] = {}
    try:
        for start, end in stretches:
            _scan_stretch(memoryview(data)[:end], start, path, schemas, channels, entries)
    except DamagedFileError as error:
        raise DamagedFileError(path, chunk.offset, f"a chunk with damaged records ({error})") from error
    return Scan(schemas, channels, {one: _message_index(one, found) for one, found in entries.items()})


def _scan_stretch(
    data: Bytes,
    at: int,
    path: str,
    schemas: dict[int, records.Schema],
    channels: dict[int, records.Channel],
    entries: dict[int, array[int]],
) -> None:
    """Take in the records from `at` to the end of `data`."""
    while at < len(data):
        at = _take_messages(data, at, entries)
        if at == len(data):
            break
        opcode, fields = record_at(data, at, path, 0)
        if opcode == Opcode.MESSAGE:
            fields.refuse("a message that is shorter than any")
        elif opcode == Opcode.SCHEMA:
            schema = records.SCHEMA.read(fields)
            schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = records.CHANNEL.read(fields)
            channels[channel.id] = channel
        at = fields.end


@dataclass(frozen=True, slots=True)
class Contents:
    """What a chunk holds, by its own records."""

    messages: Mapping[int, Messages]
    """By channel."""
    schemas: Mapping[int, records.Schema]
    channels: Mapping[int, records.Channel]
    is_indexed: bool
    """Whether the message indexes that were given say the same."""

    @property
    def counts(self) -> dict[int, int]:
        """Channel to how many messages, where there are some."""
        return {channel_id: len(found) for channel_id, found in self.messages.items() if len(found)}

    @property
    def span(self) -> tuple[int, int] | None:
        """The first and the last log time, in ns; None without messages."""
        times = [found.times_ns for found in self.messages.values() if len(found)]
        return (min(int(one.min()) for one in times), max(int(one.max()) for one in times)) if times else None


def contents(data: bytes, indexes: Sequence[MessageIndex] | None, chunk: Chunk, path: str) -> Contents:
    """Return all that a chunk holds: fast where its message indexes are right, and without them otherwise.

    Args:
        data: Its records.
        indexes: Those stored behind it, of all channels in it; None if they cannot be read.
        chunk: Which one.
        path: The file, for error messages.

    Raises:
        DamagedFileError: Its records contradict themselves.
    """
    if indexes is not None:
        try:
            messages = {one.channel_id: gather(data, one, chunk, path) for one in indexes}
            scanned = _scan(data, chunk, path, _gaps(data, list(messages.values())))
            if not scanned.indexes:
                return Contents(messages, scanned.schemas, scanned.channels, is_indexed=True)
        except ValueError:  # a DamagedFileError too: the records themselves will tell
            pass
    scanned = scan(data, chunk, path)
    messages = {one.channel_id: gather(data, one, chunk, path) for one in scanned.indexes.values()}
    return Contents(messages, scanned.schemas, scanned.channels, is_indexed=False)


def _gaps(data: bytes, messages: Sequence[Messages]) -> Iterator[tuple[int, int]]:
    """Yield where a chunk's records are no messages that an index points to: from where on, and up to where."""
    starts = np.concatenate([np.empty(0, np.int64), *(one.offsets for one in messages)])
    ends = np.concatenate([np.empty(0, np.int64), *(one.ends for one in messages)])
    order = np.argsort(starts)
    starts, ends = np.append(starts[order], len(data)), np.insert(ends[order], 0, 0)
    if (starts < ends).any():
        raise ValueError("messages that lie in each other")
    for at in np.flatnonzero(starts != ends).tolist():
        yield int(ends[at]), int(starts[at])


def _take_messages(data: Bytes, at: int, entries: dict[int, array[int]]) -> int:
    """Note the times and places of the messages that lie one behind the other here; returns where they end."""
    unpack, last = _MESSAGE_START.unpack_from, len(data) - MESSAGE_HEAD_BYTES
    while at <= last:
        opcode, length, channel_id, time_ns = unpack(data, at)
        end = at + PREFIX_BYTES + length
        if opcode != Opcode.MESSAGE or length < MESSAGE_FIXED_BYTES or end > len(data):
            break
        found = entries.get(channel_id)
        if found is None:
            found = entries[channel_id] = array("Q")
        found.append(time_ns)
        found.append(at)
        at = end
    return at


def _message_index(channel_id: int, entries: array[int]) -> MessageIndex:
    pairs = np.frombuffer(entries, np.uint64).reshape(-1, 2)
    return MessageIndex(channel_id, pairs[:, 0].copy(), pairs[:, 1].copy())


def no_messages(channel_id: int) -> MessageIndex:
    """Return the message index of a channel that a chunk does not hold."""
    return MessageIndex(channel_id, np.empty(0, np.uint64), np.empty(0, np.uint64))


def are_within(index: MessageIndex, chunk: Chunk) -> bool:
    """Whether messages lie in the time that their chunk says."""
    times = index.times_ns
    return not len(times) or (chunk.start_ns <= int(times.min()) and int(times.max()) <= chunk.end_ns)


def within(index: MessageIndex, start_ns: int, end_ns: int) -> MessageIndex:
    """Return the part of a message index whose times lie in [start_ns, end_ns]."""
    low, high = np.uint64(max(start_ns, 0)), np.uint64(min(max(end_ns, 0), 2**64 - 1))
    keep = (index.times_ns >= low) & (index.times_ns <= high)
    if keep.all():
        return index
    return MessageIndex(index.channel_id, index.times_ns[keep], index.offsets[keep])


def gather(data: bytes, index: MessageIndex, chunk: Chunk, path: str) -> Messages:
    """Cut out the messages that a message index points to.

    Raises:
        DamagedFileError: An entry points to something else than a message of that channel and time, or two to one.
    """
    heads, starts = _heads(data, index, chunk, path)
    ends = starts + PREFIX_BYTES + heads["length"].astype(np.int64)
    sound = (heads["opcode"] == Opcode.MESSAGE) & (heads["channel"] == index.channel_id)
    sound &= (heads["log_time"] == index.times_ns) & (heads["length"] >= MESSAGE_FIXED_BYTES)
    sound &= heads["length"] <= len(data)
    sound &= ends <= len(data)
    if not sound.all() or not _lie_apart(starts, ends):
        raise DamagedFileError(path, chunk.offset, "a message index that contradicts its chunk")
    return Messages(
        channel_id=index.channel_id,
        times_ns=index.times_ns,
        published_ns=heads["publish_time"].astype(np.uint64),
        sequences=heads["sequence"].astype(np.uint32),
        offsets=starts,
        ends=ends,
        data=data,
    )


def _heads(
    data: bytes, index: MessageIndex, chunk: Chunk, path: str
) -> tuple[npt.NDArray[np.void], npt.NDArray[np.int64]]:
    room = len(data) - MESSAGE_HEAD_BYTES
    if len(index.offsets) and int(index.offsets.max()) > room:
        raise DamagedFileError(path, chunk.offset, "a message index that points behind its chunk")
    starts = index.offsets.astype(np.int64)
    at_each_byte = np.ndarray((max(room + 1, 0),), MESSAGE_HEAD, data, strides=(1,))
    return at_each_byte[starts], starts


def _lie_apart(starts: npt.NDArray[np.int64], ends: npt.NDArray[np.int64]) -> bool:
    """Whether no two messages share bytes: a small chunk could give any number of long ones otherwise."""
    if bool((starts[1:] >= ends[:-1]).all()):
        return True
    order = np.argsort(starts)
    return bool((starts[order][1:] >= ends[order][:-1]).all())
