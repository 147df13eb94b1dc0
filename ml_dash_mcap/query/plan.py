"""Which bytes to read: a pure function of the indexes, so that it can be tested without a file."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

from ..mcap import chunk_table
from ..mcap.file_index import FileIndex
from ..mcap.records import Chunk


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


def chunks(
    indexes: Sequence[FileIndex], channels: Sequence[Collection[int] | None], start_ns: int, end_ns: int
) -> list[Located]:
    """Return every chunk that may hold a wanted message, by start time (those of one time in the order of writing).

    Args:
        indexes: Of the files, in the order of writing.
        channels: For each file, the ids of the wanted channels; None for all.
        start_ns: First log time wanted, in ns.
        end_ns: Last log time wanted, included, in ns.
    """
    found: list[Located] = []
    rank = 0
    for file, (index, wanted) in enumerate(zip(indexes, channels, strict=True)):
        held = chunk_table.holding(index.chunks, wanted, start_ns, end_ns)
        found += [Located(file, rank + at, chunk) for at, chunk in held]
        rank += len(index.chunks)
    found.sort(key=lambda located: (located.chunk.start_ns, located.rank))
    return found


def coalesce(located: Sequence[Located]) -> list[Span]:
    """Join chunks that follow each other, in the order given and in their file, into spans to read at once."""
    spans: list[Span] = []
    for one in located:
        last = spans[-1] if spans else None
        if last is not None and _follows(one, last):
            length = one.end - last.offset
            spans[-1] = Span(last.file, last.offset, length, (*last.chunks, one))
        else:
            spans.append(Span(one.file, one.chunk.offset, one.end - one.chunk.offset, (one,)))
    return spans


def ranges_by_file(spans: Iterable[Span]) -> dict[int, list[tuple[int, int]]]:
    """Return for each file the ranges of its bytes that will be read, [start, end), in the order of reading."""
    ranges: dict[int, list[tuple[int, int]]] = {}
    for span in spans:
        ranges.setdefault(span.file, []).append((span.offset, span.offset + span.length))
    return ranges


def _follows(one: Located, last: Span) -> bool:
    return one.file == last.file and chunk_table.is_read_with(one.chunk, last.offset, last.offset + last.length)


def spans(
    indexes: Sequence[FileIndex], channels: Sequence[Collection[int] | None], start_ns: int, end_ns: int
) -> list[Span]:
    """Return the ranges of bytes that hold every wanted message, by the start time of their first chunks.

    The arguments are those of `chunks`.
    """
    return coalesce(chunks(indexes, channels, start_ns, end_ns))
