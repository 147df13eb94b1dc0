"""One topic's messages out of many chunks and files, in time order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from . import chunk as chunks
from . import plan, records
from .chunk import Messages
from .file import File
from .plan import Located
from .records import Channel

TOLERANCE_NS = 4096
"""How far a row's double and its log time may be apart, in ns (doubles at the end of MCAP's time are 3815 ns apart)."""


@dataclass(frozen=True, slots=True)
class Origin:
    """Where a message came from."""

    file: File
    channel: Channel
    chunk_offset: int


@dataclass(frozen=True, slots=True)
class Batch:
    """Messages in the order of their log times; those of one time in the order of writing."""

    times_ns: npt.NDArray[np.uint64]
    published_ns: npt.NDArray[np.uint64]
    sequences: npt.NDArray[np.uint32]
    payloads: list[bytes]
    origins: list[Origin]
    origin_of: npt.NDArray[np.intp]
    """For each message, which of `origins`."""


@dataclass(frozen=True, slots=True)
class _Part:
    messages: Messages
    rank: int
    origin: Origin


def read(files: Sequence[File], topic: str, start_ns: int, end_ns: int) -> Iterator[Batch]:
    """Read a topic's messages with log times in [start_ns, end_ns].

    Messages of one log time are always in one batch. Memory holds the chunks that overlap in time, not the topic.

    Args:
        files: In the order of writing.
        topic: Its name.
        start_ns: First log time, in ns.
        end_ns: Last log time, included, in ns.
    """
    indexes = [file.index for file in files]
    channels = [index.channels_of(topic) for index in indexes]
    pending: list[_Part] = []
    for span in plan.spans(indexes, channels, start_ns, end_ns):
        file = files[span.file]
        data = memoryview(file.source.read(span.offset, span.length))
        for located in span.chunks:
            ready, pending = _split(pending, located.chunk.start_ns - TOLERANCE_NS)
            if ready:
                yield _merge(ready)
            for channel in channels[span.file].values():
                pending += _cut_out(file, channel, located, data, span.offset, start_ns, end_ns)
    if pending:
        yield _merge(pending)


def _cut_out(
    file: File, channel: Channel, located: Located, data: memoryview, at: int, start_ns: int, end_ns: int
) -> list[_Part]:
    chunk = located.chunk
    if chunk.indexed and channel.id not in chunk.message_index_offsets:
        return []
    record = data[chunk.offset - at : chunk.end - at]
    unpacked = file.unpack(chunk, record)
    index = (
        file.message_index(chunk, channel.id, data, at) if chunk.indexed else _scanned(file, channel, located, unpacked)
    )
    index = chunks.within(index, start_ns, end_ns)
    if not len(index.offsets):
        return []
    messages = chunks.gather(unpacked, index, chunk, file.source.name)
    return [_Part(messages, located.rank, Origin(file, channel, chunk.offset))]


def _scanned(file: File, channel: Channel, located: Located, unpacked: bytes) -> records.MessageIndex:
    found = chunks.scan(unpacked, located.chunk, file.source.name).indexes.get(channel.id)
    return found if found is not None else chunks.no_messages(channel.id)


def _split(parts: list[_Part], watermark_ns: int) -> tuple[list[_Part], list[_Part]]:
    """Divide into what lies before the watermark, and can go out, and what has to wait for later chunks."""
    ready: list[_Part] = []
    waiting: list[_Part] = []
    for part in parts:
        times = part.messages.times_ns
        if int(times.max()) < watermark_ns:
            ready.append(part)
        elif watermark_ns <= 0 or int(times.min()) >= watermark_ns:
            waiting.append(part)
        else:
            early = times < np.uint64(watermark_ns)
            ready.append(_Part(_pick(part.messages, np.flatnonzero(early)), part.rank, part.origin))
            waiting.append(_Part(_pick(part.messages, np.flatnonzero(~early)), part.rank, part.origin))
    return ready, waiting


def _pick(messages: Messages, which: npt.NDArray[np.intp]) -> Messages:
    payloads = messages.payloads
    return Messages(
        channel_id=messages.channel_id,
        times_ns=messages.times_ns[which],
        published_ns=messages.published_ns[which],
        sequences=messages.sequences[which],
        offsets=messages.offsets[which],
        payloads=[payloads[i] for i in which.tolist()],
    )


def _merge(parts: list[_Part]) -> Batch:
    times = np.concatenate([part.messages.times_ns for part in parts])
    written = np.concatenate([(part.rank << 32) + part.messages.offsets for part in parts])
    origin_of = np.repeat(np.arange(len(parts)), [len(part.messages.payloads) for part in parts])
    published = np.concatenate([part.messages.published_ns for part in parts])
    sequences = np.concatenate([part.messages.sequences for part in parts])
    payloads = [payload for part in parts for payload in part.messages.payloads]
    origins = [part.origin for part in parts]
    if _is_in_order(times, written):
        return Batch(times, published, sequences, payloads, origins, origin_of)
    order = np.lexsort((written, times))
    return Batch(
        times[order],
        published[order],
        sequences[order],
        [payloads[i] for i in order.tolist()],
        origins,
        origin_of[order],
    )


def _is_in_order(times: npt.NDArray[np.uint64], written: npt.NDArray[np.int64]) -> bool:
    earlier, later = times[:-1], times[1:]
    return bool(np.all((earlier < later) | ((earlier == later) & (written[:-1] < written[1:]))))
