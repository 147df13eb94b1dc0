"""Many rows at once, given as columns, to Message records."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from itertools import chain, repeat
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import orjson

from .. import clock
from ..errors import FieldError, TimestampError
from ..mcap.message_records import MESSAGE_FIXED_BYTES, MESSAGE_HEAD_BYTES, MESSAGE_OPCODE, message_heads
from ..rows import from_data_frames, packed
from ..rows.encode import TIME_KEY
from ..time_hints import seconds_hint, unit_hint
from ..timestamps import MISSING
from . import column_rows, gappy_columns

_SLICE = 512
"""Rows encoded at a time: the encoder keeps other threads waiting while it works."""

_SLICE_BYTES = 1024 * 1024
"""Fewer rows at a time where they have more bytes together."""

_COMMA, _CLOSE = ord(","), ord("]")


class Encoded(NamedTuple):
    """Some rows as Message records."""

    records: bytes
    """One after the other."""
    starts: npt.NDArray[np.int64]
    """Where each of them starts, [N]."""
    last_s: float
    """The last row's time stamp, in seconds."""
    is_uniform: bool
    """Whether all of them have the same fields, of the same types and shapes."""


def encode(times_s: Any, columns: Mapping[str, Any], topic: str, head: bytes) -> Iterator[Encoded]:
    """Check columns and return their rows as Message records.

    Args:
        times_s: Time stamps, [N], s.
        columns: By field, one value a row: arrays [N, ...], sequences of length N, or dicts of such.
        topic: For the error messages.
        head: Channel id and sequence number as they stand in a record.

    Returns:
        An iterator over the rows, some hundred at a time.

    Raises:
        TimestampError: `times_s` is missing or has a time stamp that is not finite, negative or too large.
        FieldError: A column has another length, or a value cannot be stored.
    """
    times = _times(from_data_frames.plain(times_s), topic)
    for name in columns:
        _check_name(name, topic)
    found = {
        name: column_rows.checked(name, from_data_frames.plain(column), len(times), topic)
        for name, column in columns.items()
    }
    every = list(column_rows.leaves(found))
    if not all(map(_is_numbers, every)):  # a value that cannot be stored is an error before any row is taken
        return iter(list(_encode_rows(times, found, topic, head)))
    if any(len(one) and packed.is_large(one[0]) for one in every if one.ndim > 1):
        return _encode_rows(times, found, topic, head)
    if any(gappy_columns.is_gappy(column) for column in found.values()):
        return (Encoded(*rows) for rows in gappy_columns.slices(times, found, topic, head))
    if all(map(_is_bulk, every)):
        return _encode_slices(times, found, topic, head)
    return _encode_rows(times, found, topic, head)


def _check_name(name: str, topic: str) -> None:
    try:
        name.encode()
    except UnicodeEncodeError as error:
        raise FieldError(
            f"append_columns() on topic {topic!r}: the column name {name!r} is not valid Unicode"
        ) from error


def _times(times_s: Any, topic: str) -> npt.NDArray[np.float64]:
    if times_s is MISSING:
        raise TimestampError(f"append_columns() on topic {topic!r} needs _ts=, the rows' times, [N], in seconds")
    try:
        given = np.asarray(times_s)
    except ValueError as error:  # ragged
        raise TimestampError(f"append_columns() on topic {topic!r}: _ts must be numbers, [N], in seconds") from error
    if given.ndim != 1:
        raise TimestampError(f"append_columns() on topic {topic!r}: _ts has the shape {given.shape}; it must be [N]")
    if given.dtype.kind not in "fiu" and len(given):
        raise TimestampError(
            f"append_columns() on topic {topic!r}: _ts must be numbers, [N], in seconds; these are {_kind(given)}"
        )
    times = given.astype(np.float64)
    good = (times >= 0) & (times < clock.END_S)
    if not good.all():
        row = int(np.flatnonzero(~good)[0])
        raise TimestampError(
            f"append_columns() on topic {topic!r}: _ts[{row}]={times[row]!r} is not a time stamp; it must be finite,"
            f" 0 or more, in seconds{unit_hint(times[row]) if clock.END_S <= times[row] < np.inf else ''}"
        )
    return times + 0.0


def _kind(times: npt.NDArray[Any]) -> str:
    """Return of what kind times are that are no numbers, and how to make seconds of them."""
    if times.dtype.kind in "mM":
        return f"{times.dtype}{seconds_hint(times)}"
    hint = seconds_hint(times[0])
    return f"{type(times[0]).__name__}{hint}, for each row" if hint else str(times.dtype)


def _is_numbers(column: Any) -> bool:
    """Whether a column is an array of numbers or booleans, each of which can be stored."""
    return isinstance(column, np.ndarray) and column.dtype.kind in "fiub" and column.dtype.itemsize <= 8


def _is_bulk(array: npt.NDArray[Any]) -> bool:
    """Whether orjson can format a whole array of numbers as its rows would be: finite ones only."""
    return array.size > 0 and (array.dtype.kind != "f" or bool(np.isfinite(array).all()))


def _encode_rows(
    times: npt.NDArray[np.float64], columns: Mapping[str, Any], topic: str, head: bytes
) -> Iterator[Encoded]:
    """Encode row by row what cannot be formatted in bulk, some rows at a time."""
    blobs: list[bytes] = []
    size = 0
    for row, time_s in enumerate(times.tolist()):
        payload = column_rows.payload(columns, row, time_s, topic)
        time_ns = clock.to_nanoseconds(time_s)
        length = len(payload) + MESSAGE_FIXED_BYTES
        blobs.append(struct.pack("<BQ6sQQ", MESSAGE_OPCODE, length, head, time_ns, time_ns) + payload)
        size += len(blobs[-1])
        if len(blobs) == _SLICE or size > _SLICE_BYTES or row == len(times) - 1:
            lengths = np.array([len(blob) for blob in blobs], np.int64)
            yield Encoded(b"".join(blobs), np.cumsum(lengths) - lengths, time_s, False)
            blobs, size = [], 0


def _encode_slices(
    times: npt.NDArray[np.float64], columns: Mapping[str, npt.NDArray[Any]], topic: str, head: bytes
) -> Iterator[Encoded]:
    arrays = {
        name: np.ascontiguousarray(array, np.float64 if array.dtype.kind == "f" else array.dtype.newbyteorder("="))
        for name, array in columns.items()
    }
    times_ns = clock.to_nanoseconds_each(times)
    for first in range(0, len(times), _SLICE):
        part = slice(first, first + _SLICE)
        blob, starts = _encode_slice(times[part], times_ns[part], {k: a[part] for k, a in arrays.items()}, head)
        yield Encoded(blob, starts, float(times[part][-1]), True)


def _encode_slice(
    times: npt.NDArray[np.float64],
    times_ns: npt.NDArray[np.uint64],
    columns: Mapping[str, npt.NDArray[Any]],
    head: bytes,
) -> tuple[bytes, npt.NDArray[np.int64]]:
    """Format each column once, cut it at the rows, and join the cuts with the keys between them."""
    count = len(times)
    lengths = np.zeros(count, np.int64)
    pieces: list[Any] = []
    between = b"{"
    for name, array in [*columns.items(), (TIME_KEY, times)]:
        opening = b"[" * (array.ndim - 1)
        texts, sizes = _cut(array)
        key = between + orjson.dumps(name) + b":" + opening
        pieces += [repeat(key, count), texts]
        lengths += sizes + len(key)
        between = b"]" * (array.ndim - 1) + b","
    pieces.append(repeat(b"}", count))
    lengths += 1
    packed = message_heads(lengths, int.from_bytes(head[:2], "little"), times_ns).tobytes()
    size = MESSAGE_HEAD_BYTES
    cut_heads = [packed[at : at + size] for at in range(0, len(packed), size)]
    lengths += size
    return b"".join(chain.from_iterable(zip(cut_heads, *pieces, strict=True))), np.cumsum(lengths) - lengths


def _cut(array: npt.NDArray[Any]) -> tuple[list[bytes], npt.NDArray[np.int64]]:
    """Return the text of each row of an array without its outer brackets, and its length, [N]."""
    depth = array.ndim - 1
    text = orjson.dumps(array, option=orjson.OPT_SERIALIZE_NUMPY)
    texts = text[1 + depth : -1 - depth].split(b"]" * depth + b"," + b"[" * depth)
    return texts, np.fromiter(map(len, texts), np.int64, len(texts))
