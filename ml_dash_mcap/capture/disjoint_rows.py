"""Tells of many groups of rows at once whether the rows of a group have a field in common."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from ..codecs.codec import UNKNOWN_FORM
from ..mcap.row_arrays import Rows
from ..rows.plain_row import TIME_KEY
from .same_time import Flags, Groups

KeysOf = Callable[[int, int], frozenset[str]]
"""Returns the top-level keys of a channel's form."""

_WORD_KEYS = 32
"""Keys in a number of 64 bits: the sum of 2^32 such sets still fits."""

_MOST_KEYS = 2048
"""Of one channel in one block. Groups of rows with more are judged one by one."""

_FORM_BITS = 32


def are_disjoint(rows: Rows, groups: Groups, forms: npt.NDArray[np.int32], keys_of: KeysOf) -> Flags:
    """Tell which groups are certain to have no field twice, [G].

    Args:
        rows: Of the block.
        groups: Rows of one topic and time.
        forms: The form of each row, [N].
        keys_of: Asked for each form once.
    """
    member_forms = forms[groups.members]
    are_certain = np.logical_and.reduceat(member_forms != UNKNOWN_FORM, groups.firsts)
    pairs = (rows.channels[groups.members] << _FORM_BITS) | np.maximum(member_forms, 0)
    distinct, inverse = np.unique(pairs, return_inverse=True)
    # Only forms of groups that may be disjoint are asked for: an unknown one has no keys.
    is_asked = np.zeros(len(distinct), np.bool_)
    is_asked[inverse[np.repeat(are_certain, groups.sizes)]] = True
    keys = [
        keys_of(pair >> _FORM_BITS, pair & ((1 << _FORM_BITS) - 1)) - {TIME_KEY} if asked else frozenset()
        for pair, asked in zip(distinct.tolist(), is_asked.tolist(), strict=True)
    ]
    sets = _as_bits((distinct >> _FORM_BITS).tolist(), keys)
    if sets is None:
        return np.zeros(len(groups), np.bool_)
    for word in sets.T:
        bits = word[inverse]
        # Of sets without a common element, and of no others, the sum is the union.
        are_certain &= np.add.reduceat(bits, groups.firsts) == np.bitwise_or.reduceat(bits, groups.firsts)
    return are_certain


def _as_bits(channels: list[int], keys: list[frozenset[str]]) -> npt.NDArray[np.uint64] | None:
    """Return the sets of keys as bits, [sets, words]; None if a channel has too many keys."""
    numbers: dict[int, dict[str, int]] = {}
    sets: list[list[int]] = []
    for channel, names in zip(channels, keys, strict=True):
        of_channel = numbers.setdefault(channel, {})
        sets.append([of_channel.setdefault(name, len(of_channel)) for name in names])
        if len(of_channel) > _MOST_KEYS:
            return None
    words = max(map(len, numbers.values()), default=0) // _WORD_KEYS + 1
    bits = np.zeros((len(sets), words), np.uint64)
    for row, places in zip(bits, sets, strict=True):
        for place in places:
            row[place // _WORD_KEYS] |= np.uint64(1 << place % _WORD_KEYS)
    return bits
