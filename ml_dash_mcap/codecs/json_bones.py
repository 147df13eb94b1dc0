"""Reduces the encoded rows of a block to their skeletons: the bytes that are left without numbers."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt

Bytes = npt.NDArray[np.uint8]
Offsets = npt.NDArray[np.int64]

_QUOTE, _MINUS, _ZERO, _NINE, _COLON, _BACKSLASH, _E = (ord(character) for character in '"-09:\\e')


class Bones:
    """The bytes of a block with its rows, reduced to skeletons once for all topics."""

    def __init__(self, data: Bytes, starts: Offsets, ends: Offsets, head: int) -> None:
        """Reduce a block.

        Args:
            data: Its bytes.
            starts: Where the encoded rows start, [N].
            ends: Where they end, [N].
            head: How many bytes before each row are none of its text.
        """
        self._data = data
        self._row_starts = starts
        self._row_ends = ends
        # No digit: bytes below "0" wrap around to large numbers.
        wrapped = data - np.uint8(_ZERO)
        keep = wrapped > _NINE - _ZERO
        keep &= np.not_equal(data, _MINUS, out=wrapped.view(np.bool_))
        np.lib.stride_tricks.sliding_window_view(keep, head, writeable=True)[starts - head] = False
        self._keep = keep
        at = np.flatnonzero(keep)
        bare = data[at]
        exponents = _exponents(data, at, bare)
        self._exponents = at[exponents]
        self._bare_at, self.bare = _without(at, bare, exponents)
        """What is left of all rows without numbers, and without digits in any text, keys included."""

    @cached_property
    def _kept(self) -> tuple[Offsets, Bytes]:
        """Where in the block the bytes of the skeletons lie, and these."""
        at, bare = self._bare_at, self.bare
        backslashes = _rows_with_backslash(at, bare, self._row_starts, self._row_ends)
        spared = _spared(len(self._data), _cut_keys(at, bare), backslashes)
        if spared is None:
            return at, bare
        at = np.flatnonzero(self._keep | spared)
        kept = self._data[at]
        exponents = _exponents(self._data, at, kept)
        return _without(at, kept, exponents[~spared[at[exponents]]])

    @property
    def kept(self) -> Bytes:
        """The skeletons, one after the other."""
        return self._kept[1]

    @cached_property
    def starts(self) -> Offsets:
        """Where in `kept` the skeleton of each row starts, [N]."""
        return np.searchsorted(self._kept[0], self._row_starts)

    @cached_property
    def lengths(self) -> Offsets:
        """How long the skeleton of each row is, [N]."""
        # A skeleton goes on to the next: heads have no bytes in it.
        return np.diff(self.starts, append=len(self.kept))

    def are_whole(self, firsts: Offsets, lengths: Offsets) -> bool:
        """Whether texts that begin at some places of `bare` have lost no digit, minus sign or exponent.

        Args:
            firsts: Where the texts begin, [...].
            lengths: How long they are, in the same shape or for each of the last dimension.
        """
        lasts = firsts + lengths - 1
        return bool((self._bare_at[lasts] - self._bare_at[firsts] == lengths - 1).all())

    def are_texts(self, firsts: Offsets, text: bytes) -> bool:
        """Whether a text with digits, of which `bare` has the first byte at some places, is in the block at each."""
        at = self._bare_at[firsts]
        if int(at.max(initial=0)) > len(self._data) - len(text):
            return False
        windows = np.lib.stride_tricks.sliding_window_view(self._data, len(text))
        return bool((windows[at] == np.frombuffer(text, np.uint8)).all())

    def payload(self, row: int) -> bytes:
        """Return the encoded row."""
        return self._data[self._row_starts[row] : self._row_ends[row]].tobytes()

    def skeleton(self, start: int, length: int) -> bytes:
        """Return one skeleton."""
        return self.kept[start : start + length].tobytes()

    def are(self, starts: Offsets, skeleton: bytes) -> npt.NDArray[np.bool_]:
        """Tell which of the skeletons of one length that start there are a given one, [N]."""
        if not skeleton:
            return np.ones(len(starts), np.bool_)
        # A view: only the windows that are picked are copied.
        every = np.lib.stride_tricks.sliding_window_view(self.kept, len(skeleton))
        return np.asarray((every[starts] == np.frombuffer(skeleton, np.uint8)).all(axis=1))

    @property
    def has_exponents(self) -> bool:
        """Whether any row has a digit followed by an `e`."""
        return len(self._exponents) > 0

    def has_exponent(self, rows: Offsets) -> npt.NDArray[np.bool_]:
        """Whether a row has a digit followed by an `e`: an exponent, or text that looks like one."""
        low = np.searchsorted(self._exponents, self._row_starts[rows])
        return np.asarray(np.searchsorted(self._exponents, self._row_ends[rows]) > low)


def _exponents(data: Bytes, at: Offsets, kept: Bytes) -> Offsets:
    """Return the numbers of those bytes that are an `e` behind a digit.

    Args:
        data: The block.
        at: Where in it the bytes lie that are kept.
        kept: These.
    """
    letters = np.flatnonzero(kept == _E)
    exponents: Offsets = letters[data[at[letters] - 1] - np.uint8(_ZERO) <= _NINE - _ZERO]
    return exponents


def _without(at: Offsets, kept: Bytes, left_out: Offsets) -> tuple[Offsets, Bytes]:
    """Leave some of the bytes out, by their numbers."""
    if not len(left_out):
        return at, kept
    stays = np.ones(len(at), np.bool_)
    stays[left_out] = False
    return at[stays], kept[stays]


Spans = tuple[Offsets, Offsets]
"""The first and the last byte of each, [N]; those of one call do not overlap."""


def _cut_keys(at: Offsets, kept: Bytes) -> Spans:
    """Return the places of keys that have lost digits, because `q1` and `q2` are different keys.

    Args:
        at: Where in the block the bytes lie that are kept.
        kept: These.
    """
    quotes = np.flatnonzero(kept == _QUOTE)
    quotes = quotes[: np.searchsorted(quotes, len(kept) - 1)]
    closing = np.flatnonzero(kept[quotes + 1] == _COLON)
    closing = closing[closing > 0]
    first, last = quotes[closing - 1], quotes[closing]
    lost = at[last] - at[first] != last - first
    return at[first[lost]], at[last[lost]]


def _rows_with_backslash(at: Offsets, kept: Bytes, starts: Offsets, ends: Offsets) -> Spans:
    """Return the places of rows in which a quote may be part of a text. All bytes of these rows are kept."""
    backslashes = at[np.flatnonzero(kept == _BACKSLASH)]
    rows = np.unique(np.searchsorted(starts, backslashes, side="right") - 1)
    return starts[rows], ends[rows] - 1


def _spared(size: int, *spans: Spans) -> npt.NDArray[np.bool_] | None:
    """Tell which of so many bytes lie in any of some spans; None if there are none."""
    if not any(len(firsts) for firsts, _ in spans):
        return None
    steps = np.zeros(size + 1, np.int8)
    for firsts, lasts in spans:
        # np.add.at, because several spans may begin at one byte, which `steps[firsts] += 1` would count once.
        np.add.at(steps, firsts, 1)
        np.subtract.at(steps, lasts + 1, 1)
    return np.asarray(np.cumsum(steps[:-1], dtype=np.int8) > 0)
