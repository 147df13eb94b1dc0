"""Reads one topic's rows: decoded, in time order, those of one time stamp merged."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from typing import Any, SupportsIndex

import numpy as np
import numpy.typing as npt

from .. import clock
from ..codecs.codec import MessageCodec
from ..codecs.decode import codec_of, decoder
from ..codecs.encoded_channel import BlockDecoder, DecodableBlock, Decoder, Row
from ..errors import DamagedFileError, RangeError
from ..rows.merge import merge
from ..rows.plain_row import TIME_KEY
from ..time_hints import seconds_hint
from . import topic_messages
from .stored_topic import LAST_NS, StoredTopic, is_merged
from .time_order import TOLERANCE_NS, is_close
from .topic_messages import MessageBatch, MessageOrigin

_AT_ONCE = 32
"""So many rows are decoded before the first one is handed out; more would set off the garbage collector."""

_LAST_S = clock.to_seconds(LAST_NS)


def check_range(start: Any, end: Any, names: tuple[str, str] = ("start", "end")) -> tuple[float, float]:
    """Return a time range in seconds, both ends included; None is unbounded.

    Args:
        start: First time stamp.
        end: Last time stamp.
        names: The names that the caller gives them.

    Raises:
        RangeError: An end is not a number, or the end lies before the start.
    """
    low, high = _bound(names[0], start, -math.inf), _bound(names[1], end, math.inf)
    if low > high:
        raise RangeError(f"{names[0]}={start!r} lies after {names[1]}={end!r}; no row can be in that range")
    return low, high


def _bound(name: str, value: Any, default: float) -> float:
    if value is None:
        return default
    try:
        if getattr(getattr(value, "dtype", None), "kind", "f") not in "fiuO":
            raise TypeError  # NumPy makes a number of a datetime64, in a unit of its own
        bound = float(value)
    except (TypeError, ValueError) as error:
        raise RangeError(f"{name}={value!r} is not a number of seconds{seconds_hint(value, name)}") from error
    if math.isnan(bound):
        raise RangeError(f"{name} is NaN; leave it out for an open range")
    return bound


def check_index(name: str, value: Any) -> int:
    """Return a row number or a number of rows.

    Raises:
        RangeError: It is negative or no integer.
    """
    if isinstance(value, bool) or not isinstance(value, SupportsIndex) or value.__index__() < 0:
        raise RangeError(f"{name}={value!r}: it must be an integer, 0 or more")
    return value.__index__()


def to_ns_range(low: float, high: float) -> tuple[int, int]:
    """Return the log times, in ns, that the rows of a range in seconds can have; a little wider than the range."""
    start = 0 if low <= 0 else LAST_NS if low >= _LAST_S else clock.to_nanoseconds(low)
    end = -1 if high < 0 else LAST_NS if high >= _LAST_S else clock.to_nanoseconds(high)
    return max(0, start - TOLERANCE_NS), end if end < 0 else min(LAST_NS, end + TOLERANCE_NS)


def read(topic: StoredTopic, low: float = -math.inf, high: float = math.inf) -> Iterator[Row]:
    """Read a topic's rows with time stamps in [low, high], in time order.

    Each row is a dict of its fields as they were given and `_ts`. Rows of a recorded track with the same double for
    a time stamp are one row, in which later fields win; rows that only share a nanosecond stay apart. Rows of foreign
    messages are never merged, and take their log time where they have no `_ts` of their own.

    Args:
        topic: Which one.
        low: First time stamp, in seconds.
        high: Last time stamp, included, in seconds.
    """
    decoders: dict[tuple[str, int], Decoder] = {}
    start_ns, end_ns = to_ns_range(low, high)
    for batch in topic_messages.read(topic, start_ns, end_ns):
        rows = of_batch(batch, decoders)
        if low > -math.inf or high < math.inf:
            rows = (row for row in rows if low <= row[TIME_KEY] <= high)
        yield from rows


def stamped(
    topic: StoredTopic, low: float = -math.inf, high: float = math.inf
) -> Iterator[tuple[list[Row], list[int]]]:
    """Read the rows of a topic whose messages are never merged, with the log time of each.

    The arguments are those of `read`.

    Yields:
        Some rows, and their log times, in ns.
    """
    decoders: dict[tuple[str, int], Decoder] = {}
    for batch in topic_messages.read(topic, *to_ns_range(low, high)):
        pairs = zip(_decode(batch, decoders), batch.times_ns.tolist(), strict=True)
        stamped_rows = [(row, time) for row, time in pairs if row is not None and low <= row[TIME_KEY] <= high]
        if stamped_rows:
            yield [row for row, _ in stamped_rows], [time for _, time in stamped_rows]


def of_batch(batch: MessageBatch, decoders: dict[tuple[str, int], Decoder]) -> Iterable[Row]:
    """Return the rows of messages, among which are all of each time stamp.

    Args:
        batch: The messages.
        decoders: Of the channels met so far; gets new ones.
    """
    rows = _decode(batch, decoders)
    if bool(np.any(batch.times_ns[1:] == batch.times_ns[:-1])):
        return _merge_same_times(batch, list(rows))
    return (row for row in rows if row is not None)


def _decode(batch: MessageBatch, decoders: dict[tuple[str, int], Decoder]) -> Iterator[Row | None]:
    origins = batch.origins
    if len(origins) == 1:
        yield from decode(origins[0], batch.payloads, batch.times_ns, decoders)
        return
    edges = np.flatnonzero(np.diff(batch.origin_of)) + 1
    start = 0
    for end in (*edges.tolist(), len(batch.payloads)):
        origin = origins[int(batch.origin_of[start])]
        yield from decode(origin, batch.payloads[start:end], batch.times_ns[start:end], decoders)
        start = end


def decode(
    origin: MessageOrigin,
    payloads: Sequence[bytes],
    times_ns: npt.NDArray[np.uint64],
    decoders: dict[tuple[str, int], Decoder],
) -> Iterator[Row | None]:
    """Turn messages into rows, each with its time stamp as `_ts`.

    Args:
        origin: Where they came from.
        payloads: Of the messages.
        times_ns: Their log times, [N].
        decoders: Of the channels met so far; gets new ones.

    Yields:
        A row for each message; None for a message that is lost or left out, if the options allow that.

    Raises:
        DamagedFileError: A payload is not in the encoding that its channel announces.
        EncodingError: The messages cannot be decoded, and that is to be an error.
    """
    decode_one = decoder_of(origin, decoders)
    block = decode_one.block(payloads) if isinstance(decode_one, BlockDecoder) else None
    if block is not None:
        yield from _by_runs(origin, block, payloads, times_ns, decode_one)
        return
    codec, each = codec_of(origin.channel), payloads if isinstance(payloads, list) else list(payloads)
    for start in range(0, len(each), _AT_ONCE):
        some, their_ns = each[start : start + _AT_ONCE], times_ns[start : start + _AT_ONCE]
        plain = None if codec is None else _plain(codec, some, their_ns)
        yield from _one_by_one(origin, some, their_ns, decode_one) if plain is None else plain


def _by_runs(
    origin: MessageOrigin,
    block: DecodableBlock,
    payloads: Sequence[bytes],
    times_ns: npt.NDArray[np.uint64],
    decode_one: Decoder,
) -> Iterator[Row | None]:
    """Decode messages some at once, where they are alike and have the time stamps that their log times say."""
    for first, last, decode_some in block.runs(is_close(block.times, times_ns)):
        for start in range(first, last, _AT_ONCE):
            end = min(start + _AT_ONCE, last)
            rows = None
            if decode_some is not None:
                with suppress(ValueError):  # one of them does not fit its schema
                    rows = decode_some(start, end)
            if rows is None:
                payloads = payloads if isinstance(payloads, list) else list(payloads)
                yield from _one_by_one(origin, payloads[start:end], times_ns[start:end], decode_one)
            else:
                yield from rows


def _plain(codec: MessageCodec, payloads: list[bytes], times_ns: npt.NDArray[np.uint64]) -> list[Row] | None:
    """Decode rows of which nothing but the syntax is to be read, which is nearly all; None where something else is."""
    rows = codec.decode_plain(payloads)
    if rows is None:
        return None
    times = [row.get(TIME_KEY) for row in rows]
    if {*map(type, times)} != {float} or not is_close(np.array(times), times_ns).all():
        return None
    return rows


def _one_by_one(
    origin: MessageOrigin, payloads: list[bytes], times_ns: npt.NDArray[np.uint64], decode_one: Decoder
) -> Iterator[Row | None]:
    for payload, time_ns in zip(payloads, times_ns.tolist(), strict=True):
        try:
            row = decode_one(payload)
        except (ValueError, RecursionError) as error:
            _lose(origin, payload, time_ns, error)
            yield None
            continue
        if row is None:
            yield None
            continue
        time = row.get(TIME_KEY)
        if type(time) is not float or not abs(time * 1e9 - time_ns) <= TOLERANCE_NS:
            _set_time(row, time, time_ns)
        yield row


def decoder_of(origin: MessageOrigin, decoders: dict[tuple[str, int], Decoder]) -> Decoder:
    """Return the decoder of a channel's messages. It is made once, and kept in `decoders`."""
    key = key_of(origin)
    if key not in decoders:
        file, channel = origin.file, origin.channel
        schema = file.index.schema_of(channel)
        decoders[key] = decoder(channel, schema, file.decoding, lambda: file.likely_distribution(channel))
    return decoders[key]


def _lose(origin: MessageOrigin, payload: bytes, time_ns: int, error: Exception) -> None:
    """Lose one message, or raise.

    Raises:
        DamagedFileError: The file is not to be salvaged.
    """
    what = f"a message of topic {origin.channel.topic!r} at {time_ns} ns in the chunk here is not"
    lost = DamagedFileError(
        origin.file.source.name, origin.chunk.offset, f"{what} {origin.channel.message_encoding}: {error}"
    )
    lost.__cause__ = error
    # The hash tells a chunk's messages apart without keeping their bytes.
    origin.file.lose_message(lost, origin.channel.id, hash((time_ns, payload)))


def key_of(origin: MessageOrigin) -> tuple[str, int]:
    """Return a key that no other channel of the recording has."""
    return origin.file.source.name, origin.channel.id


def _set_time(row: Row, time: Any, time_ns: int) -> None:
    """Give a row its time stamp, at the end of the dict: an integer's double, or its log time."""
    row.pop(TIME_KEY, None)
    is_its_time = type(time) is int and abs(time * clock.NS_PER_S - time_ns) <= TOLERANCE_NS
    row[TIME_KEY] = float(time) if is_its_time else clock.to_seconds(time_ns)


def _merge_same_times(batch: MessageBatch, rows: list[Row | None]) -> list[Row]:
    merges = [is_merged(origin.channel) for origin in batch.origins]
    edges = np.flatnonzero(batch.times_ns[1:] != batch.times_ns[:-1]) + 1
    merged: list[Row] = []
    start = 0
    for end in (*edges.tolist(), len(rows)):
        row = rows[start]
        if end - start > 1:
            merged += _merge_group(rows[start:end], [merges[which] for which in batch.origin_of[start:end].tolist()])
        elif row is not None:
            merged.append(row)
        start = end
    return merged


def _merge_group(rows: list[Row | None], merges: list[bool]) -> list[Row]:
    """Merge the rows of one nanosecond that also have the same double, the earliest written first."""
    by_time: dict[float, list[Row]] = {}
    apart: list[tuple[float, list[Row]]] = []
    for row, merges_row in zip(rows, merges, strict=True):
        if row is None:
            continue
        if merges_row:
            by_time.setdefault(row[TIME_KEY], []).append(row)
        else:
            apart.append((row[TIME_KEY], [row]))
    groups = sorted([*by_time.items(), *apart], key=lambda group: group[0])
    return [group[0] if len(group) == 1 else _time_last(merge(group)) for _, group in groups]


def merge_same(rows: Iterable[Row]) -> list[Row]:
    """Merge the rows of each time stamp into one, in the order of their first ones; later ones win."""
    groups: dict[float, list[Row]] = {}
    for row in rows:
        groups.setdefault(row[TIME_KEY], []).append(row)
    return [_time_last(merge(group)) for group in groups.values()]


def _time_last(row: Row) -> Row:
    # Taken out and put in again, because a dict keeps the place of a key, and the time stamp is the last one.
    row[TIME_KEY] = row.pop(TIME_KEY)
    return row
