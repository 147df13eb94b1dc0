"""Reads topics' times and sequence numbers in the order of writing."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..errors import DamagedFileError
from ..file_names import KIND_KEY, TRACK
from ..mcap import audit, chunk_table
from ..mcap.chunk_messages import ChunkContents, Messages
from ..mcap.file_index import replanned
from ..mcap.records import Chunk
from ..query.file import File
from ..query.stored_topic import LAST_NS
from ..store import read_ahead


@dataclass(frozen=True, slots=True)
class Written:
    """The messages of one topic that one recorder wrote, in the order of writing."""

    run: str
    """The recorder's id in its segments, or else the file's path."""
    is_ours: bool
    """Whether the recorder was one of this library, which counts a topic's rows in the sequence numbers."""
    merges: bool
    """Whether its rows of one time are one row when they are read."""
    times_ns: npt.NDArray[np.uint64]
    """Log times, [N]."""
    sequences: npt.NDArray[np.uint32]
    """[N]."""


@dataclass(frozen=True, slots=True)
class _WrittenPart:
    """Messages of one topic in one chunk."""

    topic: str
    merges: bool
    times_ns: npt.NDArray[np.uint64]
    sequences: npt.NDArray[np.uint32]


class _Times(NamedTuple):
    """Of the messages of one channel in one chunk: where they lie in it, log times (ns), sequence numbers, [N] each."""

    offsets: npt.NDArray[np.int64]
    times_ns: npt.NDArray[np.uint64]
    sequences: npt.NDArray[np.uint32]


def read(
    files: Sequence[File], topics: Collection[str], damage: list[DamagedFileError], *, has_all: bool
) -> dict[str, list[Written]]:
    """Read every chunk that holds one of some topics, and verify its checksum; no payload is decoded.

    Args:
        files: In the order of writing.
        topics: Their names.
        damage: Gets the errors of broken parts, which the result leaves out.
        has_all: Whether to read all other chunks too, and compare the indexes and statistics with them.

    Returns:
        By topic, the messages of each recorder, in the order of the recorders' first files.
    """
    by_run: dict[tuple[str, str, bool], list[_WrittenPart]] = {}
    for file in files:
        run = run_of(file)
        for part in (_parts_of_all if has_all else _parts)(file, topics, damage):
            by_run.setdefault((part.topic, run or file.source.name, run is not None), []).append(part)
    by_topic: dict[str, list[Written]] = {topic: [] for topic in topics}
    for (topic, name, is_ours), parts in by_run.items():
        times = np.concatenate([part.times_ns for part in parts])
        merges = is_ours and all(part.merges for part in parts)
        sequences = np.concatenate([part.sequences for part in parts])
        by_topic[topic].append(Written(name, is_ours, merges, times, sequences))
    return by_topic


def run_of(file: File) -> str | None:
    """Return the id of the recorder of this library that wrote a file; None for other tools' files."""
    try:
        return file.about().get("run")
    except DamagedFileError:  # reading the metadata raises this again
        return None


@replanned
def _parts(file: File, topics: Collection[str], damage: list[DamagedFileError]) -> list[_WrittenPart]:
    """Return the messages of some topics in a file, chunk by chunk."""
    try:
        index = file.index
    except DamagedFileError as error:
        damage.append(error)
        return []
    wanted = {id_: channel.topic for id_, channel in index.channels.items() if channel.topic in topics}

    def read_chunk(chunk: Chunk) -> list[_WrittenPart] | DamagedFileError:
        try:
            return _parts_of(file, chunk, wanted)
        except DamagedFileError as error:
            return error

    parts: list[_WrittenPart] = []
    chunks = (index.chunks[at] for at in chunk_table.holding(index.chunks, wanted, 0, LAST_NS).tolist())
    for chunk_parts in read_ahead.in_order(read_chunk, chunks, weigh=lambda chunk: chunk.uncompressed_size):
        if isinstance(chunk_parts, DamagedFileError):
            damage.append(chunk_parts)
        else:
            parts += chunk_parts
    return parts


def _parts_of_all(file: File, topics: Collection[str], damage: list[DamagedFileError]) -> list[_WrittenPart]:
    """Return the same as `_parts`, and audit the file."""
    try:
        audited = audit.audit(file, lambda chunk, contents: _times(contents))
    except DamagedFileError as error:
        damage.append(error)
        return []
    parts: list[_WrittenPart] = []
    for times_by_channel in audited:
        if isinstance(times_by_channel, DamagedFileError):
            damage.append(times_by_channel)
            continue
        by_topic: dict[str, list[_Times]] = {}
        merges: dict[str, bool] = {}
        for channel_id, times in times_by_channel.items():
            channel = file.index.channels.get(channel_id)
            if channel is not None and channel.topic in topics:
                by_topic.setdefault(channel.topic, []).append(times)
                is_track = channel.metadata.get(KIND_KEY) == TRACK
                merges[channel.topic] = is_track and merges.get(channel.topic, True)
        parts += [_joined(topic, merges[topic], same) for topic, same in by_topic.items()]
    return parts


def _times(contents: ChunkContents) -> dict[int, _Times]:
    return {
        channel_id: _Times(messages.offsets, messages.times_ns, messages.sequences)
        for channel_id, messages in contents.messages.items()
        if len(messages)
    }


def _parts_of(file: File, chunk: Chunk, wanted: Mapping[int, str]) -> list[_WrittenPart]:
    ids = [id_ for id_ in wanted if not chunk.indexed or id_ in chunk.message_index_offsets]
    span = file.read_span(chunk.offset, chunk.length + chunk.message_index_length)
    cuts = file.cut(chunk, ids, 0, LAST_NS, span)
    by_topic: dict[str, list[Messages]] = {}
    for cut in cuts:
        by_topic.setdefault(wanted[cut.channel_id], []).append(cut)
    channels = file.index.channels
    return [
        _joined(topic, all(channels[cut.channel_id].metadata.get(KIND_KEY) == TRACK for cut in same), same)
        for topic, same in by_topic.items()
    ]


def _joined(topic: str, merges: bool, cuts: Sequence[Messages] | Sequence[_Times]) -> _WrittenPart:
    order = np.argsort(np.concatenate([cut.offsets for cut in cuts]))
    times = np.concatenate([cut.times_ns for cut in cuts])
    return _WrittenPart(topic, merges, times[order], np.concatenate([cut.sequences for cut in cuts])[order])
