"""Counts a topic's rows and finds their first and last time stamps, reading as little as that takes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt

from .. import clock
from ..codecs.encoded_channel import Decoder, Row
from ..errors import DamagedFileError, EncodingError
from ..mcap import audit
from ..mcap.file_index import replanned
from ..mcap.message_records import MESSAGE_HEAD_BYTES
from ..rows.plain_row import TIME_KEY
from . import topic_messages, topic_rows
from .plan import ChunkPlan, Located
from .stored_topic import LAST_NS, StoredTopic
from .time_order import TOLERANCE_NS
from .topic_messages import MessageOrigin

_DISTINCT_FROM_NS = 2**23 * clock.NS_PER_S
"""From here on (97 days) doubles are more than a nanosecond apart: rows that share a nanosecond share the double."""


@replanned
def count(topic: StoredTopic) -> int:
    """Return how many rows a topic has after merging, reading no more than that takes.

    The statistics know, unless two chunks that touch in time may hold rows of one time stamp; then their message
    indexes know; and only times of the first 97 days, where two doubles can share a nanosecond, need the payloads.
    """
    for file in topic.files:
        audit.settle(file)
    total = sum(file.index.message_counts.get(channel.id, 0) for file, channel in topic.channels)
    if not topic.is_track:
        return total
    return max(total - _duplicates(topic), 0)  # a file can announce too few


def _duplicates(topic: StoredTopic) -> int:
    """Count the messages that are merged into the row of another one."""
    doubtful = _doubtful(topic)
    if not len(doubtful):
        return 0
    shared, counts = np.unique(np.concatenate([topic.times_in(located) for located in doubtful]), return_counts=True)
    surely = (counts > 1) & (shared >= np.uint64(_DISTINCT_FROM_NS))
    duplicates = int((counts[surely] - 1).sum())
    perhaps = shared[(counts > 1) & ~surely]
    return duplicates + (_duplicates_among(topic, doubtful, perhaps) if len(perhaps) else 0)


def _doubtful(topic: StoredTopic) -> ChunkPlan:
    """Return the chunks that may share a time stamp with another one, or hold one twice."""
    chunks = topic.chunks()
    if not all(file.index.is_ours for file in topic.files):
        ours = np.array([file.index.is_ours for file in topic.files])
        doubtful = ~ours[chunks.files]
    else:
        doubtful = np.zeros(len(chunks), np.bool_)
    # By start time, a chunk touches an earlier one if it starts before the latest end so far. Both are doubtful.
    ends = np.maximum.accumulate(chunks.end_ns)
    touches = np.flatnonzero(chunks.start_ns[1:] <= ends[:-1]) + 1
    doubtful[touches] = True
    doubtful[_latest(chunks.end_ns)[touches - 1]] = True
    return chunks.pick(np.flatnonzero(doubtful))


def _latest(end_ns: npt.NDArray[np.uint64]) -> npt.NDArray[np.intp]:
    """Return for each chunk which one ends last among it and those before it; the first one of several, [N]."""
    before = np.concatenate((end_ns[:1], np.maximum.accumulate(end_ns)[:-1]))
    return np.maximum.accumulate(np.where(end_ns > before, np.arange(len(end_ns)), 0))


def _duplicates_among(topic: StoredTopic, located: Sequence[Located], times_ns: npt.NDArray[np.uint64]) -> int:
    """Count by the doubles in the payloads how many messages of these times are not rows of their own."""
    seen: set[float] = set()
    messages = 0
    decoders: dict[tuple[str, int], Decoder] = {}
    for located_chunk in located:
        file, chunk = topic.files[located_chunk.file], located_chunk.chunk
        channels = file.index.channels_of(topic.name)
        for cut_out in file.cut(chunk, channels, 0, LAST_NS):
            picked = cut_out.pick(np.flatnonzero(np.isin(cut_out.times_ns, times_ns)))
            origin = MessageOrigin(file, channels[cut_out.channel_id], chunk)
            decoded = topic_rows.decode(origin, picked.payloads, picked.times_ns, decoders)
            times_s = [row[TIME_KEY] for row in decoded if row is not None]
            seen.update(times_s)
            messages += len(times_s)
    return messages - len(seen)


@replanned
def payload_bytes(topic: StoredTopic) -> int:
    """Return how many bytes a topic's messages take, uncompressed, by where all messages of its chunks start."""
    total = 0
    for located in topic.chunks():
        file, chunk = topic.files[located.file], located.chunk
        offsets_by_channel = {id_: entry.offsets for id_, entry in file.message_indexes(chunk).items()}
        if not offsets_by_channel:
            continue
        starts = np.sort(np.concatenate(list(offsets_by_channel.values())))
        ends = np.append(starts[1:], np.uint64(chunk.uncompressed_size))
        for id_ in file.index.channels_of(topic.name):
            if id_ in offsets_by_channel:
                places = np.searchsorted(starts, offsets_by_channel[id_])
                total += int((ends[places] - starts[places]).sum()) - len(places) * MESSAGE_HEAD_BYTES
    return max(total, 0)  # the indexes may be wrong


def first(topic: StoredTopic) -> tuple[float | None, Row | None]:
    """Return the time stamp of a topic's first row, in s, and the row; None without one, or if it cannot be decoded."""
    for file in topic.files:
        audit.survey_few(file)
    time_ns = topic.first_ns()
    if time_ns is None:
        return None, None
    rows = _rows_at(topic, time_ns)
    row = min(rows, key=lambda row: row[TIME_KEY], default=None)
    return clock.to_seconds(time_ns) if row is None else row[TIME_KEY], row


def last_time(topic: StoredTopic) -> float | None:
    """Return the time stamp of a topic's last row, in s; None without one."""
    time_ns = topic.last_ns()
    if time_ns is None:
        return None
    if time_ns >= _DISTINCT_FROM_NS and topic.is_track and all(file.index.is_ours for file in topic.files):
        return clock.to_seconds(time_ns)  # the recorder rounded one double to it, and no other one is as near
    return max((row[TIME_KEY] for row in _rows_at(topic, time_ns)), default=clock.to_seconds(time_ns))


def _rows_at(topic: StoredTopic, time_ns: int) -> list[Row]:
    """Return the rows whose doubles lie at a log time; none if they cannot be decoded."""
    low, high = clock.to_seconds(time_ns - TOLERANCE_NS), clock.to_seconds(time_ns + TOLERANCE_NS)
    start_ns, end_ns = topic_rows.to_ns_range(low, high)
    rows: Iterable[Row | None]
    try:
        only = topic_messages.read_only(topic, start_ns, end_ns)
        if only is not None:
            origin, message_ns, payload = only
            rows = topic_rows.decode(origin, [payload], np.array([message_ns], np.uint64), {})
        else:
            batch = topic_messages.read_few(topic, start_ns, end_ns)
            rows = () if batch is None else topic_rows.of_batch(batch, {})
        return [row for row in rows if row is not None and low <= row[TIME_KEY] <= high]
    except (EncodingError, DamagedFileError):  # reading the rows raises this again
        return []
