"""Merges the rows of many groups at once, by leaving bytes of a block out.

A row that is made of others has the first row's head and opening, the fields of each, and the time stamp of the last.
Where the rows of a group follow each other, as those of a loop do that appends the fields of one moment in turn, the
merged block is the block without the bytes in between. numpy leaves them out while other threads run.
"""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from ..codecs.codec import Codec
from ..mcap.message_records import MESSAGE_HEAD_BYTES
from ..mcap.record_layout import PREFIX_BYTES
from ..mcap.row_arrays import Bytes, Numbers, Rows, are_of
from .disjoint_rows import KeysOf, are_disjoint
from .same_time import Flags, Groups

_NOT_CUT = -1

_SLICE = 1024
_PAUSE_S = 2e-5
"""After so many pieces of bytes the writer thread sleeps for a moment, so that a control loop never waits for all."""


def joinable(
    rows: Rows, groups: Groups, codecs: Mapping[int, Codec], forms: npt.NDArray[np.int32], keys_of: KeysOf
) -> tuple[Flags, Numbers, Numbers]:
    """Tell which groups merge by their bytes alone.

    Args:
        rows: Of the block.
        groups: Rows of one topic and nanosecond.
        codecs: By channel id.
        forms: The form of each row, [N].
        keys_of: Returns the top-level keys of a channel's form.

    Returns:
        Which groups, [G]; for each member of any group where its time stamp begins, and the length of its opening, [M].
    """
    cuts, openings = _cuts(rows, groups, codecs)
    are_joinable = np.logical_and.reduceat(cuts != _NOT_CUT, groups.firsts)
    if are_joinable.any():
        are_joinable &= np.logical_and.reduceat(_have_equal_tails(rows, groups, cuts), groups.firsts)
        are_joinable &= are_disjoint(rows, groups, forms, keys_of)
    return are_joinable, cuts, openings


def _cuts(rows: Rows, groups: Groups, codecs: Mapping[int, Codec]) -> tuple[Numbers, Numbers]:
    """Return where the time stamp of each member begins, or `_NOT_CUT`, and the length of its opening, [M]."""
    cuts = np.full(len(groups.members), _NOT_CUT, np.int64)
    openings = np.zeros(len(groups.members), np.int64)
    channels = rows.channels[groups.members]
    by_encoding: dict[str, tuple[Codec, list[int]]] = {}
    for number in np.unique(channels[groups.firsts]).tolist():
        by_encoding.setdefault(codecs[number].message_encoding, (codecs[number], []))[1].append(number)
    for codec, numbers in by_encoding.values():
        if codec.opening_bytes is None:
            continue
        which = np.flatnonzero(are_of(channels, numbers))
        members = groups.members[which]
        at = codec.cuts(rows.data, rows.starts[members] + MESSAGE_HEAD_BYTES, rows.ends[members])
        if at is not None:
            cuts[which], openings[which] = at, codec.opening_bytes
    return cuts, openings


def _have_equal_tails(rows: Rows, groups: Groups, cuts: Numbers) -> Flags:
    """Tell which members have the same bytes as the first of their group from the cut on, [M].

    Rows of one nanosecond may have different doubles as time stamps. Equal bytes prove equal doubles.
    """
    lengths, leaders = rows.ends[groups.members] - cuts, groups.leaders
    are_equal: Flags = (lengths == lengths[leaders]) & (cuts != _NOT_CUT) & (cuts[leaders] != _NOT_CUT)
    are_compared = are_equal.copy()
    are_compared[groups.firsts] = False
    for length in np.unique(lengths[are_compared]).tolist():
        which = np.flatnonzero(are_compared & (lengths == length))
        # A view: only the windows that are picked are copied.
        tails = np.lib.stride_tricks.sliding_window_view(rows.data, length)
        are_equal[which] = (tails[cuts[which]] == tails[cuts[leaders[which]]]).all(axis=1)
    return are_equal


def join(rows: Rows, groups: Groups, cuts: Numbers, openings: Numbers) -> tuple[Rows, Flags]:
    """Put the merged row of each group in the place of its first row.

    Args:
        rows: Of the block.
        groups: Those that merge by their bytes alone, one or more.
        cuts: Where the time stamp of each member begins, [M].
        openings: How long the opening of each member is, [M].

    Returns:
        The rows that are left, and which of the old ones these are, [N].
    """
    begins, ends = rows.starts.copy(), rows.ends.copy()
    is_first = np.zeros(len(groups.members), np.bool_)
    is_first[groups.firsts] = True
    later, is_followed = groups.members[~is_first], np.append(~is_first[1:], False)
    begins[later] += MESSAGE_HEAD_BYTES + openings[~is_first]
    ends[groups.members[is_followed]] = cuts[is_followed]
    is_left = np.ones(len(rows), np.bool_)
    is_left[later] = False
    order = _in_output(rows, groups)
    begins, ends = begins[order], ends[order]
    lengths = np.add.reduceat(ends - begins, np.flatnonzero(is_left[order]))
    data = _copied(rows.data, begins, ends)
    new_ends = np.cumsum(lengths)
    left = np.flatnonzero(is_left)
    merged = np.searchsorted(left, groups.members[groups.firsts])
    _put_lengths(data, new_ends[merged] - lengths[merged], lengths[merged])
    return Rows(data, new_ends - lengths, new_ends, rows.channels[left], rows.times[left]), is_left


def _in_output(rows: Rows, groups: Groups) -> npt.NDArray[np.intp] | slice:
    """Return the numbers of the rows in the order of their bytes in the merged block."""
    leaders = np.arange(len(rows))
    leaders[groups.members] = groups.members[groups.leaders]
    if (np.diff(leaders) >= 0).all():
        return slice(None)
    return np.argsort(leaders, kind="stable")


def _copied(data: Bytes, begins: Numbers, ends: Numbers) -> Bytes:
    """Return some pieces of a block one behind the other; pieces that follow each other in it are copied as one."""
    seams = np.flatnonzero(begins[1:] != ends[:-1])
    begins, ends = begins[np.append(0, seams + 1)], ends[np.append(seams, len(ends) - 1)]
    if (begins[1:] < ends[:-1]).any():
        return _joined(data, begins, ends)
    # What is left out and what is kept, in turn.
    lengths = np.diff(np.stack((begins, ends), axis=1).ravel(), prepend=0)
    is_kept = np.repeat(np.arange(len(lengths)) % 2 == 1, lengths)
    kept: Bytes = data[: len(is_kept)][is_kept]
    return kept


def _joined(data: Bytes, begins: Numbers, ends: Numbers) -> Bytes:
    """Return pieces of a block in any order."""
    block = memoryview(data)  # type: ignore[arg-type]  # numpy's stubs know no buffers before 3.12
    joined = bytearray()
    for first in range(0, len(begins), _SLICE):
        part = slice(first, first + _SLICE)
        joined += b"".join([block[a:b] for a, b in zip(begins[part].tolist(), ends[part].tolist(), strict=True)])
        time.sleep(_PAUSE_S)
    return np.frombuffer(joined, np.uint8)


def _put_lengths(data: Bytes, starts: Numbers, lengths: Numbers) -> None:
    """Write the lengths of some Message records into their heads."""
    contents = (lengths - PREFIX_BYTES).astype("<u8").view(np.uint8).reshape(-1, 8)
    data[(starts + 1)[:, None] + np.arange(8)] = contents
