"""Rows as an Arrow table that loses nothing, whatever the rows hold."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import orjson
import pyarrow as pa
import pyarrow.compute as pc

from . import array_lists, zero_copy
from .encode import EXACT_KEY, TIME_KEY, encodable
from .json_text import dumps_any, exact_as_read, loads_any, restore

Row = dict[str, Any]

ENCODING_KEY = b"ml_dash.encoding"
"""Metadata of a column whose values are JSON text, because no one Arrow type holds them all: `json`."""

VALUE_KEY = "_value"
"""Holds a value with NaN, infinities or bytes in it in a JSON text column, beside the side key `_exact`."""

BLOCK_ROWS = 8192
"""Rows are turned into columns by so many at a time, which is faster than holding all as Python objects."""

_MOST_LEVELS = 40
"""Of the 100 that pyarrow reads from a Parquet file; some are left for the dicts that a column lies in."""

_SAFE_INT = 2**53
_INT64 = (-(2**63), 2**63 - 1)


def from_rows(rows: Iterable[Row], *, time_name: str = TIME_KEY, topic: str | None = None) -> pa.Table:
    """Build a table with one column a field, in the order in which the fields first appear.

    A field that a row does not have, or has as None, is null. Booleans, text, bytes and numbers are what they are
    (integers are int64 or uint64, and double only beside fractions, when all are below 2**53); lists of one kind are
    lists, of fixed size if they are vectors of one length; dicts of the same keys in lists are structs. A column whose
    values fit no common type is JSON text, and its metadata says so.

    Args:
        rows: Flat rows.
        time_name: The column for the time stamps, a double in seconds; comes first.
        topic: For the table's metadata.
    """
    rows = iter(rows)
    blocks: list[Block] = []
    while block := list(islice(rows, BLOCK_ROWS)):
        blocks.append(block_of(block))
    return to_table(blocks, time_name=time_name, topic=topic)


class Column(NamedTuple):
    """One column of some rows."""

    array: Any
    """A pyarrow Array or ChunkedArray."""
    is_text: bool = False
    """Whether it holds JSON text instead of its values."""


@dataclass(frozen=True, slots=True)
class Block:
    """Some rows, as columns."""

    count: int
    columns: dict[str, Column]

    def take(self, which: npt.NDArray[np.intp]) -> Block:
        """Return some of the rows, in the order given."""
        indices = zero_copy.to_arrow(which)
        return Block(
            len(which), {name: Column(one.array.take(indices), one.is_text) for name, one in self.columns.items()}
        )

    def slice(self, start: int, count: int) -> Block:
        """Return the rows from a number on, without a copy."""
        return Block(
            count, {name: Column(one.array.slice(start, count), one.is_text) for name, one in self.columns.items()}
        )


def block_of(rows: list[Row]) -> Block:
    r"""Turn flat rows into columns; in names, lone surrogates are spelled `\udc00`, because UTF-8 has none."""
    return Block(len(rows), {encodable(name): _column(values) for name, values in _collect(rows).items()})


def join(blocks: Sequence[Block]) -> Block:
    """Put blocks behind each other: the columns of all of them, each in the type that holds all its values."""
    names = dict.fromkeys(name for block in blocks for name in block.columns)
    joined: dict[str, Column] = {}
    for name in names:
        parts = [block.columns.get(name) or Column(pa.nulls(block.count)) for block in blocks]
        joined[name] = parts[0] if len(parts) == 1 else _join(parts)
    parents = {name[:at] for name in names for at, letter in enumerate(name) if letter == "."}
    for name in parents & set(joined):
        if pa.types.is_null(joined[name].array.type):  # a dict that is None here and there
            del joined[name]
    return Block(sum(block.count for block in blocks), joined)


def to_table(blocks: Sequence[Block], *, time_name: str = TIME_KEY, topic: str | None = None) -> pa.Table:
    """Return blocks as one table, the time stamps first; the arguments are those of `from_rows`."""
    columns = join(blocks).columns
    times = columns.pop(time_name, Column(pa.chunked_array([], pa.float64())))
    columns = {name: Column(_tight(one.array), one.is_text) for name, one in columns.items()}
    columns = {time_name: Column(times.array.cast(pa.float64())), **columns}
    fields = [
        pa.field(name, one.array.type, name != time_name, {ENCODING_KEY: b"json"} if one.is_text else None)
        for name, one in columns.items()
    ]
    about = {"ml_dash": orjson.dumps({"time": time_name, "topic": topic})}
    return pa.table([one.array for one in columns.values()], schema=pa.schema(fields, metadata=about))


def tables_of_size(
    blocks: Iterable[Block], rows: int, *, time_name: str = TIME_KEY, topic: str | None = None
) -> Iterator[pa.Table]:
    """Yield tables of `rows` rows, the last one of what is left.

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
    """Turn rows into columns; what a row does not have is None."""
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


def _column(values: list[Any]) -> Column:
    if array_lists.has_arrays(values):
        array = array_lists.of(values)
        if array is not None:
            return Column(array)
        values = array_lists.lists(values)
    with contextlib.suppress(UnicodeEncodeError):  # text with lone surrogates
        type_ = arrow_type(values)
        if type_ is not None and is_shallow(type_):
            return Column(pa.array(values, type=type_))
    return Column(pa.array([None if value is None else to_text(value) for value in values], type=pa.string()), True)


def _join(parts: list[Column]) -> Column:
    """Join a column's parts; where no type holds the values of all, from the values."""
    if len({part.is_text for part in parts if not pa.types.is_null(part.array.type)}) <= 1:
        type_ = functools.reduce(_common, (part.array.type for part in parts), pa.null())
        if type_ is not None:
            if pa.types.is_fixed_size_list(type_) and any(pa.types.is_null(part.array.type) for part in parts):
                type_ = pa.list_(type_.value_type)  # pyarrow before 26 cannot read nulls among those of fixed size
            with contextlib.suppress(pa.ArrowInvalid):  # an integer that a double would round
                arrays = [array for part in parts for array in _cast(part.array, type_)]
                return Column(pa.chunked_array(arrays, type=type_), any(part.is_text for part in parts))
    whole = _column([value for part in parts for value in values_of(part)])
    return Column(pa.chunked_array([whole.array]), whole.is_text)


def _cast(array: Any, type_: pa.DataType) -> list[Any]:
    if pa.types.is_null(array.type):
        return [pa.nulls(len(array), type_)]
    if array.type != type_:
        array = array.cast(type_)
    return list(array.chunks) if isinstance(array, pa.ChunkedArray) else [array]


def _common(first: pa.DataType | None, second: pa.DataType) -> pa.DataType | None:
    """Return the type that can hold the values of two, or None."""
    if first is None or first == second or pa.types.is_null(second):
        return first
    if pa.types.is_null(first):
        return second
    if {first, second} == {pa.int64(), pa.float64()}:
        return pa.float64()
    if _is_list(first) and _is_list(second):
        inner = _common(first.value_type, second.value_type)
        if inner is None:
            return None
        is_fixed = pa.types.is_fixed_size_list(first) and pa.types.is_fixed_size_list(second)
        return pa.list_(inner, first.list_size) if is_fixed and first.list_size == second.list_size else pa.list_(inner)
    return array_lists.wider(first, second)


def _tight(array: Any) -> Any:
    """Give lists their fixed size, where a row that is not here any more had kept them from it."""
    if not pa.types.is_list(array.type):
        return array
    parts = [Column(tight(chunk)) for chunk in (array.chunks if isinstance(array, pa.ChunkedArray) else [array])]
    return _join(parts).array if parts else array


def tight(array: pa.Array) -> pa.Array:
    """Return the same values with a fixed size for lists of numbers that all have one length, inner lists too."""
    type_ = array.type
    if pa.types.is_struct(type_) and type_.num_fields and not array.null_count:  # null ones have no list of any size
        children = [tight(child) for child in array.flatten()]
        if [child.type for child in children] == [type_.field(at).type for at in range(type_.num_fields)]:
            return array
        names = [type_.field(at).name for at in range(type_.num_fields)]
        return pa.StructArray.from_arrays(children, names)
    if not pa.types.is_list(type_) or not len(array):
        return array
    inner, has_gaps = tight(array.flatten()), array.null_count > 0
    each = pc.fill_null(pc.list_value_length(array), 0) if has_gaps else None
    lengths = np.diff(zero_copy.to_numpy(array.offsets)) if each is None else zero_copy.to_numpy(each)
    if (pa.types.is_integer(inner.type) or pa.types.is_floating(inner.type)) and len(inner) and not has_gaps:
        size = int(lengths[0])
        if len(inner) == size * len(array) and (lengths == size).all():
            return pa.FixedSizeListArray.from_arrays(inner, size)
    if inner.type == type_.value_type:
        return array
    offsets = zero_copy.to_arrow(np.concatenate(([0], np.cumsum(lengths))).astype(np.int32))
    return pa.ListArray.from_arrays(offsets, inner, mask=pc.is_null(array) if has_gaps else None)


def _is_list(type_: pa.DataType) -> bool:
    return bool(pa.types.is_list(type_) or pa.types.is_fixed_size_list(type_))


def values_of(part: Column) -> list[Any]:
    """Return a column's values as Python objects, those that are JSON text decoded."""
    values: list[Any] = part.array.to_pylist()
    return [None if text is None else from_text(text) for text in values] if part.is_text else values


def arrow_type(values: list[Any]) -> pa.DataType | None:
    """Return the type that holds all values without loss, or None where there is none."""
    kinds = set(map(type, values)) - {type(None)}
    if not kinds:
        return pa.null()
    if kinds == {list}:
        return _list_type([value for value in values if value is not None], None in values)
    if kinds == {dict}:
        return _struct_type([value for value in values if value is not None], None in values)
    if kinds <= {int, float}:
        return _number_type(values, kinds)
    if len(kinds) == 1:
        return _SIMPLE.get(kinds.pop())
    return None


def is_shallow(type_: pa.DataType) -> bool:
    """Whether a type is nested so little that Parquet's readers take it; deeper values are JSON text."""
    return _levels(type_) <= _MOST_LEVELS


def _levels(type_: pa.DataType) -> int:
    """Return how many levels a type has in a Parquet file: two for a list, one for a dict."""
    inner = max((_levels(type_.field(at).type) for at in range(type_.num_fields)), default=0)
    return inner + (2 if _is_list(type_) else 1)


_SIMPLE = {bool: pa.bool_(), str: pa.string(), bytes: pa.binary()}


def _number_type(values: list[Any], kinds: set[type]) -> pa.DataType | None:
    if kinds == {float}:
        return pa.float64()
    integers = [value for value in values if type(value) is int]
    low, high = min(integers), max(integers)
    if kinds == {int, float}:
        return pa.float64() if -_SAFE_INT <= low <= high <= _SAFE_INT else None
    if _INT64[0] <= low and high <= _INT64[1]:
        return pa.int64()
    return pa.uint64() if low >= 0 and high < 2**64 else None


def _list_type(lists: list[list[Any]], has_nulls: bool) -> pa.DataType | None:
    """Return a list's type; of fixed size only without nulls, which pyarrow before 26 cannot read back then."""
    elements = list(chain.from_iterable(lists))
    inner = arrow_type(elements)
    if inner is None:
        return None
    lengths = set(map(len, lists))
    is_vector = pa.types.is_integer(inner) or pa.types.is_floating(inner)
    if len(lengths) == 1 and is_vector and not has_nulls:
        return pa.list_(inner, lengths.pop())
    return pa.list_(inner)


def _struct_type(dicts: list[Row], has_nulls: bool) -> pa.DataType | None:
    names = list(dicts[0])
    if not names or any(one.keys() != dicts[0].keys() for one in dicts):
        return None
    nothing = [None] if has_nulls else []
    types = {name: arrow_type([*(one[name] for one in dicts), *nothing]) for name in names}
    if any(type_ is None for type_ in types.values()):
        return None
    return pa.struct([pa.field(name, type_) for name, type_ in types.items()])


def to_text(value: Any) -> str:
    """Say a value as JSON; one that JSON cannot say is wrapped as `{"_value": ..., "_exact": ...}`."""
    with contextlib.suppress(TypeError):  # bytes, arrays and lone surrogates
        text = orjson.dumps(value)
        if b"null" not in text:
            return text.decode()
    row = loads_any(exact_as_read({VALUE_KEY: value}))
    row.pop(TIME_KEY, None)
    return dumps_any(row if EXACT_KEY in row else row[VALUE_KEY]).decode()


def from_text(text: str) -> Any:
    """Return the value that `to_text` said."""
    value = loads_any(text)
    return restore(value)[VALUE_KEY] if isinstance(value, dict) and EXACT_KEY in value else value
