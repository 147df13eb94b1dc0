"""Rows of one topic and one time stamp within a block become one.

Rows of different blocks are left to the reader: a recovery knows blocks by their number, so none may go into another.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from ..codecs.codec import UNKNOWN_FORM, Codec
from ..mcap.message_records import MESSAGE_HEAD_BYTES
from ..mcap.row_arrays import Rows, replaced

_SLICE = 64
_MOST_BYTES = 4 * 1024 * 1024
"""Rows of one time with more bytes, which would have to be decoded to be merged, are left to the reader."""

_PAUSE_S = 2e-5
"""After so many merged rows the writer thread sleeps for a moment, so that a control loop never waits for them all."""


def merge_same_time(
    rows: Rows,
    codecs: Mapping[int, Codec],
    forms: npt.NDArray[np.int32],
    keys_of: Callable[[int, int], frozenset[str]],
    note: Callable[[int, list[int], bool], None] = lambda channel, same, is_disjoint: None,
) -> Rows:
    """Merge the rows that share topic and time stamp; the same object comes back where there are none.

    Args:
        rows: In the order in which they were appended.
        codecs: By channel id, the codec of the channels whose rows merge (those of metrics and logs do not).
        forms: The form of each row, [N].
        keys_of: Gives the top-level keys of a channel's form.
        note: Called with the channel, the numbers of the rows that become one, and whether no field is in two of them.
    """
    groups = _groups(rows, codecs)
    if not groups:
        return rows
    payloads: dict[int, tuple[int, bytes]] = {}
    dropped: list[int] = []
    block = memoryview(rows.data)  # type: ignore[arg-type]  # numpy's stubs know no buffers before 3.12
    starts, ends = (rows.starts + MESSAGE_HEAD_BYTES).tolist(), rows.ends.tolist()
    times, channels, form_numbers = rows.times.tolist(), rows.channels.tolist(), forms.tolist()
    disjoint: dict[tuple[int, ...], bool] = {}
    for count, group in enumerate(groups):
        if count % _SLICE == _SLICE - 1:
            time.sleep(_PAUSE_S)
        codec = codecs[channels[group[0]]]
        encoded = [bytes(block[starts[row] : ends[row]]) for row in group]
        cuts = codec.cut(encoded)
        for places in _same_times(codec, encoded, cuts):
            same = group if len(places) == len(group) else [group[place] for place in places]
            parts = encoded if same is group else [encoded[place] for place in places]
            key = (channels[same[0]], *[form_numbers[row] for row in same])
            is_disjoint = disjoint.get(key)
            if is_disjoint is None:
                is_disjoint = UNKNOWN_FORM not in key[1:]
                if is_disjoint:
                    is_disjoint = _are_disjoint([keys_of(key[0], form) for form in key[1:]])
                disjoint[key] = is_disjoint
            if not is_disjoint and sum(map(len, parts)) > _MOST_BYTES:
                continue
            if is_disjoint:
                joined = codec.join_disjoint(parts, cuts if same is group else [cuts[place] for place in places])
            else:
                joined = codec.join(parts)
            note(key[0], same, is_disjoint)
            payloads[same[0]] = (times[same[0]], joined)
            dropped += same[1:]
    if not payloads:
        return rows
    keep = np.ones(len(rows), np.bool_)
    keep[dropped] = False
    return replaced(rows, keep, payloads)


def merge_each(
    rows: Rows,
    codecs: Mapping[int, Codec],
    on_failure: Callable[[Exception], None],
    note: Callable[[int, list[int], bool], None],
) -> Rows:
    """Do the same by decoding all rows that share their time; those that cannot be merged stay for the reader.

    Args:
        rows: In the order in which they were appended.
        codecs: By channel id, the codec of the channels whose rows merge.
        on_failure: Told what kept rows of one time from being merged.
        note: As that of `merge_same_time`.
    """
    payloads: dict[int, tuple[int, bytes]] = {}
    keep = np.ones(len(rows), np.bool_)
    for group in _groups(rows, codecs):
        try:
            codec = codecs[int(rows.channels[group[0]])]
            encoded = [rows.payload(row) for row in group]
            for places in _same_times(codec, encoded, codec.cut(encoded)):
                same = [group[place] for place in places]
                parts = [encoded[place] for place in places]
                if sum(map(len, parts)) > _MOST_BYTES:
                    continue
                is_disjoint = _are_disjoint([codec.keys_of(part) for part in parts])
                payloads[same[0]] = (int(rows.times[same[0]]), codec.join(parts))
                keep[same[1:]] = False
                note(int(rows.channels[same[0]]), same, is_disjoint)
        except Exception as error:
            on_failure(error)
    return replaced(rows, keep, payloads) if payloads else rows


def _same_times(codec: Codec, payloads: Sequence[bytes], cuts: Sequence[int]) -> list[list[int]]:
    """Return which encoded rows have exactly the same time stamp, two or more, each by its place, in order."""
    tail = payloads[0][cuts[0] :]
    if all(payload[at:] == tail for payload, at in zip(payloads, cuts, strict=True)):
        return [list(range(len(payloads)))]
    by_time: dict[float, list[int]] = {}
    for place, payload in enumerate(payloads):
        by_time.setdefault(codec.time_of(payload), []).append(place)
    return [same for same in by_time.values() if len(same) > 1]


def _groups(rows: Rows, codecs: Mapping[int, Codec]) -> list[list[int]]:
    """Return the rows that share topic and nanosecond, two or more, in the order in which they were appended."""
    order = np.lexsort((rows.times, rows.channels))
    channels = rows.channels[order]
    same = (np.diff(rows.times[order]) == 0) & (channels[1:] == channels[:-1])
    if not same.any():
        return []
    same &= np.isin(channels[1:], list(codecs))
    return list(_runs(order, same))


def _runs(order: npt.NDArray[np.intp], same: npt.NDArray[np.bool_]) -> Iterator[list[int]]:
    """Yield the numbers in `order` that are each like the one before."""
    edges = np.diff(np.concatenate(([False], same, [False])).astype(np.int8))
    numbers = order.tolist()
    for first, last in zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True):
        yield sorted(numbers[first : last + 1])


def _are_disjoint(keys: list[frozenset[str]]) -> bool:
    """Whether no key but the time stamp stands in two of them."""
    return len(frozenset().union(*keys)) == sum(map(len, keys)) - len(keys) + 1
