"""One topic's rows as Arrow columns, in time order, those of one time stamp merged, chunk by chunk."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from .. import clock
from ..layout import KIND_KEY, TRACK
from ..rows.columns import FIELD_PREFIX, flatten, project
from ..rows.encode import EXACT_KEY, TIME_KEY
from ..rows.lines import LineReader
from ..rows.table import Block, Column, block_of, join
from . import messages, ordering, rows
from .decode import Decoder, Row
from .file import File
from .messages import Cut

_EXACT = f'"{EXACT_KEY}"'.encode()


@dataclass(frozen=True, slots=True)
class _Parsed:
    """The messages that were cut out of a chunk, and the columns that they became."""

    cut: Cut
    times: npt.NDArray[np.float64]
    """Time stamps, [N], in s."""
    block: Block

    @property
    def times_ns(self) -> npt.NDArray[np.uint64]:
        """Their log times."""
        return self.cut.times_ns

    def pick(self, which: npt.NDArray[np.intp]) -> _Parsed:
        """Return some of them."""
        return _Parsed(self.cut.pick(which), self.times[which], self.block.take(which))


def read(
    files: Sequence[File],
    topic: str,
    low: float = -math.inf,
    high: float = math.inf,
    columns: Sequence[str] | None = None,
    time_name: str = TIME_KEY,
) -> Iterator[Block]:
    """Read a topic's rows with time stamps in [low, high] as columns.

    They are what `rows.read` yields, in the types that `rows.table.from_rows` gives them. Memory holds a few chunks,
    not the topic.

    Args:
        files: In the order of writing.
        topic: Its name.
        low: First time stamp, in s.
        high: Last time stamp, included, in s.
        columns: Dotted names; None for all.
        time_name: What the column of time stamps is called.

    Yields:
        Some rows each, one or more, each block later than the one before. Its columns are those that it has values of.
    """
    reading = _Reading(columns, time_name)
    start_ns, end_ns = rows.to_ns_range(low, high)
    for parts in ordering.in_time(messages.cut(files, topic, start_ns, end_ns, reading.parse)):
        block = reading.combine(parts, low, high)
        if block.count:
            yield block


class _Reading:
    """What all chunks of one call have in common. Threads parse; the caller's combines."""

    def __init__(self, columns: Sequence[str] | None, time_name: str) -> None:
        self._columns = columns
        self._time_name = time_name
        self._decoders: dict[tuple[str, int], Decoder] = {}
        self._readers: dict[tuple[str, int], LineReader] = {}

    # -- a chunk's messages to columns ---------------------------------------------------------------------------------

    def parse(self, cut: Cut) -> _Parsed:
        payloads = cut.messages.payloads
        if cut.origin.channel.message_encoding != "json":
            return self._decoded(cut, payloads)
        lines = b"\n".join(payloads)
        odd = _lines_with_side_key(lines)
        if len(odd) == len(payloads):
            return self._decoded(cut, payloads)
        if not len(odd):
            return self._from_lines(cut, lines, len(payloads)) or self._decoded(cut, payloads)
        is_odd = np.zeros(len(payloads), np.bool_)
        is_odd[odd] = True
        even = np.flatnonzero(~is_odd)
        kept = [payloads[at] for at in even.tolist()]
        parsed = self._from_lines(cut.pick(even), b"\n".join(kept), len(kept))
        if parsed is None:
            return self._decoded(cut, payloads)
        others = self._decoded(cut.pick(odd), [payloads[at] for at in odd.tolist()])
        places = np.argsort(np.concatenate((even, odd)))
        times = np.concatenate((parsed.times, others.times))[places]
        return _Parsed(cut, times, join([parsed.block, others.block]).take(places))

    def _from_lines(self, cut: Cut, lines: bytes, count: int) -> _Parsed | None:
        key = rows.key_of(cut.origin)
        reader = self._readers.get(key)
        if reader is None:
            reader = self._readers[key] = LineReader(self._columns)
        flat = reader.read(lines, count)
        if flat is None:
            return None
        times = _times(flat.pop(TIME_KEY, None), cut.times_ns)
        named: dict[str, Column] = {}
        for name, array in flat.items():
            if name == TIME_KEY or name.startswith(TIME_KEY + "."):
                return None
            taken = name == self._time_name
            if self._is_wanted(FIELD_PREFIX + name if taken else name):
                named[FIELD_PREFIX + name if taken else name] = Column(array)
        if len(named) < len(flat) and self._columns is None:
            return None
        return _Parsed(cut, times, Block(count, {self._time_name: Column(pa.array(times)), **named}))

    def _is_wanted(self, name: str) -> bool:
        columns = self._columns
        return columns is None or any(name == column or name.startswith(column + ".") for column in columns)

    def _decoded(self, cut: Cut, payloads: list[bytes]) -> _Parsed:
        decoded = list(rows.decode(cut.origin, payloads, cut.times_ns, self._decoders))
        times = np.array([row[TIME_KEY] for row in decoded], np.float64)
        return _Parsed(cut, times, self._block(decoded))

    def _block(self, nested: list[Row]) -> Block:
        columns = self._columns
        chosen = nested if columns is None else [project(row, columns) for row in nested]
        return block_of([flatten(row, self._time_name) for row in chosen])

    # -- the columns of several chunks into one order ------------------------------------------------------------------

    def combine(self, parts: list[_Parsed], low: float, high: float) -> Block:
        times = np.concatenate([part.times for part in parts])
        written = np.concatenate([part.cut.written for part in parts])
        keep = (times >= low) & (times <= high)
        again = _repeated(times, keep & np.concatenate([np.full(len(part.times), _merges(part.cut)) for part in parts]))
        keep &= ~again
        blocks = [part.block for part in parts]
        if not keep.all():  # before they are joined, so that what goes has no say in the columns' types
            blocks = _chosen(blocks, keep)
            times, written = times[keep], written[keep]
        if again.any():
            merged, first_written = self._merged(parts, again)
            blocks.append(self._block(merged))
            times = np.concatenate((times, [row[TIME_KEY] for row in merged]))
            written = np.concatenate((written, first_written))
        if not blocks:
            return Block(0, {})
        block = blocks[0] if len(blocks) == 1 else join(blocks)
        if ordering.is_in_order(times, written):
            return block
        return block.take(np.lexsort((written, times)))

    def _merged(self, parts: list[_Parsed], again: npt.NDArray[np.bool_]) -> tuple[list[Row], list[int]]:
        """Merge the rows whose time stamps others have, from what was written: there, None is not the same as absent.

        Returns:
            The merged rows, and for each the number of the first one in the order of writing.
        """
        found: list[tuple[float, int, Row]] = []
        start = 0
        for part in parts:
            which = np.flatnonzero(again[start : start + len(part.times)])
            start += len(part.times)
            if len(which):
                cut = part.cut.pick(which)
                decoded = rows.decode(cut.origin, cut.messages.payloads, cut.times_ns, self._decoders)
                found += zip(part.times[which].tolist(), cut.written.tolist(), decoded, strict=True)
        found.sort(key=lambda one: one[:2])
        merged = rows.merge_same([row for _, _, row in found])
        first: dict[float, int] = {}
        for time, written, _ in found:
            first.setdefault(time, written)
        return merged, list(first.values())


def _chosen(blocks: list[Block], keep: npt.NDArray[np.bool_]) -> list[Block]:
    """Take the rows to keep out of blocks that lie one behind the other; blocks without any are left out."""
    chosen: list[Block] = []
    start = 0
    for block in blocks:
        which = np.flatnonzero(keep[start : start + block.count])
        start += block.count
        if len(which):
            chosen.append(block if len(which) == block.count else block.take(which))
    return chosen


def _merges(cut: Cut) -> bool:
    return cut.origin.channel.metadata.get(KIND_KEY) == TRACK


def _lines_with_side_key(lines: bytes) -> npt.NDArray[np.intp]:
    """Return the numbers of the lines in which the side key's name stands somewhere."""
    if _EXACT not in lines:
        return np.empty(0, np.intp)
    ends = np.flatnonzero(np.frombuffer(lines, np.uint8) == 10)
    return np.unique(np.searchsorted(ends, [match.start() for match in re.finditer(_EXACT, lines)]))


def _times(column: Any, times_ns: npt.NDArray[np.uint64]) -> npt.NDArray[np.float64]:
    """Return the exact time stamps: those of the rows, and the log times where those are something else."""
    if column is None or not (pa.types.is_floating(column.type) or pa.types.is_integer(column.type)):
        return np.array(clock.to_seconds_each(times_ns.tolist()))
    if column.null_count:
        column = column.fill_null(-1)
    said: npt.NDArray[np.float64] = column.to_numpy(zero_copy_only=False).astype(np.float64)
    others = np.flatnonzero(~ordering.is_close(said, times_ns))
    if len(others):
        said = said.copy()
        said[others] = clock.to_seconds_each(times_ns[others].tolist())
    return said


def _repeated(times: npt.NDArray[np.float64], among: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Tell which of some times occur more than once, [N]."""
    again = np.zeros(len(times), np.bool_)
    which = np.flatnonzero(among)
    chosen = times[which]
    if len(chosen) < 2 or bool((chosen[:-1] < chosen[1:]).all()):
        return again
    order = np.argsort(chosen, kind="stable")
    same = np.diff(chosen[order]) == 0
    again[which[order[1:][same]]] = True
    again[which[order[:-1][same]]] = True
    return again
