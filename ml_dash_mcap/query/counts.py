"""How many rows a topic has and when they start and end, reading as little as that takes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
import numpy.typing as npt

from .. import clock
from ..codecs.decode import Decoder
from ..errors import DamagedFileError, EncodingError
from ..file_names import KIND_KEY, TRACK
from ..mcap.file_index import replanned
from ..mcap.message_records import MESSAGE_HEAD_BYTES
from ..mcap.records import Channel
from ..rows.encode import TIME_KEY
from . import plan, topic_rows
from .file import File
from .plan import Located
from .time_order import TOLERANCE_NS
from .topic_messages import Origin

_DISTINCT_FROM_NS = 2**23 * clock.NS_PER_S
"""From here on (97 days) doubles are more than a nanosecond apart: what shares a nanosecond shares the double."""


def channels(files: Sequence[File], topic: str) -> list[tuple[File, Channel]]:
    """Return a topic's channels, in the order of writing."""
    return [(file, channel) for file in files for channel in file.index.channels_of(topic).values()]


def kind(files: Sequence[File], topic: str) -> str | None:
    """Return what kind of topic it is; None where no channel of it says."""
    for _, channel in channels(files, topic):
        found = channel.metadata.get(KIND_KEY)
        if found is not None:
            return found
    return None


@replanned
def count(files: Sequence[File], topic: str) -> int:
    """Return how many rows a topic has after merging, reading no more than that takes.

    The statistics know, unless two chunks that touch in time may hold rows of one time stamp; then their message
    indexes know; and only times of the first 97 days, where two doubles can share a nanosecond, need the payloads.
    """
    for file in files:
        file.settle()
    total = sum(file.index.message_counts.get(channel.id, 0) for file, channel in channels(files, topic))
    if kind(files, topic) != TRACK:
        return total
    return max(total - _duplicates(files, topic), 0)  # a file can announce too few


def _duplicates(files: Sequence[File], topic: str) -> int:
    located = _located(files, topic)
    doubtful = {one.rank for one in located if not files[one.file].index.is_ours}
    reach: Located | None = None
    for one in located:
        if reach is not None and one.chunk.start_ns <= reach.chunk.end_ns:
            doubtful.update((reach.rank, one.rank))
        if reach is None or one.chunk.end_ns > reach.chunk.end_ns:
            reach = one
    found = [times_in(files[one.file], topic, one) for one in located if one.rank in doubtful]
    if not found:
        return 0
    shared, counts = np.unique(np.concatenate(found), return_counts=True)
    surely = (counts > 1) & (shared >= np.uint64(_DISTINCT_FROM_NS))
    duplicates = int((counts[surely] - 1).sum())
    perhaps = shared[(counts > 1) & ~surely]
    if len(perhaps):
        duplicates += _duplicates_among(files, topic, [one for one in located if one.rank in doubtful], perhaps)
    return duplicates


def _duplicates_among(
    files: Sequence[File], topic: str, located: Sequence[Located], times_ns: npt.NDArray[np.uint64]
) -> int:
    """Count by the doubles in the payloads how many messages of these times are not rows of their own."""
    seen: set[float] = set()
    messages = 0
    decoders: dict[tuple[str, int], Decoder] = {}
    for one in located:
        file, chunk = files[one.file], one.chunk
        channels = file.index.channels_of(topic)
        for found in file.cut(chunk, channels, 0, topic_rows.LAST_NS):
            picked = found.pick(np.flatnonzero(np.isin(found.times_ns, times_ns)))
            origin = Origin(file, channels[found.channel_id], chunk)
            decoded = topic_rows.decode(origin, picked.payloads, picked.times_ns, decoders)
            times_s = [row[TIME_KEY] for row in decoded if row is not None]
            seen.update(times_s)
            messages += len(times_s)
    return messages - len(seen)


def _located(files: Sequence[File], topic: str) -> list[Located]:
    indexes = [file.index for file in files]
    return plan.chunks(indexes, [index.channels_of(topic) for index in indexes], 0, topic_rows.LAST_NS)


@replanned
def payload_bytes(files: Sequence[File], topic: str) -> int:
    """Return how many bytes a topic's messages take, uncompressed, by where all messages of its chunks start."""
    total = 0
    for one in _located(files, topic):
        file, chunk = files[one.file], one.chunk
        index = file.index
        found = {id_: entry.offsets for id_, entry in file.message_indexes(chunk).items()}
        if not found:
            continue
        starts = np.sort(np.concatenate(list(found.values())))
        ends = np.append(starts[1:], np.uint64(chunk.uncompressed_size))
        for id_ in index.channels_of(topic):
            if id_ in found:
                places = np.searchsorted(starts, found[id_])
                total += int((ends[places] - starts[places]).sum()) - len(places) * MESSAGE_HEAD_BYTES
    return max(total, 0)  # whatever the indexes say


@replanned
def times(files: Sequence[File], topic: str, start_ns: int, end_ns: int) -> npt.NDArray[np.uint64]:
    """Return the log times of a topic's messages in [start_ns, end_ns], in no order, [N], in ns."""
    indexes = [file.index for file in files]
    located = plan.chunks(indexes, [index.channels_of(topic) for index in indexes], start_ns, end_ns)
    found = [times_in(files[one.file], topic, one) for one in located]
    all_times: npt.NDArray[np.uint64] = np.concatenate(found) if found else np.empty(0, np.uint64)
    wanted: npt.NDArray[np.bool_] = (all_times >= np.uint64(start_ns)) & (all_times <= np.uint64(max(end_ns, 0)))
    return all_times[wanted]


def times_in(file: File, topic: str, located: Located) -> npt.NDArray[np.uint64]:
    """Return the log times of a topic's messages in one chunk, in ns."""
    ids = file.index.channels_of(topic)
    found = [file.message_index(located.chunk, channel_id).times_ns for channel_id in ids]
    return np.concatenate(found) if found else np.empty(0, np.uint64)


@replanned
def time_range(files: Sequence[File], topic: str) -> tuple[float | None, float | None]:
    """Return the time stamps of a topic's first and last rows, in s; looks only into the chunks at its ends."""
    for file in files:
        file.survey_few()
    located = _located(files, topic)
    first: int | None = None
    for one in located:
        if first is not None and one.chunk.start_ns > first:
            break
        found = times_in(files[one.file], topic, one)
        if len(found):
            first = int(found.min()) if first is None else min(first, int(found.min()))
    if first is None:
        return None, None
    last = first
    for one in sorted(located, key=lambda one: one.chunk.end_ns, reverse=True):
        if one.chunk.end_ns < last:
            break
        found = times_in(files[one.file], topic, one)
        if len(found):
            last = max(last, int(found.max()))
    return _time_at(files, topic, first, min), _time_at(files, topic, last, max)


def _time_at(files: Sequence[File], topic: str, time_ns: int, choose: Callable[[Iterable[float]], float]) -> float:
    """Return the exact double of the row at a log time; of one that cannot be decoded, that of the log time."""
    low, high = clock.to_seconds(time_ns - TOLERANCE_NS), clock.to_seconds(time_ns + TOLERANCE_NS)
    try:
        found = [row[TIME_KEY] for row in topic_rows.read(files, topic, low, high)]
    except (EncodingError, DamagedFileError):  # whoever reads the rows is told
        found = []
    return choose(found) if found else clock.to_seconds(time_ns)
