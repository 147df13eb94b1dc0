"""Which encoded rows have a shape that was seen before, told for a whole block at once.

Decoding every row to infer a schema would keep the interpreter lock from the control loop. So a row is reduced to
its skeleton, the bytes that are left without digits, signs and exponents, and only rows with a new skeleton are
decoded. What a skeleton cannot tell (an empty array from one of integers, `1e16` from `116`) is decoded each time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import orjson

from .encode import restore
from .schema import Shape

Bytes = npt.NDArray[np.uint8]
Offsets = npt.NDArray[np.int64]

_KNOWN_LIMIT = 64
_KNOWN_LIMIT_LONG = 2
_LONG = 4096
"""Skeletons of one topic and one length that are remembered, fewer of the long ones (free text and base64 make a new
one each row); a skeleton is long from this many bytes."""

_COMMA, _DOT, _QUOTE, _NINE, _ZERO, _E = (ord(c) for c in ',."90e')


@dataclass(frozen=True, slots=True)
class Form:
    """What the rows of one skeleton have in common."""

    keys: frozenset[str]
    """Their top-level keys, side key and time stamp included."""
    certain: bool
    """Whether another row of this skeleton cannot widen the topic's shape."""
    integers: bool
    """Whether a part was an integer, which a number without a point, as in `1e16`, could contradict."""


class Skeletons:
    """The skeletons of one topic so far, and the shape of the rows behind them. Used by the writer thread only."""

    def __init__(self) -> None:
        self.shape = Shape()
        self.forms: list[Form] = []
        self._known: dict[int, list[tuple[Bytes, int]]] = {}

    def learn(self, payload: bytes) -> tuple[int, bool]:
        """Decode one row; returns the number of its form and whether the topic's shape grew."""
        row: dict[str, Any] = orjson.loads(payload)
        keys = frozenset(row)
        row = restore(row)
        alone = Shape()
        alone.add(row)
        grew = self.shape.add(row)
        self.forms.append(Form(keys, not alone.has_unknown_items(), alone.has_integers()))
        return len(self.forms) - 1, grew

    def classify(self, block: Block, rows: Offsets) -> tuple[npt.NDArray[np.int32], bool]:
        """Find the form of each row, learning the new ones.

        Args:
            block: The block that the rows are in.
            rows: Numbers of this topic's rows in the block, [N].

        Returns:
            The form of each row, [N], and whether the topic's shape grew.
        """
        forms = np.full(len(rows), -1, np.int32)
        starts, lengths = block.skeleton_starts[rows], block.skeleton_lengths[rows]
        grew = False
        for length in np.unique(lengths):
            same = np.flatnonzero(lengths == length)
            bones = block.kept[starts[same, None] + np.arange(length)]
            grew |= self._classify_length(block, rows[same], bones, forms, same)
        return forms, grew

    def _classify_length(
        self, block: Block, rows: Offsets, bones: Bytes, forms: npt.NDArray[np.int32], at: Offsets
    ) -> bool:
        grew = False
        known = self._known.setdefault(bones.shape[1], [])
        limit = _KNOWN_LIMIT if bones.shape[1] < _LONG else _KNOWN_LIMIT_LONG
        pending = np.arange(len(rows))
        for skeleton, form in known:
            pending = self._match(block, rows, bones, skeleton, form, pending, forms, at)
            if not len(pending):
                return grew
        while len(pending):
            first = pending[0]
            form, widened = self.learn(block.payload(int(rows[first])))
            grew |= widened
            forms[at[first]] = form
            if not self.forms[form].certain:
                pending = pending[1:]
                continue
            skeleton = bones[first].copy()
            if len(known) < limit:
                known.append((skeleton, form))
            else:
                known[form % limit] = (skeleton, form)
            pending = self._match(block, rows, bones, skeleton, form, pending[1:], forms, at)
        return grew

    def _match(
        self,
        block: Block,
        rows: Offsets,
        bones: Bytes,
        skeleton: Bytes,
        form: int,
        pending: Offsets,
        forms: npt.NDArray[np.int32],
        at: Offsets,
    ) -> Offsets:
        """Give the rows with this skeleton its form; returns the rows that are still without one."""
        equal = (bones[pending] == skeleton).all(axis=1)
        if self.forms[form].integers:
            equal &= ~block.has_exponent(rows[pending])
        forms[at[pending[equal]]] = form
        return pending[~equal]


class Block:
    """The bytes of a sealed buffer with its rows, reduced to skeletons once for all topics."""

    def __init__(self, data: Bytes, starts: Offsets, ends: Offsets) -> None:
        self._data = data
        self._starts = starts
        self._ends = ends
        keep = data > _NINE
        keep &= data != _E
        for byte in (_COMMA, _DOT, _QUOTE):
            keep |= data == byte
        at = np.flatnonzero(keep)
        self.kept = data[at]
        self.skeleton_starts: Offsets = np.searchsorted(at, starts)
        self.skeleton_lengths: Offsets = np.searchsorted(at, ends) - self.skeleton_starts
        self._exponents: Offsets | None = None

    def payload(self, row: int) -> bytes:
        """Return the encoded row."""
        return self._data[self._starts[row] : self._ends[row]].tobytes()

    def has_exponent(self, rows: Offsets) -> npt.NDArray[np.bool_]:
        """Whether a row has a digit followed by an `e`: an exponent, or text that looks like one."""
        if self._exponents is None:
            at = np.flatnonzero(self._data == _E)
            before = self._data[at - 1]
            self._exponents = at[(before >= _ZERO) & (before <= _NINE)]
        low = np.searchsorted(self._exponents, self._starts[rows])
        return np.asarray(np.searchsorted(self._exponents, self._ends[rows]) > low)
