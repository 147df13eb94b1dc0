"""How many rows a topic has and when they start and end, reading as little as that takes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from .. import clock
from ..codecs.decode import Decoder, Row
from ..errors import DamagedFileError, EncodingError
from ..mcap import audit
from ..mcap.file_index import replanned
from ..mcap.message_records import MESSAGE_HEAD_BYTES
from ..rows.encode import TIME_KEY
from . import topic_rows
from .plan import Located
from .stored_topic import LAST_NS, StoredTopic
from .time_order import TOLERANCE_NS
from .topic_messages import Origin

_DISTINCT_FROM_NS = 2**23 * clock.NS_PER_S
"""From here on (97 days) doubles are more than a nanosecond apart: what shares a nanosecond shares the double."""


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
    if not doubtful:
        return 0
    shared, counts = np.unique(np.concatenate([topic.times_in(one) for one in doubtful]), return_counts=True)
    surely = (counts > 1) & (shared >= np.uint64(_DISTINCT_FROM_NS))
    duplicates = int((counts[surely] - 1).sum())
    perhaps = shared[(counts > 1) & ~surely]
    return duplicates + (_duplicates_among(topic, doubtful, perhaps) if len(perhaps) else 0)


def _doubtful(topic: StoredTopic) -> list[Located]:
    """Return the chunks that may share a time stamp with another one, or hold one twice."""
    located, files = topic.chunks(), topic.files
    ranks = {one.rank for one in located if not files[one.file].index.is_ours}
    latest: Located | None = None
    for one in located:
        if latest is not None and one.chunk.start_ns <= latest.chunk.end_ns:
            ranks.update((latest.rank, one.rank))
        if latest is None or one.chunk.end_ns > latest.chunk.end_ns:
            latest = one
    return [one for one in located if one.rank in ranks]


def _duplicates_among(topic: StoredTopic, located: Sequence[Located], times_ns: npt.NDArray[np.uint64]) -> int:
    """Count by the doubles in the payloads how many messages of these times are not rows of their own."""
    seen: set[float] = set()
    messages = 0
    decoders: dict[tuple[str, int], Decoder] = {}
    for one in located:
        file, chunk = topic.files[one.file], one.chunk
        channels = file.index.channels_of(topic.name)
        for found in file.cut(chunk, channels, 0, LAST_NS):
            picked = found.pick(np.flatnonzero(np.isin(found.times_ns, times_ns)))
            origin = Origin(file, channels[found.channel_id], chunk)
            decoded = topic_rows.decode(origin, picked.payloads, picked.times_ns, decoders)
            times_s = [row[TIME_KEY] for row in decoded if row is not None]
            seen.update(times_s)
            messages += len(times_s)
    return messages - len(seen)


@replanned
def payload_bytes(topic: StoredTopic) -> int:
    """Return how many bytes a topic's messages take, uncompressed, by where all messages of its chunks start."""
    total = 0
    for one in topic.chunks():
        file, chunk = topic.files[one.file], one.chunk
        found = {id_: entry.offsets for id_, entry in file.message_indexes(chunk).items()}
        if not found:
            continue
        starts = np.sort(np.concatenate(list(found.values())))
        ends = np.append(starts[1:], np.uint64(chunk.uncompressed_size))
        for id_ in file.index.channels_of(topic.name):
            if id_ in found:
                places = np.searchsorted(starts, found[id_])
                total += int((ends[places] - starts[places]).sum()) - len(places) * MESSAGE_HEAD_BYTES
    return max(total, 0)  # whatever the indexes say


def time_range(topic: StoredTopic) -> tuple[float | None, float | None]:
    """Return the time stamps of a topic's first and last rows, in s; looks only into the chunks at its ends."""
    start, _ = first(topic)
    return start, None if start is None else last_time(topic)


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
    return max((row[TIME_KEY] for row in _rows_at(topic, time_ns)), default=clock.to_seconds(time_ns))


def _rows_at(topic: StoredTopic, time_ns: int) -> list[Row]:
    """Return the rows whose doubles lie at a log time; none if they cannot be decoded."""
    low, high = clock.to_seconds(time_ns - TOLERANCE_NS), clock.to_seconds(time_ns + TOLERANCE_NS)
    try:
        return list(topic_rows.read(topic, low, high))
    except (EncodingError, DamagedFileError):  # whoever reads the rows is told
        return []
