"""Joins two tables of one take row by row: rows of the same time become one row."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from ..text.number_cells import Floats

Rows = tuple[Floats, Floats]
"""Time stamps, [N], s, ascending, and numbers, [N, C]."""


def joined(left_rows: Iterable[Rows], right_rows: Iterable[Rows], widths: tuple[int, int]) -> Iterator[Rows]:
    """Yield the rows of two tables side by side, NaN where one of them has none; memory holds a part of each.

    The k-th row of a time in one table belongs to the k-th row of that time in the other.

    Args:
        left_rows: Rows, some at a time.
        right_rows: The same.
        widths: How many columns they have.
    """
    left, right = _RowStream(left_rows, widths[0]), _RowStream(right_rows, widths[1])
    while True:
        # Below the smaller bound no more rows can come from either table, so these rows are final.
        bound = min(left.bound(), right.bound())
        first, second = left.take(bound), right.take(bound)
        if not len(first[0]) and not len(second[0]):  # times that are not in order
            first, second = left.take(np.inf), right.take(np.inf)
        if len(first[0]) or len(second[0]):
            yield _side_by_side(first, second)
        elif left.is_over and right.is_over:
            return


class _RowStream:
    """One table, of which some rows were read and not yet taken."""

    def __init__(self, rows: Iterable[Rows], width: int) -> None:
        self._rows = iter(rows)
        self._times: Floats = np.empty(0)
        self._values: Floats = np.empty((0, width))
        self.is_over = False

    def bound(self) -> float:
        """Return the time before which all rows were read; reads on if there is none. More of its rows may follow."""
        while not self.is_over and (not len(self._times) or self._times[0] == self._times[-1]):
            more = next(self._rows, None)
            if more is None:
                self.is_over = True
            else:
                self._times = np.concatenate((self._times, more[0]))
                self._values = np.concatenate((self._values, more[1]))
        return np.inf if self.is_over else float(self._times[-1])

    def take(self, bound: float) -> Rows:
        """Return the rows before a time, and all if it is infinite."""
        count = len(self._times) if bound == np.inf else int(np.searchsorted(self._times, bound))
        taken = self._times[:count], self._values[:count]
        self._times, self._values = self._times[count:], self._values[count:]
        return taken


def _side_by_side(first: Rows, second: Rows) -> Rows:
    first, second = _sorted(first), _sorted(second)
    keys = [_numbered(times) for times in (first[0], second[0])]
    union, where = np.unique(np.concatenate(keys), axis=0, return_inverse=True)
    where = where.reshape(-1)
    values = np.full((len(union), first[1].shape[1] + second[1].shape[1]), np.nan)
    values[where[: len(keys[0])], : first[1].shape[1]] = first[1]
    values[where[len(keys[0]) :], first[1].shape[1] :] = second[1]
    return union[:, 0], values


def _sorted(rows: Rows) -> Rows:
    order = np.argsort(rows[0], kind="stable")
    return rows[0][order], rows[1][order]


def _numbered(times: Floats) -> Floats:
    """Return each time with the number of equal times before it, [N, 2]."""
    first = np.searchsorted(times, times)
    return np.stack((times, np.arange(len(times)) - first), axis=1)
