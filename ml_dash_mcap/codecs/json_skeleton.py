"""Tells for a whole block at once which encoded rows have a shape that was seen before.

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

from ..rows.json_text import restore_kinds
from ..rows.plain_row import EXACT_KEY
from ..rows.schema import TopicShape, has_only_integers
from ..rows.shape import Shape
from ..rows.value_shapes import Opaque, of_value
from . import json_outline
from .codec import UNKNOWN_FORM

Bytes = npt.NDArray[np.uint8]
Offsets = npt.NDArray[np.int64]

_LONG = 4096
"""A skeleton is long from this many bytes. Free text and base64 make a new long one each row, so few are remembered."""

_MOST_LONG = 8
"""Long skeletons that are remembered of one topic and block."""

_MOST_FORMS = 1024
"""Forms that are told apart in one block; the rows of further ones are decoded, and widen the shape."""

_MOST_BYTES = 1024 * 1024
"""About how many bytes a topic remembers from block to block. Beyond that, it forgets everything but the shape."""

_ROUNDS = 8
"""Forms of one length that are looked for in all rows at once; then each row is looked up by itself."""

_MOST_VALUES = 1024 * 1024
"""Rows with more values are not decoded as a whole: each takes up to 100 bytes, and orjson crashes without memory."""

_NO_ITEMS = b"[]"
"""The skeleton of an empty array, and of one that holds a single integer."""

_FORM_BYTES, _KEY_BYTES = 400, 60
"""About how many bytes a form or a skeleton takes besides its text, and how many a form takes for each key."""

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


def _values(payload: bytes) -> int:
    """Return how many values an encoded row has at most."""
    return payload.count(b",") + payload.count(b"[") + payload.count(b"{")


class Skeletons:
    """The skeletons of one topic so far, and the shape of the rows behind them. Used by the writer thread only."""

    def __init__(self) -> None:
        self._rows = TopicShape()
        self.forms: list[Form] = []
        self.latest: tuple[bytes, int] | None = None
        """A skeleton that was seen lately, and its form."""
        self.size = 0
        """How much is remembered, in bytes, about."""
        self._form_of_skeleton: dict[bytes, int] = {}
        self._numbers: dict[Form, int] = {}
        self._long = 0

    @property
    def shape(self) -> Shape:
        """The shape of all rows so far."""
        return self._rows.shape

    def begin_block(self) -> None:
        """Begin a block; forms that were returned before may have been forgotten."""
        self._long = 0
        if self.size > _MOST_BYTES or len(self.forms) >= _MOST_FORMS:
            self.forget()

    def forget(self) -> None:
        """Forget all but the shape."""
        self.forms, self._form_of_skeleton, self._numbers = [], {}, {}
        self.latest = None
        self.size = self._long = 0

    def learn(self, payload: bytes, skeleton: bytes = _NO_ITEMS) -> int:
        """Decode one row and widen the topic's shape by it; returns the number of its form, or `UNKNOWN_FORM`."""
        if len(payload) > _MOST_VALUES and _values(payload) > _MOST_VALUES:
            self._learn_huge(payload)
            return UNKNOWN_FORM
        row: dict[str, Any] = orjson.loads(payload)
        keys = frozenset(row)
        is_certain = EXACT_KEY not in keys and _NO_ITEMS not in skeleton
        shape = of_value(restore_kinds(row), is_coarse=True)
        self._rows.add(shape)
        if len(self.forms) >= _MOST_FORMS:
            return UNKNOWN_FORM
        form = Form(keys, is_certain, is_certain and has_only_integers(shape))
        number = self._numbers.setdefault(form, len(self.forms))
        if number == len(self.forms):
            self.forms.append(form)
            self.size += _FORM_BYTES + sum(map(len, keys)) + _KEY_BYTES * len(keys)
        return number

    def _learn_huge(self, payload: bytes) -> None:
        """Widen the shape by the fields of a row, but leave those that are lists and dicts out of the schema."""
        row = restore_kinds(orjson.loads(json_outline.of(payload)))
        values = {name: Opaque() if isinstance(value, (list, dict)) else value for name, value in row.items()}
        self._rows.add(of_value(values, is_coarse=True))

    def classify(self, bones: Bones, rows: Offsets) -> npt.NDArray[np.int32]:
        """Find the form of each row, learning the new ones.

        Args:
            bones: Of the block that the rows are in.
            rows: Numbers of this topic's rows in the block, [N].

        Returns:
            The form of each row, [N]: its index in `forms`, or `UNKNOWN_FORM`.
        """
        forms = np.full(len(rows), UNKNOWN_FORM, np.int32)
        starts, lengths = bones.starts[rows], bones.lengths[rows]
        order = np.argsort(lengths, kind="stable")
        edges = np.flatnonzero(np.diff(lengths[order])) + 1
        for same in np.split(order, edges):
            length = int(lengths[same[0]]) if len(same) else 0
            self._classify_length(bones, rows[same], starts[same], length, forms, same)
        return forms

    def _classify_length(
        self, bones: Bones, rows: Offsets, starts: Offsets, length: int, forms: npt.NDArray[np.int32], at: Offsets
    ) -> None:
        """Find the forms of rows whose skeletons have one length: of many at once, then of the others one by one."""
        pending = np.arange(len(rows))
        for _ in range(_ROUNDS):
            if not len(pending):
                return
            first = int(pending[0])
            skeleton = bones.skeleton(int(starts[first]), length)
            form = forms[at[first]] = self._form_of(bones, int(rows[first]), skeleton)
            pending = pending[1:]
            if form == UNKNOWN_FORM or not self.forms[form].certain or not len(pending):
                continue
            equal = bones.are(starts[pending], skeleton)
            if self.forms[form].integers:
                equal &= ~bones.has_exponent(rows[pending])
            forms[at[pending[equal]]] = form
            pending = pending[~equal]
        for row in pending.tolist():
            skeleton = bones.skeleton(int(starts[row]), length)
            forms[at[row]] = self._form_of(bones, int(rows[row]), skeleton)

    def _form_of(self, bones: Bones, row: int, skeleton: bytes) -> int:
        """Return the form of one row, from what is known of its skeleton or by decoding it."""
        form = self._form_of_skeleton.get(skeleton)
        if form is None or (self.forms[form].integers and bones.has_exponent(np.array([row]))[0]):
            form = self.learn(bones.payload(row), skeleton)
            if form == UNKNOWN_FORM or not self.forms[form].certain or not self._remember(skeleton, form):
                return form
        self.latest = (skeleton, form)
        return form

    def _remember(self, skeleton: bytes, form: int) -> bool:
        """Remember a skeleton, unless too many long ones are; returns whether it is."""
        if skeleton not in self._form_of_skeleton:
            if len(skeleton) >= _LONG:
                self._long += 1
                if self._long > _MOST_LONG:
                    return False
            self.size += len(skeleton) + _FORM_BYTES
        self._form_of_skeleton[skeleton] = form
        return True


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
    counts = np.bincount(channels).tolist()
    if sum(len(text) * counts[number] for number, text in texts.items() if number < len(counts)) != len(bones.kept):
        return None  # so that no more is joined than the block holds
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
        keep = (data - np.uint8(_ZERO)) > _NINE - _ZERO  # no digit: bytes below "0" wrap around to large numbers
        keep &= data != _MINUS
        keep[(starts - head)[:, None] + np.arange(head)] = False
        at, kept = _without_exponents(data, np.flatnonzero(keep))
        spared = _spared(len(data), _cut_keys(at, kept), _rows_with_backslash(at, kept, starts, ends))
        if spared is not None:
            keep |= spared
            # An offset takes 8 bytes for each byte of the block, so the old ones go first.
            del at, kept
            at, kept = _without_exponents(data, np.flatnonzero(keep), spared)
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


def _without_exponents(data: Bytes, at: Offsets, spared: npt.NDArray[np.bool_] | None = None) -> tuple[Offsets, Bytes]:
    """Leave out each `e` behind a digit.

    Args:
        data: The block.
        at: Where in it the bytes lie that are kept.
        spared: Which bytes of the block stay nevertheless.

    Returns:
        Where the bytes lie that are left, and these.
    """
    kept = data[at]
    exponents = np.flatnonzero(kept == _E)
    before = data[at[exponents] - 1] - np.uint8(_ZERO)
    exponents = exponents[before <= _NINE - _ZERO]
    if spared is not None and len(exponents):
        exponents = exponents[~spared[at[exponents]]]
    if not len(exponents):
        return at, kept
    stays = np.ones(len(at), np.bool_)
    stays[exponents] = False
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
