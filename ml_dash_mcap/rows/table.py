"""Rows as an Arrow table that loses nothing, whatever the rows hold."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import chain, islice
from typing import Any, NamedTuple

import orjson
import pyarrow as pa

from .encode import EXACT_KEY, TIME_KEY, exact, restore

Row = dict[str, Any]

ENCODING_KEY = b"ml_dash.encoding"
"""Metadata of a column whose values are JSON text, because no one Arrow type holds them all: `json`."""

VALUE_KEY = "_value"
"""Holds a value with NaN, infinities or bytes in it in a JSON text column, beside the side key `_exact`."""

BLOCK_ROWS = 8192
"""Rows are turned into columns by so many at a time, which is faster than holding all as Python objects."""

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
    parts: dict[str, list[_Part]] = {time_name: []}
    done = 0
    rows = iter(rows)
    while block := list(islice(rows, BLOCK_ROWS)):
        columns = _collect(block)
        for name in columns:
            if name not in parts:
                parts[name] = [_Part(pa.nulls(done))]
        for name, column in parts.items():
            values = columns.get(name)
            column.append(_Part(pa.nulls(len(block))) if values is None else _part(values))
        done += len(block)
    joined = {name: _join(column) for name, column in parts.items()}
    joined[time_name] = _Part(pa.chunked_array([part.array for part in parts[time_name]], type=pa.float64()))
    fields = [
        pa.field(name, part.array.type, name != time_name, {ENCODING_KEY: b"json"} if part.is_text else None)
        for name, part in joined.items()
    ]
    about = {"ml_dash": orjson.dumps({"time": time_name, "topic": topic})}
    return pa.table([part.array for part in joined.values()], schema=pa.schema(fields, metadata=about))


class _Part(NamedTuple):
    """Some rows of a column."""

    array: Any
    is_text: bool = False


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


def _part(values: list[Any]) -> _Part:
    type_ = arrow_type(values)
    if type_ is not None:
        return _Part(pa.array(values, type=type_))
    return _Part(pa.array([None if value is None else _to_text(value) for value in values], type=pa.string()), True)


def _join(parts: list[_Part]) -> _Part:
    """Join a column's parts; where their types differ, from their values, which each part holds without loss."""
    types = {part.array.type for part in parts if not pa.types.is_null(part.array.type)}
    has_gap = any(pa.types.is_null(part.array.type) for part in parts) and any(map(pa.types.is_nested, types))
    if has_gap or len({(part.array.type, part.is_text) for part in parts if part.array.type in types}) > 1:
        joined = _part([value for part in parts for value in _values(part)])
        return _Part(pa.chunked_array([joined.array]), joined.is_text)
    type_ = types.pop() if types else pa.null()
    arrays = [pa.nulls(len(part.array), type_) if part.array.type != type_ else part.array for part in parts]
    return _Part(pa.chunked_array(arrays, type=type_), any(part.is_text for part in parts))


def _values(part: _Part) -> list[Any]:
    values: list[Any] = part.array.to_pylist()
    return [None if text is None else _from_text(text) for text in values] if part.is_text else values


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
    if not names or any(list(one) != names for one in dicts):
        return None
    nothing = [None] if has_nulls else []
    types = {name: arrow_type([*(one[name] for one in dicts), *nothing]) for name in names}
    if any(type_ is None for type_ in types.values()):
        return None
    return pa.struct([pa.field(name, type_) for name, type_ in types.items()])


def _to_text(value: Any) -> str:
    """Say a value as JSON; one that JSON cannot say is wrapped as `{"_value": ..., "_exact": ...}`."""
    row = orjson.loads(exact({VALUE_KEY: value}, ""))
    row.pop(TIME_KEY, None)
    return orjson.dumps(row if EXACT_KEY in row else row[VALUE_KEY]).decode()


def _from_text(text: str) -> Any:
    value = orjson.loads(text)
    return restore(value)[VALUE_KEY] if isinstance(value, dict) and EXACT_KEY in value else value
