"""Reads one topic's rows as columns where columns say exactly what the rows said, and as rows elsewhere.

In columns a field that a row lacks looks like one that is None, an integer among fractions like a double, a key with
a dot like a dict in a dict. Formats that give back what was recorded must tell these apart. That a block has none of
them can be proven from its bytes: it has no nulls, no key with a dot, and as many dots as doubles.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ..codecs.codec import ColumnReader
from ..codecs.decode import codec_of
from ..codecs.encoded_channel import Decoder, Row
from ..rows import zero_copy
from ..rows.plain_row import TIME_KEY
from ..rows.table import Block
from ..rows.typed_columns import Column
from . import time_order, topic_messages
from . import topic_rows as rows
from .stored_topic import StoredTopic
from .topic_messages import Cut


@dataclass(frozen=True, slots=True)
class _ParsedCut:
    """The messages that were cut out of a chunk, and the columns that say the same, if there are any."""

    cut: Cut
    block: Block | None

    @property
    def times_ns(self) -> npt.NDArray[np.uint64]:
        """Their log times."""
        return self.cut.times_ns

    def pick(self, which: npt.NDArray[np.intp]) -> _ParsedCut:
        """Return some of them."""
        return _ParsedCut(self.cut.pick(which), None if self.block is None else self.block.take(which))


def read(topic: StoredTopic, low: float = -math.inf, high: float = math.inf) -> Iterator[Block | list[Row]]:
    """Read a topic's rows with time stamps in [low, high].

    They are the rows of `topic_rows.read`, in its order. Memory holds a few chunks, not the topic.

    Args:
        topic: Which one.
        low: First time stamp, in s.
        high: Last time stamp, included, in s.

    Yields:
        Some rows each, one or more: a block of columns without any null, `_ts` among them, whose dotted names are
        those of nested dicts; or the rows themselves.
    """
    reading = _Reading()
    start_ns, end_ns = rows.to_ns_range(low, high)
    for parts in time_order.in_time(topic_messages.cut(topic, start_ns, end_ns, reading.parse)):
        block = reading.block(parts, low, high)
        rows_or_block = block if block is not None else reading.rows(parts, low, high)
        if size(rows_or_block):
            yield rows_or_block


def size(part: Block | list[Row]) -> int:
    """Return how many rows there are."""
    return len(part) if isinstance(part, list) else part.count


class _Reading:
    """The decoders and readers that all chunks of one call share. Many threads parse, the caller's thread combines."""

    def __init__(self) -> None:
        self._decoders: dict[tuple[str, int], Decoder] = {}
        self._readers: dict[tuple[str, int], ColumnReader | None] = {}

    def parse(self, cut: Cut) -> _ParsedCut:
        return _ParsedCut(cut, self._columns(cut))

    def _columns(self, cut: Cut) -> Block | None:
        reader, payloads = self._reader_of(cut), cut.messages.payloads
        arrays = None if reader is None else reader.read_exactly(payloads)
        times = None if arrays is None else arrays.get(TIME_KEY)
        if arrays is None or times is None or not pa.types.is_float64(times.type):
            return None
        if not bool(time_order.is_close(zero_copy.to_numpy(times), cut.times_ns).all()):
            return None
        return Block(len(payloads), {name: Column(array) for name, array in arrays.items()})

    def _reader_of(self, cut: Cut) -> ColumnReader | None:
        """Return a reader that makes columns of a channel's messages; None if all have to become Python objects."""
        key = rows.key_of(cut.origin)
        if key not in self._readers:
            codec = codec_of(cut.origin.channel)
            decoder = partial(rows.decoder_of, cut.origin, self._decoders)
            self._readers[key] = None if codec is None else codec.column_reader(decoder, None)
        return self._readers[key]

    def block(self, parts: list[_ParsedCut], low: float, high: float) -> Block | None:
        """Return the rows of some chunks as one block, if each is one and their time stamps differ."""
        blocks = [part.block for part in parts if part.block is not None]
        if len(blocks) < len(parts):
            return None
        whole = blocks[0] if len(blocks) == 1 else _joined(blocks)
        if whole is None:
            return None
        times = zero_copy.to_numpy(whole.columns[TIME_KEY].array)
        if not bool((times[:-1] < times[1:]).all()):
            order = np.argsort(times, kind="stable")
            whole, times = whole.take(order), times[order]
            if not bool((times[:-1] < times[1:]).all()):
                return None
        start, end = np.searchsorted(times, low, "left"), np.searchsorted(times, high, "right")
        return whole if end - start == whole.count else whole.slice(int(start), int(max(end - start, 0)))

    def rows(self, parts: list[_ParsedCut], low: float, high: float) -> list[Row]:
        """Return the rows of some chunks."""
        batch = topic_messages.merge([part.cut for part in parts])
        merged = rows.of_batch(batch, self._decoders)
        return [row for row in merged if low <= row[TIME_KEY] <= high]


def _joined(blocks: list[Block]) -> Block | None:
    """Put blocks of the same columns behind each other."""
    first = blocks[0].columns
    types = [{name: column.array.type for name, column in block.columns.items()} for block in blocks]
    if any(others != types[0] for others in types[1:]):
        return None
    arrays = {name: pa.concat_arrays([block.columns[name].array for block in blocks]) for name in first}
    return Block(sum(block.count for block in blocks), {name: Column(array) for name, array in arrays.items()})
