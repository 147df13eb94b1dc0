"""Many rows at once, given as columns, where rows lack fields and fields lie in dicts."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from itertools import chain, repeat
from typing import Any

import numpy as np
import numpy.typing as npt
import orjson

from .. import clock
from ..errors import FieldError
from ..rows.encode import TIME_KEY, exact
from . import records

Tree = Mapping[str, Any]
"""Arrays of numbers [N, ...], masked ones among them, by field; dicts of such for dicts in the rows."""


def is_gappy(column: Any) -> bool:
    """Whether a column is a masked array, or a dict of arrays."""
    if isinstance(column, Mapping):
        return bool(column) and all(isinstance(one, np.ndarray) or is_gappy(one) for one in column.values())
    return isinstance(column, np.ma.MaskedArray)


def check(name: str, column: Any, count: int, topic: str) -> None:
    """Raise FieldError unless a column is numbers, one value a row, or a dict of such."""
    if isinstance(column, Mapping):
        for key, one in column.items():
            if not isinstance(key, str) or key == TIME_KEY or not key.isprintable():
                raise FieldError(f"append_columns() on topic {topic!r}: {name!r} has the key {key!r}, which is no name")
            check(f"{name}.{key}", one, count, topic)
        return
    if not isinstance(column, np.ndarray) or column.dtype.kind not in "fiub" or column.dtype.itemsize > 8:
        raise FieldError(
            f"append_columns() on topic {topic!r}: column {name!r} stands beside masked arrays or dicts; it must be an"
            " array of numbers too"
        )
    if not column.ndim or len(column) != count:
        raise FieldError(
            f"append_columns() on topic {topic!r}: column {name!r} has the shape {column.shape}, but _ts has"
            f" {count} rows"
        )


def encode_slice(
    times: npt.NDArray[np.float64], times_ns: npt.NDArray[np.uint64], columns: Tree, topic: str, head: bytes
) -> tuple[bytes, npt.NDArray[np.int64], bool]:
    """Encode rows as Message records.

    Args:
        times: Time stamps, [N], s.
        times_ns: The same in ns.
        columns: Checked ones, N rows each. A row that is masked in all its numbers lacks the field; a number that is
            masked beside others is None.
        topic: For the error messages.
        head: Channel id and sequence number as they stand in a record.

    Returns:
        The records, where each of them starts [N], and whether no row lacks a field.
    """
    count = len(times)
    if all(_is_finite(one) for one in columns.values()):
        pieces = list(chain.from_iterable(_field(name, one, count) for name, one in columns.items()))
        spelled = orjson.dumps(times, option=orjson.OPT_SERIALIZE_NUMPY)[1:-1].split(b",")
        key = orjson.dumps(TIME_KEY) + b":"
        payloads = [
            b"".join(parts) for parts in zip(repeat(b"{", count), *pieces, repeat(key, count), spelled, strict=True)
        ]
        payloads = [payload + b"}" for payload in payloads]
    else:
        payloads = [exact({**_row(columns, at), TIME_KEY: float(times[at])}, topic) for at in range(count)]
    lengths = np.fromiter(map(len, payloads), np.int64, count)
    heads = np.zeros(count, records.MESSAGE_HEAD_DTYPE)
    heads["opcode"] = records.MESSAGE_OPCODE
    heads["length"] = lengths + records.MESSAGE_LENGTH_EXCESS
    heads["channel"] = struct.unpack_from("<H", head)[0]
    heads["log_time"] = heads["publish_time"] = times_ns
    packed, size = heads.tobytes(), records.MESSAGE_HEAD
    cut_heads = [packed[at : at + size] for at in range(0, len(packed), size)]
    lengths += size
    is_uniform = all(_is_whole(one) for one in columns.values())
    return (
        b"".join(chain.from_iterable(zip(cut_heads, payloads, strict=True))),
        np.cumsum(lengths) - lengths,
        is_uniform,
    )


def cut(columns: Tree, part: slice) -> Tree:
    """Return some rows of columns."""
    return {name: cut(one, part) if isinstance(one, Mapping) else one[part] for name, one in columns.items()}


def _field(name: str, column: Any, count: int) -> list[Any]:
    """Return what joins, row by row, to the text of a field with a comma behind it, or to nothing."""
    key = orjson.dumps(name) + b":"
    if isinstance(column, Mapping):
        inner = list(chain.from_iterable(_field(one, values, count) for one, values in column.items()))
        texts = [b"".join(parts) for parts in zip(*inner, strict=True)]
        return [[key + b"{" + text[:-1] + b"}," if text else b"" for text in texts]]
    opening, closing = b"[" * (column.ndim - 1), b"]" * (column.ndim - 1)
    texts, present = _cut(column, opening, closing)
    if present is None:
        return [repeat(key + opening, count), texts, repeat(closing + b",", count)]
    before, behind = key + opening, closing + b","
    pairs = zip(texts, present.tolist(), strict=True)
    return [[before + text + behind if is_there else b"" for text, is_there in pairs]]


def _cut(column: Any, opening: bytes, closing: bytes) -> tuple[list[bytes], npt.NDArray[np.bool_] | None]:
    """Return the text of each row without its outer brackets, and which rows have any of their numbers, [N]."""
    mask = np.ma.getmask(column)
    values = np.ma.getdata(column)
    if mask is np.ma.nomask or not mask.any():
        text = orjson.dumps(np.ascontiguousarray(values), option=orjson.OPT_SERIALIZE_NUMPY)
        present = None
    else:
        present = ~mask.reshape(len(mask), -1).all(axis=1)
        gaps = np.where(mask, np.nan, values)  # which the encoder writes as null
        if values.dtype.kind == "f":
            text = orjson.dumps(np.ascontiguousarray(gaps, np.float64), option=orjson.OPT_SERIALIZE_NUMPY)
        else:
            text = orjson.dumps(column.tolist())
    depth = column.ndim - 1
    inner = text[1 + depth : -1 - depth]
    return inner.split(closing + b"," + opening), present


def _is_finite(column: Any) -> bool:
    """Whether there is neither NaN nor infinity where there is a number."""
    if isinstance(column, Mapping):
        return all(_is_finite(one) for one in column.values())
    return column.dtype.kind != "f" or bool((np.isfinite(np.ma.getdata(column)) | np.ma.getmaskarray(column)).all())


def _is_whole(column: Any) -> bool:
    if isinstance(column, Mapping):
        return all(_is_whole(one) for one in column.values())
    return not np.ma.is_masked(column)


def _row(columns: Tree, at: int) -> dict[str, Any]:
    """Return one row as a dict."""
    fields: dict[str, Any] = {}
    for name, column in columns.items():
        if isinstance(column, Mapping):
            inner = _row(column, at)
            if inner:
                fields[name] = inner
        elif not np.ma.getmaskarray(column)[at].all():
            fields[name] = column[at].tolist()
    return fields


def slices(
    times: npt.NDArray[np.float64], columns: Tree, topic: str, head: bytes, rows: int
) -> Iterator[tuple[bytes, npt.NDArray[np.int64], float, bool]]:
    """Encode some rows at a time: the records, where each starts, the last time stamp (s), whether they are alike."""
    times_ns = clock.to_nanoseconds_each(times)
    for first in range(0, len(times), rows):
        part = slice(first, first + rows)
        blob, starts, is_uniform = encode_slice(times[part], times_ns[part], cut(columns, part), topic, head)
        yield blob, starts, float(times[part][-1]), is_uniform
