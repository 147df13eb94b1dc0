"""Rows of one topic and one time stamp within a block become one.

Rows of different blocks are left to the reader: each block is one chunk, by whose number a recovery knows it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import numpy.typing as npt

from ..rows import merge
from ..rows.skeleton import Form
from .rows import Rows, replaced

_SLICE = 32
_PAUSE_S = 2e-5
"""After so many merged rows the writer thread sleeps for a moment, so that a control loop never waits for them all."""


def merge_same_time(rows: Rows, mergeable: npt.NDArray[np.bool_], form_of: Callable[[int], Form]) -> Rows:
    """Merge the rows that share topic and time stamp; the same object comes back where there are none.

    Args:
        rows: In the order in which they were appended.
        mergeable: By channel id, whether its rows merge (metrics and logs do not).
        form_of: Gives what is known of a row's keys.
    """
    keep = np.ones(len(rows), np.bool_)
    payloads: dict[int, tuple[int, bytes]] = {}
    for count, group in enumerate(_groups(rows, mergeable)):
        if count % _SLICE == _SLICE - 1:
            time.sleep(_PAUSE_S)
        for same in _by_exact_time(rows, group):
            encoded = [rows.payload(row) for row in same]
            keys = [form_of(row).keys for row in same]
            join = merge.join_disjoint if _disjoint(keys) else merge.join
            payloads[same[0]] = (int(rows.times[same[0]]), join(encoded))
            keep[same[1:]] = False
    return replaced(rows, keep, payloads) if payloads else rows


def _groups(rows: Rows, mergeable: npt.NDArray[np.bool_]) -> Iterator[list[int]]:
    """Yield the rows that share topic and nanosecond, two or more, in the order in which they were appended."""
    order = np.lexsort((rows.times, rows.channels))
    channels = rows.channels[order]
    same = (np.diff(rows.times[order]) == 0) & (channels[1:] == channels[:-1])
    if not same.any():
        return
    same &= mergeable[channels[1:]]
    edges = np.diff(np.concatenate(([False], same, [False])).astype(np.int8))
    for first, last in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
        yield sorted(order[first : last + 1].tolist())


def _by_exact_time(rows: Rows, group: list[int]) -> Iterator[list[int]]:
    """Split rows of one nanosecond by their exact time stamp; yields those that are not alone."""
    by_time: dict[float, list[int]] = {}
    for row in group:
        by_time.setdefault(merge.time_of(rows.payload(row)), []).append(row)
    return (same for same in by_time.values() if len(same) > 1)


def _disjoint(keys: Sequence[frozenset[str]]) -> bool:
    """Whether no key but the time stamp stands in two of them."""
    return len(frozenset().union(*keys)) == sum(map(len, keys)) - len(keys) + 1
