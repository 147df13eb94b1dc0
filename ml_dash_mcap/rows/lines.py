"""JSON rows, many at once, as flat Arrow columns; or nothing, where that would lose something.

pyarrow's reader is an order of magnitude faster than Python objects, but it guesses: it reads text that looks like a
time as one, integers beyond 64 bits as doubles, and a missing key like a null. Whatever it cannot say as
`rows.table` would say it is left to that.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.json as pj

from . import depth, same_bytes
from .columns import FIELD_PREFIX
from .encode import EXACT_KEY, TIME_KEY
from .table import tight

_EXACT_INTEGERS = 2.0**53
_MOST_BYTES = 2**31 - 2

_SIDE_KEY = pa.field(EXACT_KEY, pa.struct([]))
"""Tells the rows that have it from those that do not, without reading what is in it."""


_MANY_KEYS = 16
_TEXT = re.compile(rb'"(?:[^"\\]|\\.)*"')

_MOST_DEPTH = 100
_SURELY_SHALLOW_BYTES = 1000


def are_shallow(payloads: Sequence[bytes]) -> bool:
    """Whether pyarrow can read some JSON: it looks at no limit, and crashes where the stack ends."""
    if max(map(len, payloads), default=0) < _SURELY_SHALLOW_BYTES:
        return True
    return depth.are_within([one for one in payloads if len(one) >= _SURELY_SHALLOW_BYTES], _MOST_DEPTH)


class LineReader:
    """Reads the rows of one channel, some columns of them, and learns their types from one call to the next.

    Any thread may call it: what one learned too late is only learned again.
    """

    def __init__(self, columns: Sequence[str] | None = None) -> None:
        """Begin to read.

        Args:
            columns: Dotted names of those that will be wanted; None for all. Others may come back with them.
        """
        self._wanted = None if columns is None else _top_level_names(columns)
        self._known: dict[str, pa.DataType] = {}
        """Types that a key was found to have, by key."""
        self._texts: dict[str, pa.DataType] = {}
        """The part of them that is text, and must not be taken for times."""

    def read(self, lines: bytes, count: int) -> dict[str, pa.Array] | None:
        """Return the columns of rows, by dotted name, or None if only Python objects can hold them without loss.

        Whether rows have the side key is seen by a column of its name.

        Args:
            lines: One JSON object a line.
            count: How many.
        """
        if not 0 < len(lines) < _MOST_BYTES or not _is_utf8(lines):
            return None
        table = self._expected(lines) if self._wanted is None else self._projected(self._wanted, lines)
        flat = None if table is None else _flatten(table, count)
        if flat is None:
            table = self._inferred(lines)
            if table is None or (_has_structs(table) and _has_empty_dict(lines)):
                return None  # an empty dict leaves no trace beside others
            flat = _flatten(table, count)
        return flat

    def _expected(self, lines: bytes) -> pa.Table | None:
        """Read what the lines before had, in the types that it had: faster than to find out again.

        Returns:
            None if something else is there, or a key stands in the text and never has a value.
        """
        known = [name for name in self._known if name != EXACT_KEY]
        fields = [pa.field(name, self._known[name]) for name in _present(known, lines)]
        if not fields or any(_has(field.type, pa.types.is_null) for field in fields):
            return None
        table = _read(lines, pa.schema(fields), "error")
        if table is None or (_has_structs(table) and _has_empty_dict(lines)):
            return None
        return None if any(_says_nothing(chunk) for column in table.columns for chunk in column.chunks) else table

    def _projected(self, wanted: Sequence[str], lines: bytes) -> pa.Table | None:
        """Read the wanted keys only, if their types are known and can be relied upon."""
        fields = [_SIDE_KEY]
        for name in _present(wanted, lines):
            type_ = self._known.get(name)
            if type_ is None or _has(type_, _is_unsure):
                return None
            fields.append(pa.field(name, type_))
        return _read(lines, pa.schema(fields), "ignore")

    def _inferred(self, lines: bytes) -> pa.Table | None:
        table = _read(lines, pa.schema(list(self._texts.items())), "infer")
        if table is None:
            return None
        names = dict.fromkeys(table.column_names)
        misread = [field for field in table.schema if _has(field.type, pa.types.is_timestamp)]
        if misread:
            self._texts = {**self._texts, **{field.name: _only_texts(field.type) for field in misread}}
            table = _read(lines, pa.schema(list(self._texts.items())), "infer")
            if table is None:
                return None
        order = list(dict.fromkeys([*(name for name in self._known if name in names), *names]))
        self._known = {**self._known, **{name: table.schema.field(name).type for name in order}}
        return table.select(order)


def _present(names: Sequence[str], lines: bytes) -> list[str]:
    """Return those of some keys that stand somewhere in the lines, perhaps in a text.

    To search the lines for each of them would take a time that is quadratic in their number.
    """
    first = lines[: lines.find(b"\n") + 1] or lines
    try:
        row = orjson.loads(first)
    except orjson.JSONDecodeError:  # what only pyarrow takes for JSON
        row = None
    there = set(row) if isinstance(row, dict) else set()
    others = {name: orjson.dumps(name) for name in names if name not in there}
    if len(others) > _MANY_KEYS:
        texts = set(_TEXT.findall(lines))
        there.update(name for name, key in others.items() if key in texts)
    else:
        there.update(name for name, key in others.items() if key in lines)
    return [name for name in names if name in there]


def _is_utf8(lines: bytes) -> bool:
    """Whether bytes are UTF-8, which pyarrow takes for granted."""
    if lines.isascii():
        return True
    try:
        lines.decode()
    except UnicodeDecodeError:
        return False
    return True


def _top_level_names(columns: Iterable[str]) -> list[str]:
    """Return the keys of a row that columns with dotted names may lie under."""
    names = {TIME_KEY: None}
    for column in columns:
        for name in {column, column.removeprefix(FIELD_PREFIX)}:
            parts = name.split(".")
            names.update(dict.fromkeys(".".join(parts[:end]) for end in range(1, len(parts) + 1)))
    return list(names)


def _read(lines: bytes, schema: pa.Schema, unexpected: str) -> pa.Table | None:
    try:
        return pj.read_json(
            pa.BufferReader(lines),
            pj.ReadOptions(use_threads=False, block_size=len(lines) + 1),
            pj.ParseOptions(explicit_schema=schema, unexpected_field_behavior=unexpected),
        )
    except pa.ArrowException:
        return None


def _has(type_: pa.DataType, is_it: Any) -> bool:
    """Whether a type, or one inside it, is such a one."""
    return bool(is_it(type_)) or any(_has(type_.field(at).type, is_it) for at in range(type_.num_fields))


def _has_empty_dict(lines: bytes) -> bool:
    """Whether an empty dict stands somewhere, perhaps in a text; a search for it would keep other threads waiting."""
    for first in (0, 1):
        pairs = np.frombuffer(lines, "<u2", (len(lines) - first) // 2, first)
        if (pairs == int.from_bytes(b"{}", "little")).any():
            return True
    return b" " in lines and b"{ }" in lines


def _says_nothing(array: pa.Array) -> bool:
    """Whether an array, or that of a key in its dicts, has no value: the key may not be there at all."""
    if array.null_count == len(array):
        return True
    inner = array.values if pa.types.is_list(array.type) else array
    return bool(pa.types.is_struct(inner.type)) and any(map(_says_nothing, inner.flatten()))


def _has_structs(table: pa.Table) -> bool:
    return any(_has(type_, pa.types.is_struct) for type_ in table.schema.types)


def _is_broken(type_: pa.DataType) -> bool:
    """Whether it is a list of nothing but nulls, for which pyarrow 26 makes arrays whose offsets lead out of them."""
    return bool(pa.types.is_list(type_)) and _has(type_.value_type, pa.types.is_null)


def _is_unsure(type_: pa.DataType) -> bool:
    """Whether a chunk's type says too little about the next one's: a struct may get more keys, a null anything."""
    return bool(pa.types.is_null(type_) or pa.types.is_struct(type_))


def _only_texts(type_: pa.DataType) -> pa.DataType:
    """Return the part of a type that is text, with what was taken for times as text."""
    if pa.types.is_struct(type_):
        inner = [type_.field(at) for at in range(type_.num_fields)]
        texts = [field for field in inner if _has(field.type, _is_text)]
        return pa.struct([pa.field(field.name, _only_texts(field.type)) for field in texts])
    if pa.types.is_list(type_):
        return pa.list_(_only_texts(type_.value_type))
    return pa.string()


def _is_text(type_: pa.DataType) -> bool:
    return bool(pa.types.is_timestamp(type_) or pa.types.is_string(type_))


# -- from what pyarrow makes of rows to the columns that `rows.table` would make of them ------------------------------


def _flatten(table: pa.Table, count: int) -> dict[str, pa.Array] | None:
    if table.num_rows != count:  # a payload was empty, or had lines in it
        return None
    if any(_has(type_, _is_broken) for type_ in table.schema.types):
        return None
    flat: dict[str, pa.Array] = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        array = column.combine_chunks()
        if isinstance(array, pa.ChunkedArray):  # pyarrow before 15, for one chunk
            array = array.chunk(0)
        if not _put(flat, name, array):
            return None
    return flat


def _put(flat: dict[str, pa.Array], name: str, array: pa.Array) -> bool:
    """Add a column, a struct's keys as columns of their own; returns whether that lost nothing."""
    if name == EXACT_KEY:
        if array.null_count < len(array):
            flat[name] = pc.is_valid(array)
        return True
    if pa.types.is_struct(array.type):
        inner = zip([array.type.field(at).name for at in range(array.type.num_fields)], array.flatten(), strict=True)
        return array.type.num_fields > 0 and all(_put(flat, f"{name}.{key}", child) for key, child in inner)
    if name in flat or not _is_exact(array):
        return False
    flat[name] = tight(array)
    return True


def _is_exact(array: pa.Array) -> bool:
    """Whether an array holds the values exactly in which `rows.table` would put them."""
    type_ = array.type
    if pa.types.is_floating(type_):
        return _is_safe(array)
    if pa.types.is_list(type_):
        return _is_exact(array.flatten())
    if pa.types.is_struct(type_):  # in a list; a key may be missing here or there
        children = array.flatten()
        return bool(children) and all(not child.null_count and _is_exact(child) for child in children)
    return not pa.types.is_timestamp(type_)


def _is_safe(array: pa.Array) -> bool:
    """Whether no value can have been an integer that a double rounds."""
    values = same_bytes.to_numpy(array.drop_null() if array.null_count else array)
    return not len(values) or bool(values.min() > -_EXACT_INTEGERS and values.max() < _EXACT_INTEGERS)
