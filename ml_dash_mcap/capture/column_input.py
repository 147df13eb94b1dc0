"""Encodes many rows that are given as columns into Message records."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import clock
from ..codecs.codec import Codec, EncodedColumns
from ..errors import FieldError, TimestampError
from ..mcap.message_records import MESSAGE_FIXED_BYTES, MESSAGE_OPCODE
from ..rows import from_data_frames, packed_arrays
from ..rows.plain_row import TIME_KEY
from ..time_hints import seconds_hint, unit_hint
from ..timestamps import MISSING
from . import column_rows

_SLICE = 512
"""Rows encoded at a time: the encoder keeps other threads waiting while it works."""

_SLICE_BYTES = 1024 * 1024
"""Fewer rows at a time where they have more bytes together."""


def encode(times_s: Any, columns: Mapping[str, Any], topic: str, head: bytes, codec: Codec) -> Iterator[EncodedColumns]:
    """Check columns and return their rows as Message records.

    Args:
        times_s: Time stamps, [N], s.
        columns: By field, one value a row: arrays [N, ...], sequences of length N, or dicts of these.
        topic: For the error messages.
        head: Channel id and sequence number as they stand in a record.
        codec: The codec of the topic's rows.

    Returns:
        An iterator over the rows, some hundred at a time.

    Raises:
        TimestampError: `times_s` is missing or has a time stamp that is not finite, negative or too large.
        FieldError: A column has another length, or a value cannot be stored.
    """
    times = _times(from_data_frames.plain(times_s), topic)
    for name in columns:
        _check_name(name, topic)
    checked = {
        name: column_rows.checked(name, from_data_frames.plain(column), len(times), topic)
        for name, column in columns.items()
    }
    leaves = list(column_rows.leaves(checked))
    if not all(map(_is_numbers, leaves)):  # a value that cannot be stored is an error before any row is taken
        return iter(list(_encode_rows(times, checked, topic, head, codec)))
    if any(len(leaf) and packed_arrays.is_large(leaf[0]) for leaf in leaves if leaf.ndim > 1):
        return _encode_rows(times, checked, topic, head, codec)
    encoded = codec.encode_columns(times, checked, topic, head)
    return _encode_rows(times, checked, topic, head, codec) if encoded is None else encoded


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
        values = np.asarray(times_s)
    except ValueError as error:  # ragged
        raise TimestampError(f"append_columns() on topic {topic!r}: _ts must be numbers, [N], in seconds") from error
    if values.ndim != 1:
        raise TimestampError(f"append_columns() on topic {topic!r}: _ts has the shape {values.shape}; it must be [N]")
    if values.dtype.kind not in "fiu" and len(values):
        raise TimestampError(
            f"append_columns() on topic {topic!r}: _ts must be numbers, [N], in seconds; these are {_kind(values)}"
        )
    times = values.astype(np.float64)
    good = (times >= 0) & (times < clock.END_S)
    if not good.all():
        row = int(np.flatnonzero(~good)[0])
        raise TimestampError(
            f"append_columns() on topic {topic!r}: _ts[{row}]={times[row]!r} is not a time stamp; it must be finite,"
            f" 0 or more, in seconds{unit_hint(times[row]) if clock.END_S <= times[row] < np.inf else ''}"
        )
    # -0.0 + 0.0 is 0.0: a row has no time stamp with a sign, whichever way it was appended.
    return times + 0.0


def _kind(times: npt.NDArray[Any]) -> str:
    """Describe times that are not numbers, and how to convert them to seconds, for an error message."""
    if times.dtype.kind in "mM":
        return f"{times.dtype}{seconds_hint(times)}"
    hint = seconds_hint(times[0])
    return f"{type(times[0]).__name__}{hint}, for each row" if hint else str(times.dtype)


def _is_numbers(column: Any) -> bool:
    """Whether a column is an array of numbers or booleans, each of which can be stored."""
    return isinstance(column, np.ndarray) and column.dtype.kind in "fiub" and column.dtype.itemsize <= 8


def _encode_rows(
    times: npt.NDArray[np.float64], columns: Mapping[str, Any], topic: str, head: bytes, codec: Codec
) -> Iterator[EncodedColumns]:
    """Encode columns row by row that cannot be formatted in bulk; yields some rows at a time."""
    blobs: list[bytes] = []
    size = 0
    for row, time_s in enumerate(times.tolist()):
        payload = codec.encode({**column_rows.fields(columns, row), TIME_KEY: time_s}, topic)
        time_ns = clock.to_nanoseconds(time_s)
        length = len(payload) + MESSAGE_FIXED_BYTES
        blobs.append(struct.pack("<BQ6sQQ", MESSAGE_OPCODE, length, head, time_ns, time_ns) + payload)
        size += len(blobs[-1])
        if len(blobs) == _SLICE or size > _SLICE_BYTES or row == len(times) - 1:
            lengths = np.array([len(blob) for blob in blobs], np.int64)
            yield EncodedColumns(b"".join(blobs), np.cumsum(lengths) - lengths, time_s, False)
            blobs, size = [], 0
