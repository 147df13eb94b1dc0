"""Encodes columns of numbers as JSON rows: formats a column once, cuts its text at the rows, and joins the cuts.

Rows may lack fields, and fields may lie in dicts.
"""

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
from ..rows.json_text import exact
from ..rows.plain_row import TIME_KEY
from .codec import EncodedColumns

_SLICE = 1024
"""Rows encoded at a time: the encoder keeps other threads waiting while it works."""

_WORTH_ROWS = 16
"""Runs of rows that lack the same numbers are kept apart if they have so many rows on average: the writer thread
decodes one row of each run."""

Tree = Mapping[str, Any]
"""Arrays of numbers [N, ...], masked or not, by field. A dict in the rows is a dict of arrays."""

Leaves = Mapping[str, Any]
"""A `_Leaf` by field. A dict in the rows is a dict of leaves."""

Pieces = list[Any]
"""The parts of the text of rows: lists with a text for each row, and texts that all rows have in common."""


def is_worthwhile(columns: Tree) -> bool:
    """Whether columns are encoded faster by formatting each of them as a whole than row by row."""
    has_gaps = any(isinstance(column, (dict, np.ma.MaskedArray)) for column in columns.values())
    return all(map(_has_numbers, columns.values())) and (has_gaps or all(map(_is_finite, columns.values())))


def _has_numbers(column: Any) -> bool:
    return all(map(_has_numbers, column.values())) if isinstance(column, Mapping) else bool(column.size)


def encode(times: npt.NDArray[np.float64], columns: Tree, topic: str, head: bytes) -> Iterator[EncodedColumns]:
    """Encode checked columns, some rows at a time.

    A row that is masked in all its numbers lacks the field; a number that is masked beside others is None.

    Args:
        times: Time stamps, [N], s.
        columns: N rows each.
        topic: For the error messages.
        head: Channel id and sequence number as they stand in a record.
    """
    times_ns = clock.to_nanoseconds_each(times)
    is_finite = all(map(_is_finite, columns.values()))
    leaves = _leaves(columns)
    for first in range(0, len(times), _SLICE):
        part = slice(first, first + _SLICE)
        some, count = _cut(leaves, part), len(times[part])
        pieces = _row_pieces(some, times[part]) if is_finite else [_exact_rows(some, times[part], topic)]
        records, starts = _records(pieces, times_ns[part], head)
        runs = _runs(some, count)
        is_uniform = is_finite and len(runs) <= max(1, count // _WORTH_ROWS)
        if len(runs) == 1 or not is_uniform:
            yield EncodedColumns(records, starts, float(times[part][-1]), is_uniform)
            continue
        ends = np.append(starts, len(records))
        for begin, end in runs:
            piece = records[ends[begin] : ends[end]]
            yield EncodedColumns(piece, starts[begin:end] - starts[begin], float(times[part][end - 1]), True)


def _records(pieces: Pieces, times_ns: npt.NDArray[np.uint64], head: bytes) -> tuple[bytes, npt.NDArray[np.int64]]:
    """Join pieces to Message records; returns them, and where each of them starts, [N]."""
    count = len(times_ns)
    lengths = np.zeros(count, np.int64)
    columns: list[Any] = []
    for piece in _with_texts_joined(pieces):
        is_same = isinstance(piece, bytes)
        lengths += len(piece) if is_same else np.fromiter(map(len, piece), np.int64, count)
        columns.append(repeat(piece, count) if is_same else piece)
    packed, size = message_heads(lengths, int.from_bytes(head[:2], "little"), times_ns).tobytes(), MESSAGE_HEAD_BYTES
    heads = [packed[at : at + size] for at in range(0, len(packed), size)]
    lengths += size
    return b"".join(chain.from_iterable(zip(heads, *columns, strict=True))), np.cumsum(lengths) - lengths


def _with_texts_joined(pieces: Pieces) -> Pieces:
    """Join texts that all rows have in common where two of them stand side by side."""
    joined: Pieces = []
    for piece in pieces:
        if isinstance(piece, bytes) and joined and isinstance(joined[-1], bytes):
            joined[-1] += piece
        else:
            joined.append(piece)
    return joined


def _row_pieces(leaves: Leaves, times: npt.NDArray[np.float64]) -> Pieces:
    """Return the pieces of whole rows without anything that JSON cannot spell."""
    return [b"{", *_pieces(leaves), orjson.dumps(TIME_KEY) + b":", _Leaf(times, None, None).texts(), b"}"]


def _pieces(leaves: Leaves) -> Pieces:
    """Return the pieces of fields, each field with a comma behind it."""
    pieces: Pieces = []
    for name, leaf in leaves.items():
        key = orjson.dumps(name) + b":"
        if not isinstance(leaf, _Leaf):
            pieces += _dict_pieces(key, leaf)
            continue
        depth = leaf.values.ndim - 1
        before, behind = key + b"[" * depth, b"]" * depth + b","
        if leaf.present is None:
            pieces += [before, leaf.texts(), behind]
        else:
            pairs = zip(leaf.texts(), leaf.present.tolist(), strict=True)
            pieces.append([before + text + behind if is_there else b"" for text, is_there in pairs])
    return pieces


def _dict_pieces(key: bytes, leaves: Leaves) -> Pieces:
    """Return the pieces of a field that is a dict; a row without anything in the dict lacks the field."""
    inner = _pieces(leaves)
    if all(map(_is_always_there, leaves.values())):
        return [key + b"{", *inner[:-1], inner[-1][:-1] + b"},"]
    count = len(next(piece for piece in inner if isinstance(piece, list)))
    columns = [repeat(piece, count) if isinstance(piece, bytes) else piece for piece in inner]
    texts = map(b"".join, zip(*columns, strict=True))
    return [[key + b"{" + text[:-1] + b"}," if text else b"" for text in texts]]


def _exact_rows(leaves: Leaves, times: npt.NDArray[np.float64], topic: str) -> list[bytes]:
    """Return the text of each row, with the side key for numbers that JSON cannot spell."""
    return [exact({**_row(leaves, at), TIME_KEY: time_s}, topic) for at, time_s in enumerate(times.tolist())]


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
        # The brackets between two rows are where the text is cut, so that no row is formatted by itself.
        return text[1 + depth : -1 - depth].split(b"]" * depth + b"," + b"[" * depth)

    def value(self, row: int) -> Any:
        """Return one row's value."""
        if self.mask is None:
            return self.values[row].tolist()
        return np.ma.MaskedArray(self.values[row], self.mask[row]).tolist()


def _leaves(columns: Tree) -> Leaves:
    """Return the columns as leaves, which can be cut into rows and spelled."""
    return {name: _leaves(field) if isinstance(field, Mapping) else _leaf(field) for name, field in columns.items()}


def _leaf(column: Any) -> _Leaf:
    values, mask = np.ma.getdata(column), np.ma.getmask(column)
    has_gaps = bool(mask.any())
    # As doubles, because orjson spells a float32 with fewer digits than the double has that `append` would store.
    # A masked number becomes NaN, which orjson writes as null.
    if values.dtype.kind == "f":
        values = (
            np.where(mask, np.nan, values).astype(np.float64) if has_gaps else values.astype(np.float64, copy=False)
        )
    # orjson takes contiguous arrays in the machine's byte order only.
    values = np.ascontiguousarray(values, values.dtype.newbyteorder("="))
    if not has_gaps:
        return _Leaf(values, None, None)
    present = np.logical_not(mask.reshape(len(mask), -1).all(axis=1))
    return _Leaf(values, mask, present)


def _cut(leaves: Leaves, part: slice) -> Leaves:
    return {name: leaf.cut(part) if isinstance(leaf, _Leaf) else _cut(leaf, part) for name, leaf in leaves.items()}


def _is_always_there(leaf: Any) -> bool:
    """Whether all rows have a field, and all that lies in it."""
    return leaf.present is None if isinstance(leaf, _Leaf) else all(map(_is_always_there, leaf.values()))


def _runs(leaves: Leaves, count: int) -> list[tuple[int, int]]:
    """Return runs of rows in which the same numbers are masked, by the first row and the row after the last."""
    changes = np.zeros(count - 1, np.bool_)
    for mask in _masks(leaves):
        flat = mask.reshape(count, -1)
        changes |= (flat[1:] != flat[:-1]).any(axis=1)
    bounds = [0, *(np.flatnonzero(changes) + 1).tolist(), count]
    return list(pairwise(bounds))


def _masks(leaves: Leaves) -> Iterator[npt.NDArray[np.bool_]]:
    for leaf in leaves.values():
        if not isinstance(leaf, _Leaf):
            yield from _masks(leaf)
        elif leaf.mask is not None:
            yield leaf.mask


def _is_finite(column: Any) -> bool:
    """Whether there is neither NaN nor infinity where there is a number."""
    if isinstance(column, Mapping):
        return all(map(_is_finite, column.values()))
    return column.dtype.kind != "f" or bool((np.isfinite(np.ma.getdata(column)) | np.ma.getmask(column)).all())


def _row(leaves: Leaves, at: int) -> dict[str, Any]:
    """Return one row as a dict."""
    fields: dict[str, Any] = {}
    for name, leaf in leaves.items():
        if not isinstance(leaf, _Leaf):
            inner = _row(leaf, at)
            if inner:
                fields[name] = inner
        elif leaf.present is None or leaf.present[at]:
            fields[name] = leaf.value(at)
    return fields
