"""Columns of numbers as rows of CBOR: all rows have one layout, so that they are one matrix of bytes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import clock
from ..mcap.message_records import MESSAGE_HEAD_BYTES, message_heads
from ..rows.encode import TIME_KEY
from .cbor_layouts import Bytes, head_bytes
from .codec import EncodedColumns

_SLICE = 4096
"""Rows encoded at a time."""


def encode(times: npt.NDArray[np.float64], columns: Mapping[str, Any], head: bytes) -> Iterator[EncodedColumns]:
    """Encode columns of numbers, some thousand rows at a time.

    Args:
        times: Time stamps, [N], s.
        columns: By field, arrays of numbers [N, ...].
        head: Channel id and sequence number as they stand in a Message record.
    """
    times_ns = clock.to_nanoseconds_each(times)
    columns = {**columns, TIME_KEY: times}
    for first in range(0, len(times), _SLICE):
        part = slice(first, first + _SLICE)
        count = len(times[part])
        pieces = [_repeated(head_bytes(0xA0, len(columns)), count)]
        for name, column in columns.items():
            key = name.encode()
            pieces += [_repeated(head_bytes(0x60, len(key)) + key, count), _elements(column[part])]
        payloads = np.concatenate(pieces, axis=1)
        lengths = np.full(count, payloads.shape[1], np.int64)
        heads = message_heads(lengths, int.from_bytes(head[:2], "little"), times_ns[part])
        records = np.concatenate((heads.view(np.uint8).reshape(count, MESSAGE_HEAD_BYTES), payloads), axis=1)
        starts = np.arange(count, dtype=np.int64) * records.shape[1]
        yield EncodedColumns(records.tobytes(), starts, float(times[part][-1]), True)


def _repeated(text: bytes, count: int) -> Bytes:
    return np.broadcast_to(np.frombuffer(text, np.uint8), (count, len(text)))


def _elements(column: npt.NDArray[Any]) -> Bytes:
    """Return an array [N, ...] as the bytes of N items, each a number or nested lists, [N, size]."""
    items: Bytes
    kind = column.dtype.kind
    if kind == "b":
        items = np.where(column, np.uint8(0xF5), np.uint8(0xF4))[..., None]
    elif kind == "f":
        items = _with_heads(np.full(column.shape, 0xFB, np.uint8), column.astype(">f8"))
    else:
        is_negative = column < 0
        wide = column.astype(np.int64 if kind == "i" else np.uint64)
        heads = np.where(is_negative, np.uint8(0x3B), np.uint8(0x1B))
        items = _with_heads(heads, np.where(is_negative, ~wide, wide).astype(">u8"))
    for length in reversed(column.shape[1:]):
        inner = items.reshape(*items.shape[:-2], -1)
        head = np.frombuffer(head_bytes(0x80, length), np.uint8)
        items = np.concatenate((np.broadcast_to(head, (*inner.shape[:-1], len(head))), inner), axis=-1)
    return items


def _with_heads(heads: Bytes, numbers: npt.NDArray[Any]) -> Bytes:
    return np.concatenate((heads[..., None], numbers[..., None].view(np.uint8)), axis=-1)
