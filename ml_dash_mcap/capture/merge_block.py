"""Merges the rows of one topic and one time stamp within a block into a single row.

Rows of different blocks are left to the reader: a recovery tells blocks by their number, so no row may change blocks.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from ..codecs.codec import UNKNOWN_FORM, Codec
from ..mcap.message_records import MESSAGE_HEAD_BYTES
from ..mcap.row_arrays import Rows, replaced
from .disjoint_rows import KeysOf
from .join_rows import join, joinable
from .same_time import Groups, groups_of

Note = Callable[[int, list[int], bool], None]
"""Takes a channel id, the numbers of rows that merge, and whether these have no field in common."""

_SLICE = 64
_MOST_BYTES = 4 * 1024 * 1024
"""Rows of one time with more bytes, which would have to be decoded to be merged, are left to the reader."""

_PAUSE_S = 2e-5
"""After so many merged rows the writer thread sleeps for a moment, so that a control loop never waits for them all."""


def merge_same_time(
    rows: Rows,
    codecs: Mapping[int, Codec],
    forms: npt.NDArray[np.int32],
    keys_of: KeysOf,
    note: Note | None = None,
) -> Rows:
    """Merge the rows that share topic and time stamp; the same object comes back where there are none.

    Args:
        rows: In the order in which they were appended.
        codecs: By channel id, the codec of the channels whose rows merge (those of metrics and logs do not).
        forms: The form of each row, [N].
        keys_of: Returns the top-level keys of a channel's form.
        note: Called for each merged row.
    """
    groups = groups_of(rows, codecs)
    if not len(groups):
        return rows
    are_joinable, cuts, openings = joinable(rows, groups, codecs, forms, keys_of)
    others = groups.where(~are_joinable)
    numbers = np.arange(len(rows))
    if are_joinable.any():
        groups, is_member = groups.where(are_joinable), np.repeat(are_joinable, groups.sizes)
        if note is not None:
            _note_disjoint(rows, groups, note)
        rows, is_left = join(rows, groups, cuts[is_member], openings[is_member])
        numbers = np.flatnonzero(is_left)
        others = Groups(np.searchsorted(numbers, others.members), others.firsts)
    if not len(others):
        return rows
    return _merge_others(rows, others, numbers, codecs, _FormKeys(forms[numbers].tolist(), keys_of), note)


def _note_disjoint(rows: Rows, groups: Groups, note: Note) -> None:
    channels = rows.channels[groups.members[groups.firsts]].tolist()
    for channel, numbers in zip(channels, groups.lists(), strict=True):
        note(channel, numbers, True)


def _merge_others(
    rows: Rows,
    groups: Groups,
    numbers: npt.NDArray[np.intp],
    codecs: Mapping[int, Codec],
    form_keys: _FormKeys,
    note: Note | None,
) -> Rows:
    """Merge the rows of groups that cannot be merged many at a time.

    Args:
        rows: Of the block; some may be merged already.
        groups: Of these rows.
        numbers: The number of each row in the block as it was appended, [N].
        codecs: By channel id.
        form_keys: Of these rows.
        note: See `merge_same_time`.
    """
    merged = _Merged(rows)
    block = memoryview(rows.data)  # type: ignore[arg-type]  # numpy's stubs know no buffers before 3.12
    starts, ends = (rows.starts + MESSAGE_HEAD_BYTES).tolist(), rows.ends.tolist()
    times, channels = rows.times.tolist(), rows.channels.tolist()
    for count, group in enumerate(groups.lists()):
        if count % _SLICE == _SLICE - 1:
            time.sleep(_PAUSE_S)
        channel = channels[group[0]]
        codec = codecs[channel]
        encoded = [bytes(block[starts[row] : ends[row]]) for row in group]
        cuts = codec.cut(encoded)
        for places in _same_times(codec, encoded, cuts):
            same, parts = [group[place] for place in places], [encoded[place] for place in places]
            is_disjoint = form_keys.are_disjoint(channel, same)
            if not is_disjoint and sum(map(len, parts)) > _MOST_BYTES:
                continue
            joined = codec.join_disjoint(parts, [cuts[place] for place in places]) if is_disjoint else codec.join(parts)
            merged.put(same, times[same[0]], joined)
            if note is not None:
                note(channel, numbers[same].tolist(), is_disjoint)
    return merged.rows()


def merge_each(
    rows: Rows,
    codecs: Mapping[int, Codec],
    on_failure: Callable[[Exception], None],
    note: Note | None,
) -> Rows:
    """Merge rows as `merge_same_time` does, one group at a time. Groups that cannot be merged are left to the reader.

    Args:
        rows: In the order in which they were appended.
        codecs: By channel id, the codec of the channels whose rows merge.
        on_failure: Called with the error that kept rows of one time from being merged.
        note: See `merge_same_time`.
    """
    merged = _Merged(rows)
    for group in groups_of(rows, codecs).lists():
        try:
            channel = int(rows.channels[group[0]])
            codec = codecs[channel]
            encoded = [rows.payload(row) for row in group]
            for places in _same_times(codec, encoded, codec.cut(encoded)):
                numbers, parts = [group[place] for place in places], [encoded[place] for place in places]
                if sum(map(len, parts)) > _MOST_BYTES:
                    continue
                is_disjoint = _are_disjoint([codec.keys_of(part) for part in parts])
                merged.put(numbers, int(rows.times[numbers[0]]), codec.join(parts))
                if note is not None:
                    note(channel, numbers, is_disjoint)
        except Exception as error:
            on_failure(error)
    return merged.rows()


class _Merged:
    """The rows of a block, of which some are replaced by merged rows and others dropped."""

    def __init__(self, rows: Rows) -> None:
        self._rows = rows
        self._payloads: dict[int, tuple[int, bytes]] = {}
        """By row number, the log time (ns) and the payload of a row that others became part of."""
        self._dropped: list[int] = []
        """The numbers of the rows that became part of others."""

    def put(self, numbers: list[int], time_ns: int, payload: bytes) -> None:
        """Put a merged row in the place of the first of some rows, and drop the others."""
        self._payloads[numbers[0]] = (time_ns, payload)
        self._dropped += numbers[1:]

    def rows(self) -> Rows:
        """Return the rows that are left; the same object where none were merged."""
        if not self._payloads:
            return self._rows
        keep = np.ones(len(self._rows), np.bool_)
        keep[self._dropped] = False
        return replaced(self._rows, keep, self._payloads)


class _FormKeys:
    """Tells from the forms of rows whether they have a field in common."""

    def __init__(self, forms: list[int], keys_of: KeysOf) -> None:
        self._forms = forms
        self._keys_of = keys_of
        self._answers: dict[tuple[int, ...], bool] = {}

    def are_disjoint(self, channel: int, rows: list[int]) -> bool:
        """Whether no two of some rows have a field in common; False where the form of one is not known."""
        # The same few combinations of forms come again and again, so their answers are kept for the block.
        forms = [self._forms[row] for row in rows]
        key = (channel, *forms)
        answer = self._answers.get(key)
        if answer is None:
            answer = UNKNOWN_FORM not in forms and _are_disjoint([self._keys_of(channel, form) for form in forms])
            self._answers[key] = answer
        return answer


def _same_times(codec: Codec, payloads: Sequence[bytes], cuts: Sequence[int]) -> list[list[int]]:
    """Return groups of two or more rows with exactly the same time stamp, each row as its place in `payloads`."""
    # Rows of one nanosecond may have different doubles as time stamps. Encoded rows end with the time stamp, so equal
    # tails prove equal doubles without decoding.
    tail = payloads[0][cuts[0] :]
    if all(payload[at:] == tail for payload, at in zip(payloads, cuts, strict=True)):
        return [list(range(len(payloads)))]
    by_time: dict[float, list[int]] = {}
    for place, payload in enumerate(payloads):
        by_time.setdefault(codec.time_of(payload), []).append(place)
    return [places for places in by_time.values() if len(places) > 1]


def _are_disjoint(keys: list[frozenset[str]]) -> bool:
    """Whether no key but the time stamp is in two of the sets."""
    # Every set has the time stamp: the sum counts it len(keys) times, the union once.
    return len(frozenset().union(*keys)) == sum(map(len, keys)) - len(keys) + 1
