"""Tells for a whole block at once which encoded rows have a shape that was seen before.

Decoding every row to infer a schema would keep the interpreter lock from the control loop. So a row is reduced to its
skeleton, the bytes that are left without numbers (and without digits in text, but not in keys), and only rows with a
new skeleton are decoded. What a skeleton cannot tell (an empty array from one of an integer, `1e16` from `116`) is
decoded each time.
"""

from __future__ import annotations

from dataclasses import dataclass
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
from .json_bones import Bones, Offsets
from .json_expected_rows import HISTORY_ROWS, ExpectedRows, Seen

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
        self.expected = ExpectedRows()
        """The next rows, if they go on as they did lately."""
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
        self.expected = ExpectedRows()
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
        # Those that came first are learned first, so that the schema names fields in the order in which they came.
        for same in sorted(np.split(order, edges), key=lambda same: same[:1].tolist()):
            length = int(lengths[same[0]]) if len(same) else 0
            self._classify_length(bones, rows[same], starts[same], length, forms, same)
        if len(rows):
            last = slice(-HISTORY_ROWS, None)
            self.expected.learn(
                list(map(self._seen, map(bones.skeleton, starts[last].tolist(), lengths[last].tolist())))
            )
        return forms

    def _seen(self, skeleton: bytes) -> Seen | None:
        form = self._form_of_skeleton.get(skeleton)
        return None if form is None else (skeleton, form)

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
            if form != UNKNOWN_FORM and self.forms[form].certain:
                self._remember(skeleton, form)
        return form

    def _remember(self, skeleton: bytes, form: int) -> None:
        """Remember a skeleton, unless too many long ones are."""
        if skeleton not in self._form_of_skeleton:
            if len(skeleton) >= _LONG:
                self._long += 1
                if self._long > _MOST_LONG:
                    return
            self.size += len(skeleton) + _FORM_BYTES
        self._form_of_skeleton[skeleton] = form
