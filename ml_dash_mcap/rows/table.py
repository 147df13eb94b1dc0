"""Builds an Arrow table of rows that loses nothing, whatever the rows hold."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import orjson
import pyarrow as pa

from . import typed_columns, zero_copy
from .plain_row import TIME_KEY, encodable
from .typed_columns import ENCODING_KEY, Column, tight

Row = dict[str, Any]

BLOCK_ROWS = 8192
"""Rows are turned into columns by so many at a time, which is faster than holding all as Python objects."""


@dataclass(frozen=True, slots=True)
class Block:
    """Some rows, as columns."""

    count: int
    columns: dict[str, Column]

    def take(self, which: npt.NDArray[np.intp]) -> Block:
        """Return some of the rows, in the order given."""
        indices = zero_copy.to_arrow(which)
        return self._changed(len(which), lambda array: array.take(indices))

    def slice(self, start: int, count: int) -> Block:
        """Return the rows from a number on, without a copy."""
        return self._changed(count, lambda array: array.slice(start, count))

    def _changed(self, count: int, change: Callable[[Any], Any]) -> Block:
        columns = {name: Column(change(column.array), column.is_text) for name, column in self.columns.items()}
        return Block(count, columns)


def block_of(rows: list[Row]) -> Block:
    r"""Turn flat rows into columns; in names, lone surrogates are spelled `\udc00`, because UTF-8 has none."""
    return Block(
        len(rows), {encodable(name): typed_columns.of_python(values) for name, values in _collect(rows).items()}
    )


def join(blocks: Sequence[Block]) -> Block:
    """Put blocks behind each other: the columns of all of them, each in the type that holds all its values."""
    names = dict.fromkeys(name for block in blocks for name in block.columns)
    columns: dict[str, Column] = {}
    for name in names:
        parts = [block.columns.get(name) or Column(pa.nulls(block.count)) for block in blocks]
        columns[name] = parts[0] if len(parts) == 1 else typed_columns.joined(parts)
    parents = {name[:at] for name in names for at, letter in enumerate(name) if letter == "."}
    for name in parents & set(columns):
        if pa.types.is_null(columns[name].array.type):  # a dict that is None here and there
            del columns[name]
    return Block(sum(block.count for block in blocks), columns)


def to_table(blocks: Sequence[Block], *, time_name: str = TIME_KEY, topic: str | None = None) -> pa.Table:
    """Return blocks as one table with a column for each field, in the order in which the fields first appear.

    A field that a row does not have, or has as None, is null. Booleans, text, bytes and numbers are what they are
    (integers are int64 or uint64, and double only beside fractions, when all are below 2**53); lists of one kind are
    lists, of fixed size if they are vectors of one length; dicts of the same keys in lists are structs. A column whose
    values fit no common type is JSON text, and its metadata says so.

    Args:
        blocks: One behind the other.
        time_name: The column for the time stamps, a double in seconds; comes first.
        topic: For the table's metadata.
    """
    columns = join(blocks).columns
    times = columns.pop(time_name, Column(pa.chunked_array([], pa.float64())))
    columns = {name: Column(_tight(column.array), column.is_text) for name, column in columns.items()}
    columns = {time_name: Column(times.array.cast(pa.float64())), **columns}
    fields = [
        pa.field(name, column.array.type, name != time_name, {ENCODING_KEY: b"json"} if column.is_text else None)
        for name, column in columns.items()
    ]
    about = {"ml_dash": orjson.dumps({"time": time_name, "topic": topic})}
    return pa.table([column.array for column in columns.values()], schema=pa.schema(fields, metadata=about))


def tables_of_size(
    blocks: Iterable[Block], rows: int, *, time_name: str = TIME_KEY, topic: str | None = None
) -> Iterator[pa.Table]:
    """Yield tables of `rows` rows; the last table has the rest.

    Args:
        blocks: One behind the other.
        rows: 1 or more.
        time_name: The column of time stamps.
        topic: For the tables' metadata.
    """
    waiting: list[Block] = []
    count = 0
    for block in blocks:
        at = 0
        while count + block.count - at >= rows:
            waiting.append(block.slice(at, rows - count))
            at += rows - count
            yield to_table(waiting, time_name=time_name, topic=topic)
            waiting, count = [], 0
        if at < block.count:
            waiting.append(block.slice(at, block.count - at))
            count += block.count - at
    if waiting:
        yield to_table(waiting, time_name=time_name, topic=topic)


def _collect(block: list[Row]) -> dict[str, list[Any]]:
    """Turn rows into columns; a field that a row does not have is None."""
    columns: dict[str, list[Any]] = {}
    for number, row in enumerate(block):
        for name, value in row.items():
            column = columns.get(name)
            if column is None:
                column = columns[name] = [None] * number
            elif len(column) < number:
                column += [None] * (number - len(column))
            column.append(value)
    for column in columns.values():
        column += [None] * (len(block) - len(column))
    return columns


def _tight(array: Any) -> Any:
    """Give lists their fixed size, where a row that is not here any more had kept them from it."""
    if not pa.types.is_list(array.type):
        return array
    parts = [Column(tight(chunk)) for chunk in (array.chunks if isinstance(array, pa.ChunkedArray) else [array])]
    return typed_columns.joined(parts).array if parts else array
