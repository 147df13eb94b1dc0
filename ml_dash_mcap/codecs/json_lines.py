"""Reads many JSON rows at once as flat Arrow columns, or nothing where that would lose something.

pyarrow's reader is an order of magnitude faster than Python objects, but it must be watched: it crashes where a line is
`null` or nested too deep, reads a missing key like a null, and integers among fractions as doubles. The types that it
finds by itself are not right either, so it reads in those that `line_types` has learnt. Whatever it cannot say as
`rows.table` would say it is left to that.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.json as pj

from ..rows.dotted import FIELD_PREFIX
from ..rows.plain_row import EXACT_KEY, TIME_KEY
from ..rows.shape import Shape
from . import json_depth, json_line_types
from .json_line_columns import flatten
from .json_line_types import Types

# pyarrow gives a block's size 32 bits, and the block has a byte more than the text.
_MOST_BYTES = 2**31 - 2

_EXACT = f'"{EXACT_KEY}"'.encode()
_SIDE_KEY = pa.field(EXACT_KEY, pa.struct([]))
"""This field tells the rows that have the side key from the others, without reading its content."""

_FIRST, _LAST = itemgetter(0), itemgetter(-1)
_BEGIN, _END = {ord("{")}, {ord("}")}

_FEW = 16
"""Rows that mostly tell the types of all; if they do not, the others are looked at too."""

_MANY_KEYS = 16
_TEXT = re.compile(rb'"(?:[^"\\]|\\.)*"')
_BLANK_DICT = re.compile(rb"\{[ \t\r\n]+\}")

_MOST_DEPTH = 100
# A shorter row has no room for brackets that would end the stack.
_SURELY_SHALLOW_BYTES = 1000


class Lines(NamedTuple):
    """Payloads that a `LineReader` can be given."""

    text: bytes
    """The payloads, one behind the other, with a newline between two of them."""
    payloads: Sequence[bytes]


def joined(payloads: Sequence[bytes]) -> Lines | None:
    """Return JSON payloads as lines; None where pyarrow must not see them.

    It crashes, without an error, where a line is `null` and where lists are nested until the stack ends. It takes two
    objects in one payload for two rows, passes over a byte order mark, and does not look whether text is UTF-8.
    """
    text = b"\n".join(payloads)
    is_safe = 0 < len(text) < _MOST_BYTES and _look_like_dicts(payloads) and _are_shallow(payloads)
    return Lines(text, payloads) if is_safe and _is_utf8(text) else None


def _look_like_dicts(payloads: Sequence[bytes]) -> bool:
    """Whether each payload begins and ends as a JSON object does.

    If a parser then takes all of them for as many objects as there are payloads, each is one: no object can go on
    from one payload to the next, because `}` is never followed by `{` inside one.
    """
    if all(payloads) and {*map(_FIRST, payloads)} == _BEGIN and {*map(_LAST, payloads)} == _END:
        return True
    return all(text.startswith(b"{") and text.endswith(b"}") for text in map(bytes.strip, payloads))


def _are_shallow(payloads: Sequence[bytes]) -> bool:
    if max(map(len, payloads)) < _SURELY_SHALLOW_BYTES:
        return True
    return json_depth.are_within(
        [payload for payload in payloads if len(payload) >= _SURELY_SHALLOW_BYTES], _MOST_DEPTH
    )


def _is_utf8(text: bytes) -> bool:
    if text.isascii():
        return True
    try:
        text.decode()
    except UnicodeDecodeError:
        return False
    return True


class LineReader:
    """Reads the rows of one channel, some columns of them, and learns their types from one call to the next.

    Any thread may call it. If two threads learn the same types at once, nothing but time is lost.
    """

    def __init__(self, columns: Sequence[str] | None = None) -> None:
        """Begin to read.

        Args:
            columns: Dotted names of the wanted columns; None for all. Other columns may come back with them.
        """
        self._places = [] if columns is None else [_top_level_names(column) for column in columns]
        """For each column, the top-level keys under which it may lie."""
        self._wanted = None if columns is None else list(dict.fromkeys(chain([TIME_KEY], *self._places)))
        self._shapes: dict[str, Shape] = {}
        self._types: Types = {}
        """The shapes of the values of the lines so far by key, and the types of these."""

    def read(self, lines: Lines) -> dict[str, pa.Array] | None:
        """Return the columns of rows, by dotted name, or None if only Python objects can hold them without loss.

        Rows with the side key need Python objects.
        """
        if not self._types:
            self._learn(_some_rows(lines.payloads))
        flat = self._expected(lines)
        return self._learned(lines) if flat is None and _EXACT not in lines.text else flat

    def _expected(self, lines: Lines) -> dict[str, pa.Array] | None:
        """Read the fields of the lines before, in the types that they had. That is faster than finding the types again.

        Returns:
            None if something else is there, or if a key that seems to be there may not be.
        """
        names = list(self._types) if self._wanted is None else self._wanted
        first = _first_row(lines)
        types = {name: self._types.get(name) for name in _present(names, first, lines.text)}
        expected = {name: type_ for name, type_ in types.items() if type_ is not None}
        if not expected or len(expected) < len(types) or not self._are_sure(expected):
            return None
        flat = self._flat(lines, expected, are_own=False)
        if flat is None or not _has_all(first, [name for name, array in flat.items() if pa.types.is_null(array.type)]):
            return None
        return flat

    def _are_sure(self, types: Mapping[str, pa.DataType]) -> bool:
        """Whether types tell of anything else: where only some columns are read, a dict's further keys are not seen."""
        return self._wanted is None or not any(
            json_line_types.has(type_, pa.types.is_struct) for type_ in types.values()
        )

    def _learned(self, lines: Lines) -> dict[str, pa.Array] | None:
        """Read lines in the types that their own values have."""
        if None in self._learn(_some_rows(lines.payloads)).values():  # types that do not hold some rows do not hold all
            return None
        rows = _decoded(lines.payloads)
        if rows is None or any(EXACT_KEY in row for row in rows):  # spelled with escapes
            return None
        own = self._learn(rows)
        types = {name: type_ for name, type_ in own.items() if type_ is not None}
        return None if len(types) < len(own) or self._is_ambiguous(types) else self._flat(lines, types, are_own=True)

    def _learn(self, rows: Sequence[Mapping[str, Any]]) -> Types:
        """Return the types of rows, and remember for the next lines the types that hold all rows so far."""
        shapes = json_line_types.shapes_of(rows, self._wanted)
        joined = {name: json_line_types.widened(self._shapes.get(name), shapes[name]) for name in shapes}
        self._shapes = {**self._shapes, **joined}
        self._types = json_line_types.types_of(self._shapes)
        return json_line_types.types_of(shapes)

    def _is_ambiguous(self, types: Mapping[str, pa.DataType]) -> bool:
        """Whether a column may be a key with dots in one row and lie in dicts in another, or in the same."""
        if any(len(types.keys() & places) > 1 for places in self._places):
            return True
        return bool(self._places) and any(map(json_line_types.has_key_with_dot, types.values()))

    def _flat(self, lines: Lines, types: Mapping[str, pa.DataType], *, are_own: bool) -> dict[str, pa.Array] | None:
        has_dicts = any(json_line_types.has(type_, pa.types.is_struct) for type_ in types.values())
        if has_dicts and not are_own and _has_empty_dict(lines.text):
            return None  # pyarrow leaves no trace of an empty dict beside other dicts
        fields = [pa.field(name, json_line_types.readable(type_)) for name, type_ in types.items()]
        is_all = self._wanted is None
        table = _read(lines.text, fields if is_all else [*fields, _SIDE_KEY], "error" if is_all else "ignore")
        if table is None or table.num_rows != len(lines.payloads):  # a payload held several rows
            return None
        if not is_all:
            if table.column(EXACT_KEY).null_count < table.num_rows:
                return None
            table = table.drop_columns([EXACT_KEY])
        return flatten(table, are_own=are_own)


def _decoded(payloads: Sequence[bytes]) -> list[dict[str, Any]] | None:
    """Return the rows of payloads; None if one is no row."""
    try:
        rows = list(map(orjson.loads, payloads))
    except orjson.JSONDecodeError:
        return None
    return rows if {*map(type, rows)} == {dict} else None


def _some_rows(payloads: Sequence[bytes]) -> list[dict[str, Any]]:
    """Return a few rows from all over the payloads, without rows that pyarrow does not read."""
    # Rounded up, so that at most _FEW rows come.
    rows = _decoded(payloads[:: -(-len(payloads) // _FEW)])
    return [] if rows is None else [row for row in rows if EXACT_KEY not in row]


def _first_row(lines: Lines) -> dict[str, Any]:
    """Return the first row, to see which keys are there; nothing if it is no row."""
    rows = _decoded(lines.payloads[:1])
    return {} if rows is None else rows[0]


def _has_all(row: Mapping[str, Any], names: Iterable[str]) -> bool:
    """Whether a row has some keys, each spelled with the keys of the dicts that it lies in."""
    return all(_has_path(row, name) for name in names)


def _has_path(row: Mapping[str, Any], path: str) -> bool:
    if path in row:
        return True
    return any(
        isinstance(inner, dict) and path.startswith(f"{name}.") and _has_path(inner, path[len(name) + 1 :])
        for name, inner in row.items()
    )


def _present(names: Sequence[str], first: Mapping[str, Any], text: bytes) -> list[str]:
    """Return the keys in `names` that stand somewhere in the lines, perhaps in a text.

    To search the lines for each of them would take a time that is quadratic in their number.

    Args:
        names: The keys.
        first: The first row.
        text: All rows.
    """
    others = {name: orjson.dumps(name) for name in names if name not in first}
    if not others or b"\\" in text:  # with escapes a key can be spelled in many ways
        return list(names)
    if len(others) > _MANY_KEYS:
        texts = set(_TEXT.findall(text))
        absent = {name for name, key in others.items() if key not in texts}
    else:
        absent = {name for name, key in others.items() if key not in text}
    return [name for name in names if name not in absent]


def _top_level_names(column: str) -> list[str]:
    """Return the keys of a row that a column with a dotted name may lie under."""
    names: dict[str, None] = {}
    for name in (column, column.removeprefix(FIELD_PREFIX)):
        parts = name.split(".")
        names.update(dict.fromkeys(".".join(parts[:end]) for end in range(1, len(parts) + 1)))
    return list(names)


def _read(text: bytes, fields: list[pa.Field], unexpected: str) -> pa.Table | None:
    try:
        return pj.read_json(
            pa.BufferReader(text),
            # One block on this thread: blocks of rows are read on several threads already (`store.read_ahead`).
            pj.ReadOptions(use_threads=False, block_size=len(text) + 1),
            pj.ParseOptions(explicit_schema=pa.schema(fields), unexpected_field_behavior=unexpected),
        )
    except pa.ArrowException:
        return None


def _has_empty_dict(text: bytes) -> bool:
    """Whether an empty dict stands somewhere, perhaps in a text; a search for it would keep other threads waiting."""
    marks = np.frombuffer(text, np.uint8)
    after = marks[np.flatnonzero(marks[:-1] == ord("{")) + 1]
    if (after == ord("}")).any():
        return True
    return bool((after <= ord(" ")).any()) and bool(_BLANK_DICT.search(text))
