"""Encodes rows that are given as columns of numbers: all bytes that they share once, and each column as a whole."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ... import clock
from ...mcap.message_records import MESSAGE_HEAD_BYTES, message_heads
from ...rows.plain_row import TIME_KEY
from ..codec import EncodedColumns
from . import wire
from .growth import member_for
from .layout import Kind, Layout, Slot
from .row_encoder import TIME_TAG

_SLICE_BYTES = 256 * 1024
"""Of the rows encoded at a time, about so many bytes: the encoder keeps other threads waiting while it works."""

_KINDS = {"f": Kind.DOUBLE, "i": Kind.INT, "u": Kind.INT, "b": Kind.BOOL}
_TYPES = {Kind.DOUBLE: "<f8", Kind.INT: "<i8", Kind.BOOL: "|b1"}


class _Part(NamedTuple):
    """Numbers of each row that stand side by side in its bytes."""

    at: int
    """Where in a row they are."""
    column: npt.NDArray[Any]
    """[N, ...]."""
    dtype: str


def first_row(columns: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of the first row of columns."""
    return {key: first_row(column) if isinstance(column, Mapping) else column[0] for key, column in columns.items()}


def encode(
    layout: Layout, times: npt.NDArray[np.float64], columns: Mapping[str, Any], head: bytes
) -> Iterator[EncodedColumns] | None:
    """Encode rows, some at a time; None for columns that have to be encoded row by row.

    Args:
        layout: That has a field for each column.
        times: Time stamps, [N], s.
        columns: By field, arrays of numbers [N, ...], or dicts of these.
        head: Channel id and sequence number as they stand in a Message record.
    """
    row = bytearray()
    parts: list[_Part] = []
    if not len(times) or not _lay_out(layout, columns, row, parts):
        return None
    row += TIME_TAG
    parts.append(_Part(len(row), times, "<f8"))
    row += bytes(8)
    return _encoded(bytes(row), parts, times, head)


def _lay_out(layout: Layout, columns: Mapping[str, Any], row: bytearray, parts: list[_Part]) -> bool:
    """Write what all rows share, with room for the columns; returns whether all of these can be written so."""
    for key, column in columns.items():
        if key == TIME_KEY:
            return False
        if isinstance(column, Mapping):
            member = layout.member(key, Slot(Kind.DICT))
            inner = bytearray()
            inner_parts: list[_Part] = []
            if member is None or not _lay_out(member.inner or Layout(), column, inner, inner_parts):
                return False
            row += member.tag + wire.varint(len(inner))
            parts += [part._replace(at=part.at + len(row)) for part in inner_parts]
            row += inner
        elif not _lay_out_numbers(layout, key, column, row, parts):
            return False
    return True


def _lay_out_numbers(layout: Layout, key: str, column: Any, row: bytearray, parts: list[_Part]) -> bool:
    kind = _KINDS.get(column.dtype.kind)
    if kind is None or isinstance(column, np.ma.MaskedArray) or not column.size or column.dtype.itemsize > 8:
        return False
    if column.dtype.kind == "u" and column.dtype.itemsize == 8:
        return False  # some may need more than 63 bits
    slot = Slot(kind, column.shape[2:] if column.ndim > 1 else None)
    member = member_for(layout, key, slot, column.reshape(-1)[:1].tolist() if kind is Kind.INT else ())
    if member is None or member.slot != slot:
        return False
    dtype = np.dtype(_TYPES[kind])
    row += member.tag
    if slot.is_list:
        row += wire.varint(column[0].size * dtype.itemsize)
    parts.append(_Part(len(row), column, dtype.str))
    row += bytes(column[0].size * dtype.itemsize)
    return True


def _encoded(row: bytes, parts: list[_Part], times: npt.NDArray[np.float64], head: bytes) -> Iterator[EncodedColumns]:
    times_ns = clock.to_nanoseconds_each(times)
    size = MESSAGE_HEAD_BYTES + len(row)
    some = max(1, _SLICE_BYTES // size)
    channel = int.from_bytes(head[:2], "little")
    for first in range(0, len(times), some):
        part = slice(first, first + some)
        count = len(times[part])
        records = np.empty((count, size), np.uint8)
        heads = message_heads(np.full(count, len(row), np.int64), channel, times_ns[part])
        records[:, :MESSAGE_HEAD_BYTES] = np.ascontiguousarray(heads).view(np.uint8).reshape(count, -1)
        records[:, MESSAGE_HEAD_BYTES:] = np.frombuffer(row, np.uint8)
        for at, column, dtype in parts:
            numbers = np.ascontiguousarray(column[part], dtype).reshape(count, -1).view(np.uint8)
            records[:, MESSAGE_HEAD_BYTES + at : MESSAGE_HEAD_BYTES + at + numbers.shape[1]] = numbers
        starts = np.arange(0, count * size, size, dtype=np.int64)
        yield EncodedColumns(records.tobytes(), starts, float(times[part][-1]), True)
