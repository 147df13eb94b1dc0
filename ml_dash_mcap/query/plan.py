"""Plans which bytes to read: a pure function of the indexes, so that it can be tested without a file."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import overload

import numpy as np
import numpy.typing as npt

from ..mcap import chunk_table
from ..mcap.file_index import FileIndex
from ..mcap.records import Chunk

_LAST_NS = 2**64 - 1
_NO_TIMES: npt.NDArray[np.uint64] = np.empty(0, np.uint64)
_NO_PLACES: npt.NDArray[np.intp] = np.empty(0, np.intp)


@dataclass(frozen=True, slots=True)
class Located:
    """A chunk, in which file, and its place in the order of writing."""

    file: int
    """Index into the files that were planned for."""
    rank: int
    """0 for the first chunk of the first file; a higher rank was written later."""
    chunk: Chunk

    @property
    def end(self) -> int:
        """Where the chunk and its message indexes end."""
        return self.chunk.indexes_end


@dataclass(frozen=True, slots=True)
class Span:
    """One range of a file's bytes, and the chunks that lie in it."""

    file: int
    offset: int
    length: int
    chunks: tuple[Located, ...]
    """By start time."""


class ChunkPlan(Sequence[Located]):
    """Chunks to read, by start time, those of one time in the order of writing; each is looked up when it is asked for.

    Attributes:
        start_ns: First log time of each, [N], in ns.
        end_ns: Last log time of each, included, [N], in ns.
        files: Which file each lies in, [N].
    """

    def __init__(
        self,
        indexes: Sequence[FileIndex],
        start_ns: npt.NDArray[np.uint64],
        end_ns: npt.NDArray[np.uint64],
        files: npt.NDArray[np.intp],
        places: npt.NDArray[np.intp],
    ) -> None:
        """Take chunks that are in order.

        Args:
            indexes: Of the files.
            start_ns: See the class.
            end_ns: See the class.
            files: See the class.
            places: Which of that file's chunks each is.
        """
        self.start_ns, self.end_ns = start_ns, end_ns
        self._indexes = indexes
        self.files, self._places = files, places
        self._first_rank = [0, *accumulate(len(index.chunks) for index in indexes)]

    def __len__(self) -> int:
        return len(self._places)

    @overload
    def __getitem__(self, at: int) -> Located: ...
    @overload
    def __getitem__(self, at: slice) -> ChunkPlan: ...
    def __getitem__(self, at: int | slice) -> Located | ChunkPlan:
        if isinstance(at, slice):
            return self.pick(np.arange(len(self))[at])
        file, place = int(self.files[at]), int(self._places[at])
        return Located(file, self._first_rank[file] + place, self._indexes[file].chunks[place])

    def pick(self, which: npt.NDArray[np.intp]) -> ChunkPlan:
        """Return some of the chunks, in an order that the caller chooses."""
        return ChunkPlan(
            self._indexes, self.start_ns[which], self.end_ns[which], self.files[which], self._places[which]
        )

    def within(self, start_ns: int, end_ns: int) -> ChunkPlan:
        """Return the chunks that may hold messages with log times in [start_ns, end_ns]."""
        if end_ns < 0 or start_ns > _LAST_NS:
            return self[:0]
        is_wanted = self.end_ns >= np.uint64(max(start_ns, 0))
        is_wanted &= self.start_ns <= np.uint64(min(end_ns, _LAST_NS))
        return self.pick(np.flatnonzero(is_wanted))


def chunks(
    indexes: Sequence[FileIndex], channels: Sequence[Collection[int] | None], start_ns: int, end_ns: int
) -> ChunkPlan:
    """Return every chunk that may hold a wanted message.

    Args:
        indexes: Of the files, in the order of writing.
        channels: For each file, the ids of the wanted channels; None for all.
        start_ns: First log time wanted, in ns.
        end_ns: Last log time wanted, included, in ns.
    """
    starts, ends, files, places = [_NO_TIMES], [_NO_TIMES], [_NO_PLACES], [_NO_PLACES]
    for file, (index, wanted) in enumerate(zip(indexes, channels, strict=True)):
        held = chunk_table.holding(index.chunks, wanted, start_ns, end_ns)
        if len(held):
            first, last = chunk_table.times(index.chunks, held)
            starts.append(first)
            ends.append(last)
            files.append(np.full(len(held), file))
            places.append(held)
    start = np.concatenate(starts)
    in_files = ChunkPlan(indexes, start, np.concatenate(ends), np.concatenate(files), np.concatenate(places))
    return in_files.pick(np.argsort(start, kind="stable"))


def coalesce(located: Sequence[Located]) -> list[Span]:
    """Join chunks that follow each other, in the order given and in their file, into spans to read at once."""
    spans: list[Span] = []
    for following in located:
        last = spans[-1] if spans else None
        if last is not None and _follows(following, last):
            length = following.end - last.offset
            spans[-1] = Span(last.file, last.offset, length, (*last.chunks, following))
        else:
            spans.append(
                Span(following.file, following.chunk.offset, following.end - following.chunk.offset, (following,))
            )
    return spans


def ranges_by_file(spans: Iterable[Span]) -> dict[int, list[tuple[int, int]]]:
    """Return for each file the ranges of its bytes that will be read, [start, end), in the order of reading."""
    ranges: dict[int, list[tuple[int, int]]] = {}
    for span in spans:
        ranges.setdefault(span.file, []).append((span.offset, span.offset + span.length))
    return ranges


def _follows(following: Located, last: Span) -> bool:
    return following.file == last.file and chunk_table.is_read_with(
        following.chunk, last.offset, last.offset + last.length
    )


def spans(
    indexes: Sequence[FileIndex], channels: Sequence[Collection[int] | None], start_ns: int, end_ns: int
) -> list[Span]:
    """Return the ranges of bytes that hold every wanted message, by the start time of their first chunks.

    The arguments are those of `chunks`.
    """
    return coalesce(chunks(indexes, channels, start_ns, end_ns))
