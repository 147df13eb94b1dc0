"""Spells values as the cells of a CSV file, a column at a time.

Numbers stand there as in JSON: the shortest text that gives the same double back, and integers with all digits. Others
than finite ones are `NaN`, `inf` and `-inf`: the spellings that pandas, polars, DuckDB and pyarrow all read as numbers.
Missing values are empty cells. Quoting is that of RFC 4180, and text is also quoted where it is empty or looks like
something else than text (`"007"`, `"true"`, `"NA"`), for the readers that heed it. Text that a spreadsheet would take
for a formula gets an apostrophe in front (CWE-1236), and so does text that begins like one that has got it, so that
taking one away gives the text back; numbers never do.
"""

from __future__ import annotations

import base64
import math
import re
from typing import Any

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.compute as pc

from ....rows import numpy_columns
from ....rows.plain_row import encodable
from ....rows.typed_columns import Column, to_text, values_of

_FORMULA = r"^'*[=+\-@\t\r]"
_NUMBER = r"[0-9]*\.?[0-9]+([eE][+\-]?[0-9]+)?|[0-9]+\."
_WORDS = r"(?i:nan|inf|infinity|true|false|null|none|na|n/a|#n/a|#na|<na>)"
_QUOTED = rf'[",\r\n]|^[ \t]|[ \t]$|^$|^({_NUMBER}|{_WORDS})$'
_NOT_FINITE = {"nan": "NaN", "inf": "inf", "-inf": "-inf"}
_COMMA = ord(",")


def of(column: Column) -> pa.Array:
    """Return the text of each value; null where there is none.

    Lists and dicts are JSON, bytes base64, booleans `true` and `false`.
    """
    array = column.array
    type_ = array.type
    if pa.types.is_null(type_):
        return pa.nulls(len(array), pa.string())
    if column.is_text:
        return pa.array([_one(value) for value in values_of(column)], pa.string())
    if pa.types.is_floating(type_):
        return _numbers(array)
    if pa.types.is_integer(type_) or pa.types.is_boolean(type_):
        return array.cast(pa.string())
    if pa.types.is_string(type_):
        return _texts(array)
    if pa.types.is_nested(type_) and numpy_columns.is_large(array):
        return pa.array([_array(value) for value in numpy_columns.cells(array)], pa.string())
    return pa.array([_one(value) for value in array.to_pylist()], pa.string())


def _array(value: Any) -> str | None:
    """Return the cell of a large array, formatted by orjson as a list of its numbers is."""
    is_whole = isinstance(value, np.ndarray) and not isinstance(value, np.ma.MaskedArray)
    if not is_whole or value.dtype.kind not in "fiub" or (value.dtype.kind == "f" and not np.isfinite(value).all()):
        return _one(value.tolist() if isinstance(value, np.ndarray) else value)
    values = np.ascontiguousarray(value, np.float64 if value.dtype.kind == "f" else value.dtype)
    return text(orjson.dumps(values, option=orjson.OPT_SERIALIZE_NUMPY).decode())


def text(value: str) -> str:
    """Return the cell of a text."""
    value = encodable(value)
    return _quoted(f"'{value}" if re.search(_FORMULA, value) else value)


def lines(cells: list[pa.Array]) -> bytes:
    """Return rows, each with a newline at its end.

    Args:
        cells: For each column, the text of its rows.
    """
    rows = pc.binary_join_element_wise(*cells, ",", null_handling="replace", null_replacement="")
    # One list of all rows, joined once: pyarrow puts the block's text together without a Python object for each row.
    joined = pc.binary_join(pa.ListArray.from_arrays(pa.array([0, len(rows)], pa.int32()), rows), "\n")
    return bytes(joined[0].as_buffer()) + b"\n"


def _one(value: Any) -> str | None:
    if value is None:
        return None
    if isinstance(value, str):
        return text(value)
    if isinstance(value, bytes):
        return _quoted(base64.b64encode(value).decode("ascii"))
    if isinstance(value, float) and not math.isfinite(value):
        return _NOT_FINITE[str(value)]
    spelling = to_text(value)
    return text(spelling) if isinstance(value, (list, dict)) else spelling


def _quoted(value: str) -> str:
    return '"' + value.replace('"', '""') + '"' if re.search(_QUOTED, value) else value


def _numbers(array: pa.Array) -> pa.Array:
    """Write doubles with orjson, all in one text, and cut that at its commas: pyarrow would write 1.0 as 1."""
    if not len(array):
        return pa.array([], pa.string())
    filled = array.fill_null(0.0) if array.null_count else array
    values = np.ascontiguousarray(filled.to_numpy(zero_copy_only=False), np.float64)
    json = np.frombuffer(orjson.dumps(values, option=orjson.OPT_SERIALIZE_NUMPY), np.uint8)[1:-1]
    is_comma = json == _COMMA
    ends = np.flatnonzero(is_comma) - np.arange(len(values) - 1)
    offsets = np.concatenate(([0], ends, [len(json) - len(values) + 1])).astype(np.int32)
    texts = pa.StringArray.from_buffers(len(values), pa.py_buffer(offsets), pa.py_buffer(json[~is_comma]))
    if not np.isfinite(values).all():
        spelt = [None if math.isfinite(value) else _NOT_FINITE[str(value)] for value in values.tolist()]
        texts = pc.coalesce(pa.array(spelt, pa.string()), texts)
    return pc.if_else(array.is_valid(), texts, pa.scalar(None, pa.string())) if array.null_count else texts


def _texts(array: pa.Array) -> pa.Array:
    safe = pc.if_else(pc.match_substring_regex(array, _FORMULA), pc.binary_join_element_wise("'", array, ""), array)
    is_odd = pc.match_substring_regex(safe, _QUOTED)
    if not pc.any(is_odd).as_py():
        return safe
    quoted = pc.binary_join_element_wise('"', pc.replace_substring(safe, '"', '""'), '"', "")
    return pc.if_else(is_odd, quoted, safe)
