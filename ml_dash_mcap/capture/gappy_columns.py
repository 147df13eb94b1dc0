"""Many rows at once, given as columns, where rows lack fields and fields lie in dicts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain, pairwise, repeat
from typing import Any

import numpy as np
import numpy.typing as npt
import orjson

from .. import clock
from ..mcap.message_records import MESSAGE_HEAD_BYTES, message_heads
from ..rows.encode import TIME_KEY
from ..rows.json_text import exact

_SLICE = 2048
"""Rows encoded at a time: the encoder keeps other threads waiting while it works."""

_WORTH_ROWS = 16
"""Runs of rows that lack the same are told apart if they have so many rows on average: the writer looks at one then."""

Tree = Mapping[str, Any]
"""Arrays of numbers [N, ...], masked ones among them, by field; dicts of such for dicts in the rows."""


def is_gappy(column: Any) -> bool:
    """Whether a column of numbers is a masked array, or a dict."""
    return isinstance(column, (dict, np.ma.MaskedArray))


@dataclass(frozen=True, slots=True)
class _Leaf:
    """One array of numbers."""

    values: npt.NDArray[Any]
    """[N, ...]; of fractions, NaN where a number is masked."""
    mask: npt.NDArray[np.bool_] | None
    """Where a number is masked, [N, ...]; None if none is."""
    present: npt.NDArray[np.bool_] | None
    """Which rows have the field, [N]; None if all have it."""

    def cut(self, part: slice) -> _Leaf:
        """Return some of its rows."""
        mask = None if self.mask is None else self.mask[part]
        present = None if self.present is None else self.present[part]
        return _Leaf(self.values[part], mask, None if present is None or present.all() else present)

    def texts(self) -> list[bytes]:
        """Return each row's text without its outer brackets."""
        depth = self.values.ndim - 1
        if self.mask is None or self.values.dtype.kind == "f":
            text = orjson.dumps(self.values, option=orjson.OPT_SERIALIZE_NUMPY)
        else:
            text = orjson.dumps(np.ma.MaskedArray(self.values, self.mask).tolist())
        return text[1 + depth : -1 - depth].split(b"]" * depth + b"," + b"[" * depth)

    def value(self, row: int) -> Any:
        """Return one row's value."""
        if self.mask is None:
            return self.values[row].tolist()
        return np.ma.MaskedArray(self.values[row], self.mask[row]).tolist()


Leaves = Mapping[str, Any]
"""Leaves by field; dicts of such for dicts in the rows."""


def slices(
    times: npt.NDArray[np.float64], columns: Tree, topic: str, head: bytes
) -> Iterator[tuple[bytes, npt.NDArray[np.int64], float, bool]]:
    """Encode checked columns as Message records, some rows at a time.

    A row that is masked in all its numbers lacks the field; a number that is masked beside others is None.

    Args:
        times: Time stamps, [N], s.
        columns: N rows each.
        topic: For the error messages.
        head: Channel id and sequence number as they stand in a record.

    Yields:
        The records, where each of them starts [N], the last time stamp in s, and whether all rows lack the same.
    """
    times_ns = clock.to_nanoseconds_each(times)
    is_finite = all(_is_finite(one) for one in columns.values())
    leaves = _leaves(columns)
    for first in range(0, len(times), _SLICE):
        part = slice(first, first + _SLICE)
        some, count = _cut(leaves, part), len(times[part])
        if is_finite:
            pieces = [b"{", *_pieces(some), orjson.dumps(TIME_KEY) + b":", _Leaf(times[part], None, None).texts(), b"}"]
            payloads = _joined(pieces, count)
        else:
            stamps = times[part].tolist()
            payloads = [exact({**_row(some, at), TIME_KEY: stamps[at]}, topic) for at in range(count)]
        blob, starts = _records(payloads, times_ns[part], head)
        ends = np.append(starts, len(blob))
        runs = _runs(some, count)
        is_uniform = is_finite and len(runs) <= max(1, count // _WORTH_ROWS)
        for begin, end in runs if is_uniform else [(0, count)]:
            piece = blob[ends[begin] : ends[end]]
            yield piece, starts[begin:end] - starts[begin], float(times[part][end - 1]), is_uniform


def _pieces(leaves: Leaves) -> list[Any]:
    """Return what joins to the fields' text, row by row, each with a comma behind it: texts, or one for all rows."""
    pieces: list[Any] = []
    for name, one in leaves.items():
        key = orjson.dumps(name) + b":"
        if not isinstance(one, _Leaf):
            inner = _pieces(one)
            if all(map(_is_always_there, one.values())):
                pieces += [key + b"{", *inner[:-1], inner[-1][:-1] + b"},"]
            else:
                count = len(next(piece for piece in inner if isinstance(piece, list)))
                pieces.append([key + b"{" + text[:-1] + b"}," if text else b"" for text in _joined(inner, count)])
            continue
        depth = one.values.ndim - 1
        before, behind = key + b"[" * depth, b"]" * depth + b","
        if one.present is None:
            pieces += [before, one.texts(), behind]
        else:
            pairs = zip(one.texts(), one.present.tolist(), strict=True)
            pieces.append([before + text + behind if is_there else b"" for text, is_there in pairs])
    return pieces


def _joined(pieces: list[Any], count: int) -> list[bytes]:
    """Join pieces, row by row."""
    columns: list[Any] = []
    constant = b""
    for piece in pieces:
        if isinstance(piece, bytes):
            constant += piece
            continue
        if constant:
            columns.append(repeat(constant, count))
        columns.append(piece)
        constant = b""
    if constant:
        columns.append(repeat(constant, count))
    return [b"".join(parts) for parts in zip(*columns, strict=True)]


def _records(
    payloads: list[bytes], times_ns: npt.NDArray[np.uint64], head: bytes
) -> tuple[bytes, npt.NDArray[np.int64]]:
    """Return payloads as Message records, and where each of them starts, [N]."""
    lengths = np.fromiter(map(len, payloads), np.int64, len(payloads))
    packed = message_heads(lengths, int.from_bytes(head[:2], "little"), times_ns).tobytes()
    size = MESSAGE_HEAD_BYTES
    cut_heads = [packed[at : at + size] for at in range(0, len(packed), size)]
    lengths += size
    return b"".join(chain.from_iterable(zip(cut_heads, payloads, strict=True))), np.cumsum(lengths) - lengths


def _leaves(columns: Tree) -> Leaves:
    """Return what columns consist of, each prepared for being cut and spelled."""
    return {name: _leaves(one) if isinstance(one, Mapping) else _leaf(one) for name, one in columns.items()}


def _leaf(column: Any) -> _Leaf:
    values, mask = np.ma.getdata(column), np.ma.getmaskarray(column)
    is_gappy = bool(mask.any())
    if values.dtype.kind == "f":
        values = np.where(mask, np.nan, values).astype(np.float64) if is_gappy else values.astype(np.float64)
    values = np.ascontiguousarray(values, values.dtype.newbyteorder("="))
    if not is_gappy:
        return _Leaf(values, None, None)
    is_gap = mask.reshape(len(mask), -1)
    present = np.logical_not(is_gap.all(axis=1))
    return _Leaf(values, mask, present)


def _cut(leaves: Leaves, part: slice) -> Leaves:
    return {name: one.cut(part) if isinstance(one, _Leaf) else _cut(one, part) for name, one in leaves.items()}


def _is_always_there(one: Any) -> bool:
    """Whether all rows have a field, and all that lies in it."""
    return one.present is None if isinstance(one, _Leaf) else all(map(_is_always_there, one.values()))


def _runs(leaves: Leaves, count: int) -> list[tuple[int, int]]:
    """Return runs of rows in which the same numbers are masked, by the first row and the one after the last."""
    changes = np.zeros(count - 1, np.bool_)
    for mask in _masks(leaves):
        flat = mask.reshape(count, -1)
        changes |= (flat[1:] != flat[:-1]).any(axis=1)
    bounds = [0, *(np.flatnonzero(changes) + 1).tolist(), count]
    return list(pairwise(bounds))


def _masks(leaves: Leaves) -> Iterator[npt.NDArray[np.bool_]]:
    for one in leaves.values():
        if not isinstance(one, _Leaf):
            yield from _masks(one)
        elif one.mask is not None:
            yield one.mask


def _is_finite(column: Any) -> bool:
    """Whether there is neither NaN nor infinity where there is a number."""
    if isinstance(column, Mapping):
        return all(_is_finite(one) for one in column.values())
    return column.dtype.kind != "f" or bool((np.isfinite(np.ma.getdata(column)) | np.ma.getmaskarray(column)).all())


def _row(leaves: Leaves, at: int) -> dict[str, Any]:
    """Return one row as a dict."""
    fields: dict[str, Any] = {}
    for name, one in leaves.items():
        if not isinstance(one, _Leaf):
            inner = _row(one, at)
            if inner:
                fields[name] = inner
        elif one.present is None or one.present[at]:
            fields[name] = one.value(at)
    return fields
