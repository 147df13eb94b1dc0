"""The chunks of a file as arrays: a long recording has tens of thousands, of which a read wants a few."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import overload

import numpy as np
import numpy.typing as npt

from .message_records import ENTRY_BYTES, MESSAGE_INDEX_HEAD
from .record_layout import PREFIX_BYTES
from .records import Chunk

_NAMES = (
    *("start_ns", "end_ns", "offset", "length"),
    *("message_index_length", "compressed_size", "uncompressed_size"),
)

NUMBERS = np.dtype([(name, np.uint64) for name in _NAMES])
"""The numbers of a `Chunk`, by the names that they have there; times in ns, the rest in bytes."""

_INDEX_BYTES = PREFIX_BYTES + MESSAGE_INDEX_HEAD.size
"""A message index without entries."""

_LAST = 2**64 - 1

GAP_BYTES = 64 * 1024
"""Neighbours that lie at most this far apart are read together, in bytes: skipping would cost more."""

SPAN_BYTES = 2 * 1024 * 1024
"""A range that is read at once stops growing beyond this many bytes. That bounds a reader's memory."""


@dataclass(frozen=True, slots=True)
class Alike:
    """Chunks whose indexes have one form."""

    rows: npt.NDArray[np.intp]
    """Which chunks, in the order of their chunk indexes, [M]."""
    compression: str
    ids: npt.NDArray[np.uint16]
    """Channels that have messages, [M, channels]."""
    offsets: npt.NDArray[np.uint64]
    """Where their message indexes lie in the file, [M, channels], bytes."""


class ChunkTable(Sequence[Chunk]):
    """The chunks of a finished file, in the order of the file. Each becomes a `Chunk` when it is asked for."""

    def __init__(
        self,
        numbers: npt.NDArray[np.void] | None = None,
        alike: Sequence[Alike] = (),
        others: Iterable[tuple[int, Chunk]] = (),
    ) -> None:
        """Sort chunks by where they lie.

        Args:
            numbers: Of each chunk, `NUMBERS`, in the order of their chunk indexes, [N]; None if there are none.
            alike: The chunks whose indexes were read together.
            others: All others, each with its place in `numbers`.
        """
        numbers = np.zeros(0, NUMBERS) if numbers is None else numbers
        order = np.argsort(numbers["offset"], kind="stable")
        # The inverse of `order`: from a chunk's place in the summary to its place in the file.
        place = np.empty(len(order), np.intp)
        place[order] = np.arange(len(order))
        self.numbers = numbers[order]
        self._alike = [Alike(place[group.rows], group.compression, group.ids, group.offsets) for group in alike]
        self._group = np.full(len(order), -1, np.intp)
        self._row = np.zeros(len(order), np.intp)
        for number, group in enumerate(self._alike):
            self._group[group.rows] = number
            self._row[group.rows] = np.arange(len(group.rows))
        self._chunk_by_place: dict[int, Chunk] = {int(place[at]): chunk for at, chunk in others}
        self._others = list(self._chunk_by_place)
        self._same_ids = [_same_row(group.ids) for group in self._alike]
        """For each group, the channels of its chunks if all have the same ones, as in most recordings; else None."""

    def __len__(self) -> int:
        return len(self.numbers)

    @overload
    def __getitem__(self, at: int) -> Chunk: ...
    @overload
    def __getitem__(self, at: slice) -> list[Chunk]: ...
    def __getitem__(self, at: int | slice) -> Chunk | list[Chunk]:
        if isinstance(at, slice):
            return [self[place] for place in range(*at.indices(len(self)))]
        place = range(len(self))[at]
        chunk = self._chunk_by_place.get(place)
        if chunk is None:
            chunk = self._chunk_by_place[place] = self._made(place)
        return chunk

    def __iter__(self) -> Iterator[Chunk]:
        return (self[at] for at in range(len(self)))

    def holding(self, channels: Collection[int] | None, start_ns: int, end_ns: int) -> npt.NDArray[np.intp]:
        """Return the places of the chunks that may hold a wanted message; see the function `holding`."""
        if start_ns > _LAST or end_ns < 0:
            return np.empty(0, np.intp)
        wanted = self.numbers["end_ns"] >= np.uint64(max(start_ns, 0))
        wanted &= self.numbers["start_ns"] <= np.uint64(min(end_ns, _LAST))
        if channels is not None:
            wanted &= self._hold(channels)
        return np.flatnonzero(wanted)

    def channels(self) -> set[int]:
        """Return the ids of all channels; see the function `channels`."""
        ids: set[int] = set()
        for group in self._alike:
            ids.update(np.unique(group.ids).tolist())
        for at in self._others:
            ids.update(self[at].message_index_offsets)
        return ids

    def count_into(self, total: npt.NDArray[np.int64]) -> bool:
        """Add how many messages each channel has to `total`; returns whether all chunks tell, as `counts` does."""
        for group in self._alike:
            if not group.ids.shape[1]:
                if self.numbers["uncompressed_size"][group.rows].any():
                    return False
                continue
            numbers = self.numbers[group.rows]
            ends = (numbers["offset"] + numbers["length"] + numbers["message_index_length"]).astype(np.int64)
            starts = group.offsets.astype(np.int64)
            order = np.argsort(starts, axis=1)
            edges = np.concatenate([np.take_along_axis(starts, order, 1), ends[:, None]], axis=1)
            entries = np.maximum(np.diff(edges, axis=1) - _INDEX_BYTES, 0) // ENTRY_BYTES
            # np.add.at counts a channel as often as it comes; `total[ids] += entries` would count it once.
            np.add.at(total, np.take_along_axis(group.ids, order, 1).ravel(), entries.ravel())
        for at in self._others:
            chunk = self[at]
            if not chunk.indexed and chunk.uncompressed_size:
                return False
            add_counts(total, chunk)
        return True

    def correct(self, chunk: Chunk) -> None:
        """Put a corrected entry of a chunk in the place of the wrong one. Its offset in the file is the same."""
        place = int(np.searchsorted(self.numbers["offset"], np.uint64(chunk.offset)))
        if place not in self._others:
            self._others.append(place)  # looked at after those that were read together, so that it counts
        self._chunk_by_place[place] = chunk
        self.numbers["start_ns"][place], self.numbers["end_ns"][place] = chunk.start_ns, chunk.end_ns

    def _hold(self, channels: Collection[int]) -> npt.NDArray[np.bool_]:
        held = np.ones(len(self), np.bool_)
        ids = np.fromiter(channels, np.uint16, len(channels))
        for group, same in zip(self._alike, self._same_ids, strict=True):
            if same is not None:
                held[group.rows] = not same.isdisjoint(channels)
            elif group.ids.shape[1]:
                held[group.rows] = np.isin(group.ids, ids).any(axis=1)
        for at in self._others:
            held[at] = may_hold(self[at], channels)
        return held

    def _made(self, place: int) -> Chunk:
        group, row = self._alike[self._group[place]], self._row[place]
        return Chunk(
            **dict(zip(_NAMES, self.numbers[place].item(), strict=True)),
            compression=group.compression,
            message_index_offsets=dict(zip(group.ids[row].tolist(), group.offsets[row].tolist(), strict=True)),
            indexed=group.ids.shape[1] > 0,
        )


def _same_row(ids: npt.NDArray[np.uint16]) -> frozenset[int] | None:
    """Return the numbers that all rows of a matrix have; None if the rows differ, or are empty."""
    is_same = ids.size > 0 and bool((ids == ids[0]).all())
    return frozenset(ids[0].tolist()) if is_same else None


def holding(
    chunks: Sequence[Chunk], channels: Collection[int] | None, start_ns: int, end_ns: int
) -> npt.NDArray[np.intp]:
    """Return which chunks may hold a wanted message, as places in `chunks`, ascending.

    Args:
        chunks: Of a file.
        channels: The ids of the wanted channels; None for all.
        start_ns: First log time wanted, in ns.
        end_ns: Last log time wanted, included, in ns.
    """
    if isinstance(chunks, ChunkTable):
        return chunks.holding(channels, start_ns, end_ns)
    held = [
        place
        for place, chunk in enumerate(chunks)
        if chunk.end_ns >= start_ns and chunk.start_ns <= end_ns and may_hold(chunk, channels)
    ]
    return np.array(held, np.intp)


def times(
    chunks: Sequence[Chunk], which: npt.NDArray[np.intp]
) -> tuple[npt.NDArray[np.uint64], npt.NDArray[np.uint64]]:
    """Return the first and the last log times of some chunks, in ns."""
    if isinstance(chunks, ChunkTable):
        return chunks.numbers["start_ns"][which], chunks.numbers["end_ns"][which]
    part = [chunks[place] for place in which.tolist()]
    starts = np.array([chunk.start_ns for chunk in part], np.uint64)
    return starts, np.array([chunk.end_ns for chunk in part], np.uint64)


def is_read_with(chunk: Chunk, start: int, end: int) -> bool:
    """Whether a chunk and its message indexes are read together with the bytes of [start, end) before it."""
    return 0 <= chunk.offset - end <= GAP_BYTES and chunk.indexes_end - start <= SPAN_BYTES


def read_together(chunks: Iterable[Chunk]) -> Iterator[list[Chunk]]:
    """Yield chunks, which are in the order of the file, in groups that are each read at once."""
    group: list[Chunk] = []
    for chunk in chunks:
        if group and not is_read_with(chunk, group[0].offset, group[-1].indexes_end):
            yield group
            group = []
        group.append(chunk)
    if group:
        yield group


def channels(chunks: Sequence[Chunk]) -> set[int]:
    """Return the ids of all channels that a chunk has a message index of."""
    if isinstance(chunks, ChunkTable):
        return chunks.channels()
    return {channel for chunk in chunks for channel in chunk.message_index_offsets}


def places(chunks: Sequence[Chunk]) -> tuple[npt.NDArray[np.uint64], npt.NDArray[np.uint64]]:
    """Return where chunks start, and where their message indexes end, [N] each, bytes."""
    if isinstance(chunks, ChunkTable):
        start = chunks.numbers["offset"]
        return start, start + chunks.numbers["length"] + chunks.numbers["message_index_length"]
    ends = [chunk.indexes_end for chunk in chunks]
    return np.array([chunk.offset for chunk in chunks], np.uint64), np.array(ends, np.uint64)


def unpacked_bytes(chunks: Sequence[Chunk], at_most: int) -> int:
    """Return how many bytes all chunks have unpacked, no more than `at_most` of each."""
    if isinstance(chunks, ChunkTable):
        return int(np.minimum(chunks.numbers["uncompressed_size"], np.uint64(at_most)).sum())
    return sum(min(chunk.uncompressed_size, at_most) for chunk in chunks)


def correct(chunks: Sequence[Chunk], chunk: Chunk) -> None:
    """Put a corrected entry of a chunk in the place of the wrong one, for the chunks of any file."""
    if isinstance(chunks, ChunkTable):
        chunks.correct(chunk)
    elif isinstance(chunks, list):
        place = bisect_left(chunks, chunk.offset, key=lambda entry: entry.offset)
        chunks[place] = chunk


def counts(chunks: Sequence[Chunk]) -> dict[int, int] | None:
    """Return how many messages each channel has by the lengths of the message indexes; None where some have none.

    Nothing of the file is read: an index ends where the next one starts. A later version may make them longer, so the
    numbers tell only whether statistics agree.
    """
    total = np.zeros(2**16, np.int64)
    if isinstance(chunks, ChunkTable):
        if not chunks.count_into(total):
            return None
    else:
        for chunk in chunks:
            if not chunk.indexed and chunk.uncompressed_size:
                return None
            add_counts(total, chunk)
    return {channel_id: int(total[channel_id]) for channel_id in np.flatnonzero(total).tolist()}


def add_counts(total: npt.NDArray[np.int64], chunk: Chunk) -> None:
    """Add how many messages each channel has in a chunk to `total`, [65536]."""
    ends = [*sorted(chunk.message_index_offsets.values()), chunk.indexes_end]
    length = {start: end - start for start, end in pairwise(ends)}
    for channel_id, start in chunk.message_index_offsets.items():
        total[channel_id] += max(length.get(start, 0) - _INDEX_BYTES, 0) // ENTRY_BYTES


def spans(chunks: Sequence[Chunk]) -> set[tuple[int, int]]:
    """Return the first and last log times that chunks say, in ns; none without chunks.

    A chunk that says 0 for both may hold messages at 0 or none at all: both results are among those returned.
    """
    if isinstance(chunks, ChunkTable):
        starts, ends = chunks.numbers["start_ns"], chunks.numbers["end_ns"]
    else:
        starts = np.array([chunk.start_ns for chunk in chunks], np.uint64)
        ends = np.array([chunk.end_ns for chunk in chunks], np.uint64)
    has_times = (starts != 0) | (ends != 0)
    return {(int(starts[of].min()), int(ends[of].max())) for of in (has_times, np.ones_like(has_times)) if of.any()}


def may_hold(chunk: Chunk, channels: Collection[int] | None) -> bool:
    """Whether a chunk may hold messages of some channels, None for any, by what its index says."""
    held = chunk.message_index_offsets if chunk.indexed else chunk.counts
    if channels is None or held is None:
        return True
    few, many = (channels, held) if len(channels) < len(held) else (held, channels)  # a chunk may hold thousands
    return any(channel in many for channel in few)
