"""One topic's rows as columns where columns say exactly what the rows said, and as rows elsewhere.

In columns a field that a row lacks looks like one that is None, an integer among fractions like a double, a key with
a dot like a dict in a dict. Formats that give back what was recorded must tell these apart. That a block has none of
them can be proven from its bytes: it has no nulls, no key with a dot, and as many dots as doubles.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import orjson
import pyarrow as pa
import pyarrow.compute as pc

from ..codecs.decode import Decoder, Row
from ..codecs.json_lines import LineReader, joined
from ..rows import zero_copy
from ..rows.encode import TIME_KEY
from ..rows.table import Block
from ..rows.typed_columns import Column
from . import time_order, topic_messages
from . import topic_rows as rows
from .stored_topic import StoredTopic
from .topic_messages import Cut

_DOT = ord(".")


@dataclass(frozen=True, slots=True)
class _Part:
    """The messages that were cut out of a chunk, and the columns that say the same, if there are any."""

    cut: Cut
    block: Block | None

    @property
    def times_ns(self) -> npt.NDArray[np.uint64]:
        """Their log times."""
        return self.cut.times_ns

    def pick(self, which: npt.NDArray[np.intp]) -> _Part:
        """Return some of them."""
        return _Part(self.cut.pick(which), None if self.block is None else self.block.take(which))


def read(topic: StoredTopic, low: float = -math.inf, high: float = math.inf) -> Iterator[Block | list[Row]]:
    """Read a topic's rows with time stamps in [low, high].

    They are what `rows.read` yields, in its order. Memory holds a few chunks, not the topic.

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
        found = block if block is not None else reading.rows(parts, low, high)
        if size(found):
            yield found


def size(part: Block | list[Row]) -> int:
    """Return how many rows there are."""
    return len(part) if isinstance(part, list) else part.count


class _Reading:
    """What all chunks of one call have in common. Threads parse; the caller's combines."""

    def __init__(self) -> None:
        self._decoders: dict[tuple[str, int], Decoder] = {}
        self._readers: dict[tuple[str, int], LineReader] = {}

    def parse(self, cut: Cut) -> _Part:
        return _Part(cut, self._parse(cut) if cut.origin.channel.message_encoding == "json" else None)

    def _parse(self, cut: Cut) -> Block | None:
        payloads = cut.messages.payloads
        lines = joined(payloads)
        if lines is None:
            return None
        key = rows.key_of(cut.origin)
        reader = self._readers.get(key)
        if reader is None:
            reader = self._readers[key] = LineReader()
        flat = reader.read(lines)
        if flat is None or not _says_all(lines.text, flat):
            return None
        times = flat.get(TIME_KEY)
        if times is None or not pa.types.is_float64(times.type):
            return None
        if not bool(time_order.is_close(zero_copy.to_numpy(times), cut.times_ns).all()):
            return None
        return Block(len(payloads), {name: Column(array) for name, array in flat.items()})

    def block(self, parts: list[_Part], low: float, high: float) -> Block | None:
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

    def rows(self, parts: list[_Part], low: float, high: float) -> list[Row]:
        """Return the rows of some chunks."""
        batch = topic_messages.merge([part.cut for part in parts])
        found = rows.of_batch(batch, self._decoders)
        return [row for row in found if low <= row[TIME_KEY] <= high]


def _joined(blocks: list[Block]) -> Block | None:
    """Put blocks of the same columns behind each other."""
    first = blocks[0].columns
    types = [{name: one.array.type for name, one in block.columns.items()} for block in blocks]
    if any(found != types[0] for found in types[1:]):
        return None
    arrays = {name: pa.concat_arrays([block.columns[name].array for block in blocks]) for name in first}
    return Block(sum(block.count for block in blocks), {name: Column(array) for name, array in arrays.items()})


def _says_all(lines: bytes, flat: dict[str, Any]) -> bool:
    """Whether columns have no null, no key with a dot, and no double that was written without one, as integers are."""
    if any(orjson.dumps(key) in lines for name in flat for key in _keys_with_dots(name)):
        return False
    dots = 0
    for array in flat.values():
        found = _dots(array)
        if found is None:
            return False
        dots += found
    return dots == int(np.count_nonzero(np.frombuffer(lines, np.uint8) == _DOT))


def _keys_with_dots(name: str) -> Iterator[str]:
    """Yield what may be one key in a dotted name."""
    parts = name.split(".")
    for start in range(len(parts)):
        for end in range(start + 2, len(parts) + 1):
            yield ".".join(parts[start:end])


def _dots(array: Any) -> int | None:
    """Return how many dots the JSON of an array's values has if all its doubles have one; None if there is a null."""
    type_ = array.type
    if array.null_count or pa.types.is_null(type_):
        return None
    if pa.types.is_floating(type_):
        return len(array)
    if pa.types.is_string(type_):
        return int(pc.sum(pc.count_substring(array, ".")).as_py() or 0)
    if not type_.num_fields:
        return 0
    if any("." in type_.field(at).name for at in range(type_.num_fields)):
        return None
    found = [_dots(inner) for inner in ([*array.flatten()] if pa.types.is_struct(type_) else [array.flatten()])]
    return None if None in found else sum(one for one in found if one is not None)
