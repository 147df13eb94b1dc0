"""Which encoded rows have a shape that was seen before, told for a whole block at once.

Decoding every row to infer a schema would keep the interpreter lock from the control loop. So a row is reduced to its
skeleton, the bytes that are left without numbers (and without digits in text, but not in keys), and only rows with a
new skeleton are decoded. What a skeleton cannot tell (an empty array from one of an integer, `1e16` from `116`) is
decoded each time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import orjson

from .encode import EXACT_KEY, restore
from .schema import Shape

Bytes = npt.NDArray[np.uint8]
Offsets = npt.NDArray[np.int64]

_KNOWN_LIMIT = 64
_KNOWN_LIMIT_LONG = 2
_LONG = 4096
"""Skeletons of one topic and one length that are remembered, fewer of the long ones (free text and base64 make a new
one each row); a skeleton is long from this many bytes."""

_NO_ITEMS = b"[]"
"""The skeleton of an empty array, and of one that holds a single integer."""

_QUOTE, _MINUS, _ZERO, _NINE, _COLON, _BACKSLASH, _E = (ord(character) for character in '"-09:\\e')


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
        self.latest: tuple[bytes, int] | None = None
        """A skeleton that was seen lately, and its form."""
        self._known: dict[int, list[tuple[Bytes, int]]] = {}

    def learn(self, payload: bytes, skeleton: bytes = b"[]") -> int:
        """Decode one row and widen the topic's shape by it; returns the number of its form."""
        row: dict[str, Any] = orjson.loads(payload)
        keys = frozenset(row)
        row = restore(row)
        alone = Shape()
        alone.add(row)
        self.shape.add(row)
        self.forms.append(Form(keys, _NO_ITEMS not in skeleton and EXACT_KEY not in keys, alone.has_integers()))
        return len(self.forms) - 1

    def classify(self, bones: Bones, rows: Offsets) -> npt.NDArray[np.int32]:
        """Find the form of each row, learning the new ones.

        Args:
            bones: Of the block that the rows are in.
            rows: Numbers of this topic's rows in the block, [N].

        Returns:
            The form of each row, [N]: its index in `forms`.
        """
        forms = np.full(len(rows), -1, np.int32)
        starts, lengths = bones.starts[rows], bones.lengths[rows]
        for length in np.unique(lengths):
            same = np.flatnonzero(lengths == length)
            skeletons = bones.kept[starts[same, None] + np.arange(length)]
            self._classify_length(bones, rows[same], skeletons, forms, same)
        return forms

    def _classify_length(
        self, bones: Bones, rows: Offsets, skeletons: Bytes, forms: npt.NDArray[np.int32], at: Offsets
    ) -> None:
        known = self._known.setdefault(skeletons.shape[1], [])
        limit = _KNOWN_LIMIT if skeletons.shape[1] < _LONG else _KNOWN_LIMIT_LONG
        pending = np.arange(len(rows))
        for skeleton, form in known:
            if not len(pending):
                return
            pending = self._match(bones, rows, skeletons, skeleton, form, pending, forms, at)
        while len(pending):
            first = pending[0]
            form = self.learn(bones.payload(int(rows[first])), skeletons[first].tobytes())
            forms[at[first]] = form
            if not self.forms[form].certain:
                pending = pending[1:]
                continue
            skeleton = skeletons[first].copy()
            if len(known) < limit:
                known.append((skeleton, form))
            else:
                known[form % limit] = (skeleton, form)
            pending = self._match(bones, rows, skeletons, skeleton, form, pending[1:], forms, at)

    def _match(
        self,
        bones: Bones,
        rows: Offsets,
        skeletons: Bytes,
        skeleton: Bytes,
        form: int,
        pending: Offsets,
        forms: npt.NDArray[np.int32],
        at: Offsets,
    ) -> Offsets:
        """Give the rows with this skeleton its form; returns the rows that are still without one."""
        equal = (skeletons[pending] == skeleton).all(axis=1)
        if self.forms[form].integers:
            equal &= ~bones.has_exponent(rows[pending])
        if equal.any():
            forms[at[pending[equal]]] = form
            self.latest = (skeleton.tobytes(), form)
        left: Offsets = pending[~equal]
        return left


def guess(
    bones: Bones, channels: npt.NDArray[np.int64], of_channel: Mapping[int, Skeletons]
) -> npt.NDArray[np.int32] | None:
    """Find the form of each row of a block if all topics go on as they did lately, which is cheap to see.

    Args:
        bones: Of the block.
        channels: The channel id of each row, [N].
        of_channel: The skeletons of each topic.

    Returns:
        The form of each row, [N]: its index in its topic's `forms`. None if some row is not as expected.
    """
    latest = {number: skeletons.latest for number, skeletons in of_channel.items() if skeletons.latest is not None}
    numbers = channels.tolist()
    if not latest.keys() >= set(numbers):
        return None
    texts = {number: text for number, (text, _) in latest.items()}
    if b"".join([texts[number] for number in numbers]) != bones.kept.tobytes():
        return None
    if any(of_channel[number].forms[form].integers for number, (_, form) in latest.items()) and bones.has_exponents:
        return None
    forms = np.full(max(latest) + 1, -1, np.int32)
    for number, (_, form) in latest.items():
        forms[number] = form
    return forms[channels]


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
        keep = (data - np.uint8(_ZERO)) > _NINE - _ZERO  # no digit; what lies below the zero wraps
        keep &= data != _MINUS
        keep[(starts - head)[:, None] + np.arange(head)] = False
        at, kept = _without_exponents(data, np.flatnonzero(keep))
        spans = np.concatenate((_cut_keys(at, kept), _rows_with_backslash(at, kept, starts, ends)))
        if len(spans):
            keep[spans] = True
            at, kept = _without_exponents(data, np.flatnonzero(keep), spans)
        self.kept = kept
        self._at = at

    @cached_property
    def starts(self) -> Offsets:
        """Where in `kept` the skeleton of each row starts, [N]."""
        return np.searchsorted(self._at, self._row_starts)

    @cached_property
    def lengths(self) -> Offsets:
        """How long the skeleton of each row is, [N]."""
        return np.searchsorted(self._at, self._row_ends) - self.starts

    def payload(self, row: int) -> bytes:
        """Return the encoded row."""
        return self._data[self._row_starts[row] : self._row_ends[row]].tobytes()

    @cached_property
    def _exponents(self) -> Offsets:
        at = np.flatnonzero(self._data == _E)
        before = self._data[at - 1]
        return at[(before >= _ZERO) & (before <= _NINE)]

    @property
    def has_exponents(self) -> bool:
        """Whether any row has a digit followed by an `e`."""
        return len(self._exponents) > 0

    def has_exponent(self, rows: Offsets) -> npt.NDArray[np.bool_]:
        """Whether a row has a digit followed by an `e`: an exponent, or text that looks like one."""
        low = np.searchsorted(self._exponents, self._row_starts[rows])
        return np.asarray(np.searchsorted(self._exponents, self._row_ends[rows]) > low)


def _without_exponents(data: Bytes, at: Offsets, spans: Offsets | None = None) -> tuple[Offsets, Bytes]:
    """Leave out each `e` behind a digit.

    Args:
        data: The block.
        at: Where in it the bytes lie that are kept.
        spans: Where it stays nevertheless.

    Returns:
        Where the bytes lie that are left, and these.
    """
    kept = data[at]
    exponents = np.flatnonzero(kept == _E)
    before = data[at[exponents] - 1] - np.uint8(_ZERO)
    exponents = exponents[before <= _NINE - _ZERO]
    if spans is not None and len(exponents):
        is_kept = np.zeros(len(data), np.bool_)  # np.isin would sort the spans
        is_kept[spans] = True
        exponents = exponents[~is_kept[at[exponents]]]
    if not len(exponents):
        return at, kept
    stays = np.ones(len(at), np.bool_)
    stays[exponents] = False
    return at[stays], kept[stays]


def _cut_keys(at: Offsets, kept: Bytes) -> Offsets:
    """Return where the bytes of those keys lie that have lost some: `q1` and `q2` are different.

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
    return _ranges(at[first[lost]], at[last[lost]])


def _rows_with_backslash(at: Offsets, kept: Bytes, starts: Offsets, ends: Offsets) -> Offsets:
    """Return where the bytes of those rows lie in which a quote may be text: all of them are kept."""
    backslashes = at[np.flatnonzero(kept == _BACKSLASH)]
    if not len(backslashes):
        return backslashes
    rows = np.unique(np.searchsorted(starts, backslashes, side="right") - 1)
    return _ranges(starts[rows], ends[rows] - 1)


def _ranges(firsts: Offsets, lasts: Offsets) -> Offsets:
    """Return all numbers from each first one to its last one."""
    lengths = lasts - firsts + 1
    ends = np.cumsum(lengths)
    within: Offsets = np.arange(int(ends[-1]) if len(ends) else 0)
    ranges: Offsets = within + np.repeat(firsts - (ends - lengths), lengths)
    return ranges
