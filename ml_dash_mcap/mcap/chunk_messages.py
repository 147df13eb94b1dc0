"""Finds the messages in a chunk's unpacked records, by its message indexes or by a scan of the records."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..errors import DamagedFileError
from . import records
from .message_records import MESSAGE_FIXED_BYTES, MESSAGE_HEAD, MESSAGE_HEAD_BYTES, MessageIndex
from .record_layout import PREFIX_BYTES, Bytes, record_at
from .records import Chunk, Opcode

# Opcode, length, channel id and log time of a Message; the sequence number is passed over.
_MESSAGE_START = struct.Struct("<BQH4xQ")


@dataclass(frozen=True, slots=True)
class Messages:
    """Messages of one channel out of one chunk, not copied out of it."""

    channel_id: int
    times_ns: npt.NDArray[np.uint64]
    published_ns: npt.NDArray[np.uint64]
    sequences: npt.NDArray[np.uint32]
    offsets: npt.NDArray[np.int64]
    """Places in the chunk's records, in bytes: their order is the order of writing."""
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
class ChunkScan:
    """The contents of a chunk by its own records, without its message indexes."""

    schemas: Mapping[int, records.Schema]
    channels: Mapping[int, records.Channel]
    indexes: Mapping[int, MessageIndex]

    @property
    def counts(self) -> dict[int, int]:
        """Channel to how many messages."""
        return {channel_id: len(index.offsets) for channel_id, index in self.indexes.items()}


def scan(data: bytes, chunk: Chunk, path: str) -> ChunkScan:
    """Scan a chunk's own records: it may have no message index, or the only records of some channels."""
    return _scan(data, chunk, path, [(0, len(data))])


def _scan(data: bytes, chunk: Chunk, path: str, stretches: Iterable[tuple[int, int]]) -> ChunkScan:
    """Scan the records in some parts of a chunk; each part is a start and an end."""
    schemas: dict[int, records.Schema] = {}
    channels: dict[int, records.Channel] = {}
    entries: dict[int, array[int]] = {}
    try:
        for start, end in stretches:
            _scan_stretch(memoryview(data)[:end], start, path, schemas, channels, entries)
    except DamagedFileError as error:
        raise DamagedFileError(path, chunk.offset, f"a chunk with damaged records ({error})") from error
    return ChunkScan(
        schemas, channels, {channel_id: _message_index(channel_id, pairs) for channel_id, pairs in entries.items()}
    )


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
class ChunkContents:
    """The contents of a chunk, by its own records."""

    messages: Mapping[int, Messages]
    """By channel."""
    schemas: Mapping[int, records.Schema]
    channels: Mapping[int, records.Channel]
    is_indexed: bool
    """Whether the message indexes that were given say the same."""

    @property
    def counts(self) -> dict[int, int]:
        """Channel to how many messages, where there are some."""
        return {channel_id: len(messages) for channel_id, messages in self.messages.items() if len(messages)}

    @property
    def span(self) -> tuple[int, int] | None:
        """The first and the last log time, in ns; None without messages."""
        times = [messages.times_ns for messages in self.messages.values() if len(messages)]
        return (min(int(part.min()) for part in times), max(int(part.max()) for part in times)) if times else None

    def corrected(self, chunk: Chunk) -> Chunk:
        """Return the chunk's entry corrected by its records, without message indexes if the stored ones are wrong."""
        start_ns, end_ns = self.span or (chunk.start_ns, chunk.end_ns)
        is_indexed = chunk.indexed and self.is_indexed
        return replace(chunk, start_ns=start_ns, end_ns=end_ns, counts=self.counts, indexed=is_indexed)

    def differences(self, chunk: Chunk) -> Iterator[tuple[str, str]]:
        """Yield the faults of the chunk's index entry: a key that no other fault has, and the fault in words."""
        span = self.span
        if span is not None and span != (chunk.start_ns, chunk.end_ns):
            yield (
                "times",
                f"the chunk is said to have log times from {chunk.start_ns} to {chunk.end_ns} ns,"
                f" but they go from {span[0]} to {span[1]} ns",
            )
        missing = sorted(self.counts.keys() - chunk.message_index_offsets.keys())
        if chunk.message_index_offsets and missing:
            yield "message index", f"the chunk has no message index of channels {missing}, of which it has messages"
        elif chunk.message_index_offsets and not (chunk.indexed and self.is_indexed):
            what = "the message indexes behind the chunk do not say where all its messages lie, and when"
            yield "message index", what


def contents(data: bytes, indexes: Sequence[MessageIndex] | None, chunk: Chunk, path: str) -> ChunkContents:
    """Return all that a chunk holds: fast where its message indexes are right, and without them otherwise.

    Args:
        data: Its records.
        indexes: The message indexes stored behind it, for all its channels; None if they cannot be read.
        chunk: Which one.
        path: The file, for error messages.

    Raises:
        DamagedFileError: Its records contradict themselves.
    """
    if indexes is not None:
        try:
            messages = {index.channel_id: gather(data, index, chunk, path) for index in indexes}
            scanned = _scan(data, chunk, path, _gaps(data, list(messages.values())))
            if not scanned.indexes:
                return ChunkContents(messages, scanned.schemas, scanned.channels, is_indexed=True)
        except ValueError:  # a DamagedFileError too: the records themselves will tell
            pass
    scanned = scan(data, chunk, path)
    messages = {index.channel_id: gather(data, index, chunk, path) for index in scanned.indexes.values()}
    return ChunkContents(messages, scanned.schemas, scanned.channels, is_indexed=False)


def _gaps(data: bytes, messages: Sequence[Messages]) -> Iterator[tuple[int, int]]:
    """Yield the start and the end of each part of a chunk that holds no message that an index points to."""
    starts = np.concatenate([np.empty(0, np.int64), *(part.offsets for part in messages)])
    ends = np.concatenate([np.empty(0, np.int64), *(part.ends for part in messages)])
    order = np.argsort(starts)
    # The chunk's start and end count as messages, so that gap i lies between ends[i] and starts[i].
    starts, ends = np.append(starts[order], len(data)), np.insert(ends[order], 0, 0)
    if (starts < ends).any():
        raise ValueError("messages that lie in each other")
    for at in np.flatnonzero(starts != ends).tolist():
        yield int(ends[at]), int(starts[at])


def _take_messages(data: Bytes, at: int, entries: dict[int, array[int]]) -> int:
    """Add the times and offsets of consecutive messages to `entries`; returns where the last of them ends."""
    # One unpack a message and no call else: a chunk may hold tens of thousands.
    unpack, last = _MESSAGE_START.unpack_from, len(data) - MESSAGE_HEAD_BYTES
    while at <= last:
        opcode, length, channel_id, time_ns = unpack(data, at)
        end = at + PREFIX_BYTES + length
        if opcode != Opcode.MESSAGE or length < MESSAGE_FIXED_BYTES or end > len(data):
            break
        pairs = entries.get(channel_id)
        if pairs is None:
            pairs = entries[channel_id] = array("Q")
        pairs.append(time_ns)
        pairs.append(at)
        at = end
    return at


def _message_index(channel_id: int, entries: array[int]) -> MessageIndex:
    pairs = np.frombuffer(entries, np.uint64).reshape(-1, 2)
    # Columns of the pairs would keep all of them in memory, and be slower to index.
    return MessageIndex(channel_id, pairs[:, 0].copy(), pairs[:, 1].copy())


def no_messages(channel_id: int) -> MessageIndex:
    """Return the message index of a channel that a chunk does not hold."""
    return MessageIndex(channel_id, np.empty(0, np.uint64), np.empty(0, np.uint64))


def are_within(index: MessageIndex, chunk: Chunk) -> bool:
    """Whether the messages of an index lie in the time range that is stated for their chunk."""
    times = index.times_ns
    return not len(times) or (chunk.start_ns <= int(times.min()) and int(times.max()) <= chunk.end_ns)


def within(index: MessageIndex, start_ns: int, end_ns: int) -> MessageIndex:
    """Return the part of a message index whose times lie in [start_ns, end_ns]."""
    # As uint64, because numpy 1 compares uint64 with any other integer as doubles, which rounds times.
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
    # A length beyond the chunk may have overflowed in `ends`, so it is checked by itself.
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


def only_message(data: bytes, index: MessageIndex, start_ns: int, end_ns: int) -> tuple[int, bytes] | None:
    """Return the log time and the payload of the only message of a channel in [start_ns, end_ns].

    None if there is not exactly one, or if its record is not what the index says; `gather` tells what is wrong then.
    """
    # Plain Python: for a single message, the arrays of `gather` and of a batch take four times as long.
    wanted = np.flatnonzero((index.times_ns >= np.uint64(start_ns)) & (index.times_ns <= np.uint64(end_ns)))
    if len(wanted) != 1:
        return None
    time_ns, offset = int(index.times_ns[wanted[0]]), int(index.offsets[wanted[0]])
    if offset + MESSAGE_HEAD_BYTES > len(data):
        return None
    opcode, length, channel_id, log_time_ns = _MESSAGE_START.unpack_from(data, offset)
    end = offset + PREFIX_BYTES + length
    if (opcode, channel_id, log_time_ns) != (Opcode.MESSAGE, index.channel_id, time_ns):
        return None
    if length < MESSAGE_FIXED_BYTES or end > len(data):
        return None
    return time_ns, data[offset + MESSAGE_HEAD_BYTES : end]


def gather_each(
    data: bytes, indexes: Iterable[MessageIndex], chunk: Chunk, path: str, start_ns: int, end_ns: int
) -> list[Messages]:
    """Cut out the messages of some channels that lie in [start_ns, end_ns]; channels without any get nothing.

    Raises:
        DamagedFileError: An index contradicts the chunk, or messages share bytes.
    """
    gathered: list[Messages] = []
    room = len(data)
    for index in indexes:
        wanted = within(index, start_ns, end_ns)
        if not len(wanted.offsets):
            continue
        messages = gather(data, wanted, chunk, path)
        room -= int((messages.ends - messages.offsets).sum())
        if room < 0:
            raise DamagedFileError(path, chunk.offset, "a chunk whose messages lie in each other")
        gathered.append(messages)
    return gathered


def _heads(
    data: bytes, index: MessageIndex, chunk: Chunk, path: str
) -> tuple[npt.NDArray[np.void], npt.NDArray[np.int64]]:
    room = len(data) - MESSAGE_HEAD_BYTES
    if len(index.offsets) and int(index.offsets.max()) > room:
        raise DamagedFileError(path, chunk.offset, "a message index that points behind its chunk")
    starts = index.offsets.astype(np.int64)
    # Messages begin at any byte. A view with a stride of 1 copies nothing; indexing it copies the wanted heads.
    at_each_byte = np.ndarray((max(room + 1, 0),), MESSAGE_HEAD, data, strides=(1,))
    return at_each_byte[starts], starts


def _lie_apart(starts: npt.NDArray[np.int64], ends: npt.NDArray[np.int64]) -> bool:
    """Whether no two messages share bytes: a small chunk could give any number of long ones otherwise."""
    if bool((starts[1:] >= ends[:-1]).all()):
        return True
    order = np.argsort(starts)
    return bool((starts[order][1:] >= ends[order][:-1]).all())
