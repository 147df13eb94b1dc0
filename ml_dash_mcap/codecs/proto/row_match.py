"""Finds the rows of a template among many, all at once, and where the values of each lie."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..payloads import Payloads
from .row_template import Enter, FixedPlace, FixedRun, RowTemplate, Varying, bytes_of_each

Bytes = npt.NDArray[np.uint8]
Numbers = npt.NDArray[np.int64]

_MOST_VARINT_BYTES = 5
"""Longer lengths than these spell are beyond the end of any row."""

_MOST_BYTES = 2**62
"""More than the bytes of any value."""

_FEW_BYTES = 64
"""Up to so many bytes a value, they are gathered by their places, else by slices."""


@dataclass(frozen=True, slots=True)
class Values:
    """The bytes of one value in each of some rows."""

    data: Bytes
    starts: Numbers
    """Where they begin in the data, [N]."""
    lengths: Numbers | int
    """How many there are in each row, [N]; one number if that is the same in all."""

    def each_length(self) -> Numbers:
        """Return how many bytes each row has, [N]."""
        return np.full(len(self.starts), self.lengths) if isinstance(self.lengths, int) else self.lengths

    def joined(self) -> Bytes:
        """Return the bytes of all rows, one behind the other."""
        return gather(self.data, self.starts, self.lengths)


@dataclass(frozen=True, slots=True)
class MatchedRows:
    """The rows of one template."""

    which: npt.NDArray[np.intp]
    """Their numbers, [N]."""
    values: Sequence[Values]
    """By the numbers that values have in the template."""


def match(payloads: Payloads, which: npt.NDArray[np.intp], template: RowTemplate) -> MatchedRows:
    """Return those of some rows that are laid out as a template says.

    Args:
        payloads: All rows.
        which: Numbers of the rows to look at, [N].
        template: Of the rows.
    """
    steps = template.steps
    if template.is_fixed:
        which = which[(payloads.ends - payloads.starts)[which] == template.length]
    if not len(which):
        return MatchedRows(which, ())
    walk = _Walk(payloads.data, payloads.starts[which], payloads.ends[which])
    run_starts: dict[int, Numbers] = {}
    varying: dict[int, tuple[Numbers, Numbers]] = {}
    for number, step in enumerate(steps):
        if isinstance(step, FixedRun):
            run_starts[number] = walk.run(step)
        elif isinstance(step, Varying):
            member = template.members[step.value]
            varying[step.value] = walk.varying()
            if member.slot.is_packed:
                each = min(bytes_of_each(member.slot), _MOST_BYTES)
                walk.refuse(varying[step.value][1] % each != 0)
        elif isinstance(step, Enter):
            walk.enter()
        else:
            walk.leave()
    is_match = walk.end()
    return _chosen(payloads.data, which, is_match, template.places, run_starts, varying)


def _chosen(
    data: Bytes,
    which: npt.NDArray[np.intp],
    is_match: npt.NDArray[np.bool_],
    places: Sequence[FixedPlace | None],
    run_starts: dict[int, Numbers],
    varying: dict[int, tuple[Numbers, Numbers]],
) -> MatchedRows:
    """Return the values of the rows that match."""
    if not is_match.all():
        which = which[is_match]
        run_starts = {number: starts[is_match] for number, starts in run_starts.items()}
        varying = {value: (starts[is_match], lengths[is_match]) for value, (starts, lengths) in varying.items()}
    values = []
    for value, place in enumerate(places):
        if place is None:
            values.append(Values(data, *varying[value]))
        else:
            values.append(Values(data, run_starts[place.step] + place.at, place.length))
    return MatchedRows(which, values)


class _Walk:
    """Walks through many rows in step. Rows that differ from the template are noted, and walked through as if not."""

    def __init__(self, data: Bytes, starts: Numbers, ends: Numbers) -> None:
        self._data = data
        self._at = starts
        self._ends = ends
        self._is_match = np.ones(len(starts), np.bool_)
        self._dict_ends: list[Numbers] = []

    def refuse(self, is_other: npt.NDArray[np.bool_]) -> None:
        """Note that some rows differ, [N]."""
        self._is_match &= ~is_other

    def run(self, run: FixedRun) -> Numbers:
        """Compare a run, and go behind it; returns where it starts, [N]."""
        fits = self._at + run.length <= self._ends
        if not fits.all():
            self._is_match &= fits
            if not fits.any():
                return self._at
            # The data has a run of this length somewhere, so it has one at its start.
            self._at = np.where(fits, self._at, 0)
        starts = self._at
        matrix = windows(self._data, run.length)[starts].view(np.uint8).reshape(len(starts), run.length)
        for at, byte in run.marks:  # a place at a time: all at once would take an index of rows x marks
            self._is_match &= matrix[:, at] == byte
        for at in run.booleans:
            self._is_match &= matrix[:, at] < 0x80
        self._go(starts + run.length)
        return starts

    def varying(self) -> tuple[Numbers, Numbers]:
        """Go behind a length and as many bytes; returns where they start, and how many there are, [N] each."""
        lengths = self._length()
        starts = self._at
        self._go(starts + lengths)
        return starts, lengths

    def enter(self) -> None:
        """Go behind the length of a dict."""
        lengths = self._length()
        self._dict_ends.append(self._at + lengths)

    def leave(self) -> None:
        """Compare the place with the end of the dict."""
        self._is_match &= self._at == self._dict_ends.pop()

    def end(self) -> npt.NDArray[np.bool_]:
        """Return which rows end here and have matched, [N]."""
        self._is_match &= self._at == self._ends
        return self._is_match

    def _go(self, to: Numbers) -> None:
        self._is_match &= to <= self._ends
        self._at = np.minimum(to, self._ends)

    def _length(self) -> Numbers:
        """Read a length. It is 0 in rows that do not hold as many bytes."""
        first = self._byte(self._at)
        lengths = first.astype(np.int64)
        at = self._at + 1
        if bool((first >= 0x80).any()):
            lengths, at = self._long_lengths()
        self._go(at)
        fits = lengths <= self._ends - self._at
        self._is_match &= fits
        return lengths if fits.all() else np.where(fits, lengths, 0)

    def _byte(self, at: Numbers) -> Bytes:
        # Where a row ends here, any byte will do, because no row goes on behind its end.
        return self._data[np.minimum(at, len(self._data) - 1)]

    def _long_lengths(self) -> tuple[Numbers, Numbers]:
        at, lengths = self._at.copy(), np.zeros(len(self._at), np.int64)
        goes_on = np.ones(len(at), np.bool_)
        for place in range(_MOST_VARINT_BYTES):
            byte = self._byte(at).astype(np.int64)
            lengths += np.where(goes_on, (byte & 0x7F) << 7 * place, 0)
            at += goes_on
            goes_on &= byte >= 0x80
        self._is_match &= ~goes_on
        return lengths, at


# -- bytes -------------------------------------------------------------------------------------------------------------


def windows(data: Bytes, size: int) -> npt.NDArray[np.void]:
    """Return a view on the `size` bytes that begin at each byte; indexing it copies."""
    view: npt.NDArray[np.void] = np.ndarray((len(data) - size + 1,), np.dtype((np.void, size)), data, strides=(1,))
    return view


def gather(data: Bytes, starts: Numbers, lengths: Numbers | int) -> Bytes:
    """Return the bytes at some places, one behind the other.

    Args:
        data: Holds them.
        starts: Where they begin, [N].
        lengths: How many to take at each place, [N], or at all.
    """
    if not isinstance(lengths, int):
        same = int(lengths[0]) if len(lengths) else 0
        if not bool((lengths == same).all()):
            return _gather_varying(data, starts, lengths)
        lengths = same
    if not lengths or not len(starts):
        return np.empty(0, np.uint8)
    return windows(data, lengths)[starts].view(np.uint8)


def _gather_varying(data: Bytes, starts: Numbers, lengths: Numbers) -> Bytes:
    total = int(lengths.sum())
    unit = 8 if not bool((lengths & 7).any()) else 1
    if total // unit > _FEW_BYTES * len(starts):
        spans = zip(starts.tolist(), (starts + lengths).tolist(), strict=True)
        view = data.data
        return np.frombuffer(b"".join([view[start:end] for start, end in spans]), np.uint8)
    counts = lengths // unit
    before = np.cumsum(counts) - counts
    places = np.repeat(starts - before * unit, counts) + np.arange(total // unit) * unit
    if unit == 1:
        return data[places]
    return windows(data, unit)[places].view(np.uint8)
