"""Reads one topic's rows as Arrow columns, in time order, those of one time stamp merged, chunk by chunk."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from .. import clock
from ..codecs import payloads
from ..codecs.codec import ColumnReader, Columns
from ..codecs.decode import codec_of
from ..codecs.encoded_channel import Decoder, Row
from ..codecs.payloads import Payloads
from ..rows import zero_copy
from ..rows.arrow_types import of_type, type_of
from ..rows.dotted import FIELD_PREFIX, flatten
from ..rows.field_choice import is_wanted, project
from ..rows.plain_row import TIME_KEY
from ..rows.table import Block, block_of, join
from ..rows.typed_columns import Column
from ..store import read_ahead
from . import time_order, topic_messages, topic_rows
from .stored_topic import StoredTopic, is_merged
from .topic_messages import Cut, MessageOrigin

_FIRST_BYTES, _MOST_BYTES = 128 * 1024, 1024 * 1024
"""Payloads of several chunks are parsed together, because each call of pyarrow has its price: about so many bytes at
first, so that a window keeps all cores at work, then more and more, and so many at last."""

_COLUMN_BYTES, _WIDEST = 2048, 16
"""Each column has its price too, some 20 us a block: so many bytes for each of them are worth it, up to so many times
`_MOST_BYTES`. Otherwise the price of rows with thousands of fields would grow with the square of their number."""


@dataclass(frozen=True, slots=True)
class _CopiedMessages:
    """Messages of one channel, copied out of their chunk."""

    times_ns: npt.NDArray[np.uint64]
    written: npt.NDArray[np.int64]
    """Numbers that grow in the order of writing, over all chunks and files."""
    payloads: Payloads
    origin: MessageOrigin

    def pick(self, which: npt.NDArray[np.intp]) -> _CopiedMessages:
        """Return some of them."""
        return _CopiedMessages(self.times_ns[which], self.written[which], self.payloads.pick(which), self.origin)


class _Some(NamedTuple):
    """Messages that are parsed together."""

    pieces: list[_CopiedMessages]
    size: int
    """Of the payloads, in bytes."""


@dataclass(frozen=True, slots=True)
class _Parsed:
    """Messages of one channel, and the columns that they became."""

    pieces: list[_CopiedMessages]
    times: npt.NDArray[np.float64]
    """Time stamps, [N], in s."""
    block: Block


def read(
    topic: StoredTopic,
    low: float = -math.inf,
    high: float = math.inf,
    columns: Sequence[str] | None = None,
    time_name: str = TIME_KEY,
) -> Iterator[Block]:
    """Read a topic's rows with time stamps in [low, high] as columns.

    They are the rows of `topic_rows.read`, in the types that `rows.table.to_table` gives them. Memory holds a few
    chunks, not the topic.

    Args:
        topic: Which one.
        low: First time stamp, in s.
        high: Last time stamp, included, in s.
        columns: Dotted names; None for all.
        time_name: The name of the column of time stamps.

    Yields:
        Some rows each, one or more, each block later than the one before. Its columns are those that it has values of.
    """
    reading = _BlockReading(columns, time_name, low, high)
    start_ns, end_ns = topic_rows.to_ns_range(low, high)
    groups = time_order.in_time(topic_messages.cut(topic, start_ns, end_ns, _copied))
    work = read_ahead.in_order(lambda some: reading.block(some.pieces), _together(groups), weigh=lambda some: some.size)
    for block in work:
        if block.count:
            yield block


def _copied(cut: Cut) -> _CopiedMessages:
    """Copy messages out of their chunk, so that it need not be held for the few of its messages that are wanted."""
    return _CopiedMessages(cut.times_ns, cut.written, payloads.of_messages(cut.messages), cut.origin)


def _together(groups: Iterable[list[_CopiedMessages]]) -> Iterator[_Some]:
    """Join groups of pieces, each later than the one before, into some that are worth parsing."""
    waiting: list[_CopiedMessages] = []
    size, enough = 0, _FIRST_BYTES
    for group in groups:
        waiting += group
        size += sum(map(_size, group))
        if size >= enough and size >= min(_COLUMN_BYTES * _width(group), _WIDEST * _MOST_BYTES):
            yield _Some(waiting, size)
            waiting, size, enough = [], 0, min(2 * enough, _MOST_BYTES)
    if waiting:
        yield _Some(waiting, size)


def _width(group: list[_CopiedMessages]) -> int:
    """Return about how many fields a row has, nested ones included."""
    # The ends of keys in JSON. In other encodings there are hardly any, and blocks do not grow for their columns.
    return group[0].payloads[0].count(b'":') if group and group[0].payloads else 0


def _size(piece: _CopiedMessages) -> int:
    """Return how many bytes the payloads have."""
    return piece.payloads.size


class _BlockReading:
    """The options, decoders and readers that all blocks of one call share. Several threads make blocks."""

    def __init__(self, columns: Sequence[str] | None, time_name: str, low: float, high: float) -> None:
        self._columns = columns
        self._time_name = time_name
        self._low, self._high = low, high
        self._decoders: dict[tuple[str, int], Decoder] = {}
        self._readers: dict[tuple[str, int], ColumnReader | None] = {}

    def block(self, pieces: list[_CopiedMessages]) -> Block:
        """Return the rows of some pieces that are wanted, in time order, merged."""
        by_channel: dict[tuple[str, int], list[_CopiedMessages]] = {}
        for piece in pieces:
            by_channel.setdefault(topic_rows.key_of(piece.origin), []).append(piece)
        return self._combine([parsed for key, group in by_channel.items() for parsed in self._parse(key, group)])

    # -- messages to columns -------------------------------------------------------------------------------------------

    def _parse(self, key: tuple[str, int], pieces: list[_CopiedMessages]) -> list[_Parsed]:
        reader = self._reader_of(key, pieces[0].origin)
        columns = None if reader is None else reader.read(payloads.together([piece.payloads for piece in pieces]))
        if columns is None:
            return [self._decoded(pieces)]
        if len(columns.others):
            return self._mixed(columns, pieces)
        return [self._named(pieces, columns.arrays) or self._decoded(pieces)]

    def _reader_of(self, key: tuple[str, int], origin: MessageOrigin) -> ColumnReader | None:
        """Return a reader that makes columns of a channel's messages; None if all have to become Python objects."""
        if key not in self._readers:
            codec = codec_of(origin.channel)
            decoder = partial(topic_rows.decoder_of, origin, self._decoders)
            self._readers[key] = None if codec is None else codec.column_reader(decoder, self._columns)
        return self._readers[key]

    def _mixed(self, columns: Columns, pieces: list[_CopiedMessages]) -> list[_Parsed]:
        """Take some of the rows through Python objects, and the others not."""
        count = sum(len(piece.payloads) for piece in pieces)
        in_columns = np.setdiff1d(np.arange(count), columns.others)
        named = self._named(_picked(pieces, in_columns), columns.arrays)
        if named is None:
            return [self._decoded(pieces)]
        others = self._decoded(_picked(pieces, columns.others))
        return [self._decoded(pieces)] if _clash(named.block, others.block) else [named, others]

    def _named(self, pieces: list[_CopiedMessages], flat: dict[str, Any]) -> _Parsed | None:
        """Give columns the names that are wanted; None if that would lose one."""
        times = _times(flat.pop(TIME_KEY, None), np.concatenate([piece.times_ns for piece in pieces]))
        named: dict[str, Column] = {}
        for name, array in flat.items():
            if name == TIME_KEY or name.startswith(TIME_KEY + "."):
                return None
            taken = name == self._time_name
            if is_wanted(FIELD_PREFIX + name if taken else name, self._columns):
                named[FIELD_PREFIX + name if taken else name] = Column(array)
        if len(named) < len(flat) and self._columns is None:
            return None
        return _Parsed(pieces, times, Block(len(times), {self._time_name: Column(zero_copy.to_arrow(times)), **named}))

    def _decoded(self, pieces: list[_CopiedMessages]) -> _Parsed:
        rows: list[Row] = []
        kept: list[_CopiedMessages] = []
        for piece in pieces:
            decoded = list(topic_rows.decode(piece.origin, list(piece.payloads), piece.times_ns, self._decoders))
            present = np.flatnonzero([row is not None for row in decoded])  # the others are lost
            kept.append(piece if len(present) == len(decoded) else piece.pick(present))
            rows += [row for row in decoded if row is not None]
        return _Parsed(kept, np.array([row[TIME_KEY] for row in rows], np.float64), self._of_rows(rows))

    def _of_rows(self, nested: list[Row]) -> Block:
        columns = self._columns
        chosen = nested if columns is None else [project(row, columns) for row in nested]
        return block_of([flatten(row, self._time_name) for row in chosen])

    # -- columns into one order ----------------------------------------------------------------------------------------

    def _combine(self, parts: list[_Parsed]) -> Block:
        times = np.concatenate([part.times for part in parts])
        written = np.concatenate([piece.written for part in parts for piece in part.pieces])
        keep = (times >= self._low) & (times <= self._high)
        merges = np.concatenate([np.full(len(part.times), is_merged(part.pieces[0].origin.channel)) for part in parts])
        again = _repeated(times, keep & merges)
        keep &= ~again
        blocks = [part.block for part in parts]
        if not keep.all():  # before they are joined, so that what goes has no say in the columns' types
            blocks = _chosen(blocks, keep)
            times, written = times[keep], written[keep]
        if again.any():
            merged, first_written = self._merged(parts, again)
            blocks.append(self._of_rows(merged))
            times = np.concatenate((times, [row[TIME_KEY] for row in merged]))
            written = np.concatenate((written, first_written))
        if not blocks:
            return Block(0, {})
        block = blocks[0] if len(blocks) == 1 else join(blocks)
        if time_order.is_in_order(times, written):
            return block
        return block.take(np.lexsort((written, times)))

    def _merged(self, parts: list[_Parsed], again: npt.NDArray[np.bool_]) -> tuple[list[Row], list[int]]:
        """Merge rows that share time stamps. They are decoded again, because columns do not tell None from absent.

        Returns:
            The merged rows, and for each the number of the first one in the order of writing.
        """
        stamped: list[tuple[float, int, Row]] = []
        start = 0
        for piece in (piece for part in parts for piece in part.pieces):
            which = np.flatnonzero(again[start : start + len(piece.payloads)])
            start += len(piece.payloads)
            if len(which):
                chosen = piece.pick(which)
                decoded = topic_rows.decode(chosen.origin, list(chosen.payloads), chosen.times_ns, self._decoders)
                for row, written in zip(decoded, chosen.written.tolist(), strict=True):
                    if row is not None:
                        stamped.append((row[TIME_KEY], written, row))
        stamped.sort(key=lambda entry: entry[:2])
        merged = topic_rows.merge_same([row for _, _, row in stamped])
        first: dict[float, int] = {}
        for time, written, _ in stamped:
            first.setdefault(time, written)
        return merged, list(first.values())


def _clash(first: Block, second: Block) -> bool:
    """Whether blocks have a column whose types no type holds: it becomes text, with each number spelled as it was.

    A column that holds integers and doubles has doubles, which do not tell how a number was spelled.
    """
    shared = first.columns.keys() & second.columns.keys()
    return any(_differ(first.columns[name].array.type, second.columns[name].array.type) for name in shared)


def _differ(first: pa.DataType, second: pa.DataType) -> bool:
    return bool(first != second) and type_of(of_type(first) | of_type(second)) is None


def _picked(pieces: list[_CopiedMessages], which: npt.NDArray[np.intp]) -> list[_CopiedMessages]:
    """Return some of the messages of pieces that lie one behind the other."""
    picked: list[_CopiedMessages] = []
    start = 0
    for piece in pieces:
        low, high = np.searchsorted(which, [start, start + len(piece.payloads)])
        if low < high:
            picked.append(piece.pick(which[low:high] - start))
        start += len(piece.payloads)
    return picked


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


def _times(column: Any, times_ns: npt.NDArray[np.uint64]) -> npt.NDArray[np.float64]:
    """Return the exact time stamps: the rows' own ones, or the log times where these do not fit."""
    if column is None or not (pa.types.is_floating(column.type) or pa.types.is_integer(column.type)):
        return np.array(clock.to_seconds_each(times_ns.tolist()))
    if column.null_count:
        # No log time is near -1 s, so such a row gets its log time.
        column = column.fill_null(-1)
    stated: npt.NDArray[np.float64] = zero_copy.to_numpy(column).astype(np.float64)
    others = np.flatnonzero(~time_order.is_close(stated, times_ns))
    if len(others):
        stated = stated.copy()
        stated[others] = clock.to_seconds_each(times_ns[others].tolist())
    return stated


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
