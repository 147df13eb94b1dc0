"""Reads one topic's messages out of many chunks and files, in time order."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from ..codecs import payloads as payload_arrays
from ..mcap import audit
from ..mcap.chunk_messages import Messages
from ..mcap.file_index import ReindexedError, replanned
from ..mcap.records import Channel, Chunk
from ..store import read_ahead
from . import plan, time_order
from .file import File
from .plan import Located
from .stored_topic import LAST_NS, StoredTopic


@dataclass(frozen=True, slots=True)
class MessageOrigin:
    """Where a message came from."""

    file: File
    channel: Channel
    chunk: Chunk


@dataclass(frozen=True, slots=True)
class Cut:
    """Messages of one channel, as they were cut out of one chunk."""

    messages: Messages
    rank: int
    """Of their chunk in the order of writing."""
    origin: MessageOrigin

    @property
    def times_ns(self) -> npt.NDArray[np.uint64]:
        """Their log times."""
        return self.messages.times_ns

    @property
    def written(self) -> npt.NDArray[np.int64]:
        """Numbers that grow in the order of writing, over all chunks and files."""
        # Chunk and place in it in one number, by which numpy sorts.
        return (self.rank << 32) + self.messages.offsets

    def pick(self, which: npt.NDArray[np.intp]) -> Cut:
        """Return some of them."""
        return Cut(self.messages.pick(which), self.rank, self.origin)


@dataclass(frozen=True, slots=True)
class MessageBatch:
    """Messages in the order of their log times; those of one time in the order of writing."""

    times_ns: npt.NDArray[np.uint64]
    published_ns: npt.NDArray[np.uint64]
    sequences: npt.NDArray[np.uint32]
    payloads: Sequence[bytes]
    origins: list[MessageOrigin]
    origin_of: npt.NDArray[np.intp]
    """For each message, which of `origins`."""


Work = TypeVar("Work")


@dataclass(frozen=True, slots=True)
class _Job:
    """A chunk whose bytes have been read."""

    file: File
    channels: Sequence[Channel]
    located: Located
    record: memoryview
    """From the chunk's start to the end of its message indexes."""


def read(topic: StoredTopic, start_ns: int, end_ns: int) -> Iterator[MessageBatch]:
    """Read a topic's messages with log times in [start_ns, end_ns].

    Messages of one log time are always in one batch. Memory holds the chunks that overlap in time and a few that are
    unpacked ahead, not the topic.

    Args:
        topic: Which one.
        start_ns: First log time, in ns.
        end_ns: Last log time, included, in ns.
    """
    for cuts in time_order.in_time(cut(topic, start_ns, end_ns, lambda messages: messages)):
        yield merge(cuts)


@replanned
def read_only(topic: StoredTopic, start_ns: int, end_ns: int) -> tuple[MessageOrigin, int, bytes] | None:
    """Return the only message of a time range: where it comes from, its log time and its payload.

    None unless one chunk alone, with one channel of the topic, may hold messages of that range, and holds exactly one.
    """
    chunks = topic.chunks()
    if len(chunks) != 1:
        chunks = topic.chunks(start_ns, end_ns)
    channels = topic.files[chunks[0].file].index.channels_of(topic.name) if len(chunks) == 1 else {}
    if len(channels) != 1:
        return None
    file, chunk = topic.files[chunks[0].file], chunks[0].chunk
    ((channel_id, channel),) = channels.items()
    only = file.only_message(chunk, channel_id, start_ns, end_ns)
    return None if only is None else (MessageOrigin(file, channel, chunk), *only)


@replanned
def read_few(topic: StoredTopic, start_ns: int, end_ns: int) -> MessageBatch | None:
    """Return all messages of a time range of a few messages at once; None if there are none.

    Nothing is read ahead, and a chunk that is still unpacked is not read again.
    """
    cuts: list[Cut] = []
    for located in topic.chunks(start_ns, end_ns):
        file = topic.files[located.file]
        channels = file.index.channels_of(topic.name)
        messages_by_channel = file.cut(located.chunk, channels, start_ns, end_ns)
        cuts += [
            Cut(messages, located.rank, MessageOrigin(file, channels[messages.channel_id], located.chunk))
            for messages in messages_by_channel
        ]
    return merge(cuts) if cuts else None


def cut(
    topic: StoredTopic, start_ns: int, end_ns: int, work: Callable[[Cut], Work]
) -> Iterator[tuple[int, list[Work]]]:
    """Cut a topic's messages out of each chunk that holds some, by the chunks' start times.

    Args:
        topic: Which one.
        start_ns: First log time, in ns.
        end_ns: Last log time, included, in ns.
        work: Called with the messages of each channel and chunk, on several threads.

    Yields:
        The chunk's first log time, and the results of `work`.
    """
    if start_ns <= 0 and end_ns >= LAST_NS:
        for file in topic.files:
            audit.survey(file)
    done: set[tuple[int, int]] = set()
    while True:
        try:
            for key, made in _cut(topic, start_ns, end_ns, work, done):
                done.add(key)
                yield made
        except ReindexedError:
            continue
        return


def _cut(
    topic: StoredTopic,
    start_ns: int,
    end_ns: int,
    work: Callable[[Cut], Work],
    done: Collection[tuple[int, int]],
) -> Iterator[tuple[tuple[int, int], tuple[int, list[Work]]]]:
    """Cut a topic's messages as `cut` does, by the indexes as they are now.

    The other arguments are those of `cut`.

    Args:
        done: The chunks to leave out, each as its file's number and where it lies in it.

    Yields:
        A key of the chunk, and the pair that `cut` yields for it.
    """
    files = topic.files
    channels = [list(file.index.channels_of(topic.name).values()) for file in files]
    spans = plan.coalesce(topic.chunks(start_ns, end_ns))

    def jobs() -> Iterator[_Job]:
        for number, ranges in plan.ranges_by_file(spans).items():
            files[number].source.expect(ranges)
        for span in spans:
            file = files[span.file]
            data = memoryview(file.read_span(span.offset, span.length))
            for located in span.chunks:
                start = located.chunk.offset - span.offset
                record = data[start : located.end - span.offset]
                if (span.file, located.chunk.offset) not in done:
                    yield _Job(file, channels[span.file], located, record)

    def do(job: _Job) -> tuple[tuple[int, int], tuple[int, list[Work]]]:
        chunk = job.located.chunk
        key = (job.located.file, chunk.offset)
        return key, (chunk.start_ns, [work(messages) for messages in _cut_out(job, start_ns, end_ns)])

    return read_ahead.in_order(do, jobs(), weigh=lambda job: job.located.chunk.uncompressed_size)


def _cut_out(job: _Job, start_ns: int, end_ns: int) -> Iterator[Cut]:
    file, chunk = job.file, job.located.chunk
    channels = {
        channel.id: channel
        for channel in job.channels
        if not chunk.indexed or channel.id in chunk.message_index_offsets
    }
    for messages in file.cut(chunk, channels, start_ns, end_ns, job.record) if channels else ():
        yield Cut(messages, job.located.rank, MessageOrigin(file, channels[messages.channel_id], chunk))


def merge(cuts: Sequence[Cut]) -> MessageBatch:
    """Bring the messages of several chunks into time order."""
    if len(cuts) == 1 and time_order.is_in_order(cuts[0].times_ns, cuts[0].messages.offsets):
        messages, origin = cuts[0].messages, cuts[0].origin
        origin_of = np.zeros(len(messages), np.intp)
        view = payload_arrays.view_of(messages)
        stored = messages.payloads if view is None else view
        return MessageBatch(messages.times_ns, messages.published_ns, messages.sequences, stored, [origin], origin_of)
    times = np.concatenate([cut.times_ns for cut in cuts])
    written = np.concatenate([cut.written for cut in cuts])
    origin_of = np.repeat(np.arange(len(cuts)), [len(cut.messages) for cut in cuts])
    published = np.concatenate([cut.messages.published_ns for cut in cuts])
    sequences = np.concatenate([cut.messages.sequences for cut in cuts])
    payloads = [payload for cut in cuts for payload in cut.messages.payloads]
    origins = [cut.origin for cut in cuts]
    if time_order.is_in_order(times, written):
        return MessageBatch(times, published, sequences, payloads, origins, origin_of)
    order = np.lexsort((written, times))
    return MessageBatch(
        times[order],
        published[order],
        sequences[order],
        [payloads[i] for i in order.tolist()],
        origins,
        origin_of[order],
    )
