"""Finds the rows of a block that share topic and time."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from ..mcap.row_arrays import Rows, are_of

Places = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Groups:
    """Groups of two or more rows of one topic and one nanosecond."""

    members: Places
    """The numbers of their rows, [M], group by group, each in the order in which its rows were appended."""
    firsts: Places
    """Where in `members` each group begins, [G]."""

    def __len__(self) -> int:
        return len(self.firsts)

    @property
    def sizes(self) -> Places:
        """How many rows each group has, [G]."""
        return np.diff(self.firsts, append=len(self.members))

    @property
    def leaders(self) -> Places:
        """For each member the place in `members` where its group begins, [M]."""
        return np.repeat(self.firsts, self.sizes)

    def where(self, is_wanted: Flags) -> Groups:
        """Return some of the groups.

        Args:
            is_wanted: Which of them, [G].
        """
        if is_wanted.all():
            return self
        sizes = self.sizes
        wanted_sizes = sizes[is_wanted]
        return Groups(self.members[np.repeat(is_wanted, sizes)], np.cumsum(wanted_sizes) - wanted_sizes)

    def lists(self) -> Iterator[list[int]]:
        """Yield the numbers of the rows of each group."""
        numbers, edges = self.members.tolist(), [*self.firsts.tolist(), len(self.members)]
        for first, last in pairwise(edges):
            yield numbers[first:last]


NO_GROUPS = Groups(np.zeros(0, np.intp), np.zeros(0, np.intp))


def groups_of(rows: Rows, channels: Collection[int]) -> Groups:
    """Return the groups of rows that share topic and nanosecond.

    Args:
        rows: In the order in which they were appended.
        channels: The ids of the channels that are looked at.
    """
    order = np.lexsort((rows.times, rows.channels))
    sorted_channels = rows.channels[order]
    is_like_previous = np.diff(rows.times[order], prepend=-1) == 0
    is_like_previous[1:] &= sorted_channels[1:] == sorted_channels[:-1]
    is_like_previous[:1] = False
    if not is_like_previous.any():
        return NO_GROUPS
    is_like_previous &= are_of(sorted_channels, channels)
    is_like_next = np.append(is_like_previous[1:], False)
    is_member = is_like_previous | is_like_next
    return Groups(order[is_member], np.flatnonzero(~is_like_previous[is_member]))
