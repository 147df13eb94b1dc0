"""The forms of protobuf rows, told by the tags and lengths of their top-level fields, for the writer thread."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ...mcap.message_records import MESSAGE_HEAD_BYTES
from ...mcap.row_arrays import Rows, by_channel
from ...rows.plain_row import EXACT_KEY, TIME_KEY
from ...rows.shape import Shape
from ..codec import UNKNOWN_FORM, Codec
from . import exact_values, wire
from .layout import EXACT_NUMBER, TIME_NUMBER, Layout

_ROUNDS = 8
"""So many forms of one length are told at once; the rows of the others are looked at one by one."""

_SLICE = 64
_PAUSE_S = 2e-5
"""After so many rows the writer thread sleeps for a moment, so that a control loop never waits for them all."""

_MOST_MARKS = 10_000
"""Rows with more bytes that make their form are looked at one by one."""

_MOST_FORMS = 4096
"""Of a channel; then its forms are forgotten."""


class FieldForm(NamedTuple):
    """What rows of one form have in common."""

    numbers: tuple[int, ...]
    """Of the top-level fields."""
    exact_keys: frozenset[str] = frozenset()
    """The top-level keys of the values in the exact text."""


class ProtobufForms:
    """The forms of the rows of all channels that are recorded in protobuf."""

    def __init__(self) -> None:
        self._codecs: dict[int, Codec] = {}
        self._forms: dict[int, dict[FieldForm, int]] = {}

    @property
    def size(self) -> int:
        """How much is remembered, in bytes, about."""
        return sum(100 * len(forms) for forms in self._forms.values())

    def begin_block(self) -> None:
        """Begin a block."""
        for forms in self._forms.values():
            if len(forms) > _MOST_FORMS:
                forms.clear()

    def forget(self) -> None:
        """Forget all forms."""
        self._forms.clear()

    def add_channel(self, channel: int, codec: Codec) -> None:
        """Take a channel with its codec, whose layout tells the keys of its fields."""
        self._codecs[channel] = codec

    def learn(self, channel: int, payload: bytes) -> int:
        """Return the form of a row."""
        return self._number_of(channel, _form(payload))

    def of_rows(self, rows: Rows) -> npt.NDArray[np.int32]:
        """Return the form of each row, [N]."""
        forms = np.full(len(rows), UNKNOWN_FORM, np.int32)
        for channel, which in by_channel(rows):
            lengths = (rows.ends - rows.starts)[which]
            for length in np.unique(lengths).tolist():
                self._classify(channel, rows, which[lengths == length], forms)
        return forms

    def _classify(self, channel: int, rows: Rows, which: npt.NDArray[np.intp], forms: npt.NDArray[np.int32]) -> None:
        """Tell the forms of rows of one length."""
        for _ in range(_ROUNDS):
            first = rows.payload(int(which[0]))
            is_alike = _are_like(first, rows, which)
            forms[which[is_alike]] = self._number_of(channel, _form(first))
            which = which[~is_alike]
            if not len(which):
                return
        for count, row in enumerate(which.tolist()):
            forms[row] = self.learn(channel, rows.payload(row))
            if count % _SLICE == _SLICE - 1:
                time.sleep(_PAUSE_S)

    def shape_of(self, channel: int) -> Shape | None:
        """Return None: the schema follows from the layout."""
        return None

    def keys_of(self, channel: int, form: int) -> frozenset[str]:
        """Return the top-level keys of a channel's form; rows that both have an exact text have that in common."""
        numbers, exact_keys = list(self._forms[channel])[form]
        layout: Layout = self._codecs[channel].layout  # type: ignore[attr-defined]  # channels of this encoding only
        names = {TIME_NUMBER: TIME_KEY, EXACT_NUMBER: EXACT_KEY}
        keys = (names.get(number) or layout.by_number[number].key for number in numbers)
        return exact_keys.union(keys)

    def _number_of(self, channel: int, form: FieldForm) -> int:
        forms = self._forms.setdefault(channel, {})
        return forms.setdefault(form, len(forms))


def _form(payload: bytes) -> FieldForm:
    fields = list(wire.fields(payload))
    keys = frozenset(
        key
        for field in fields
        if field.number == EXACT_NUMBER
        for key in exact_values.top_level_keys(payload[field.value_start : field.end])
    )
    return FieldForm(tuple(dict.fromkeys(field.number for field in fields)), keys)


def _are_like(first: bytes, rows: Rows, which: npt.NDArray[np.intp]) -> npt.NDArray[np.bool_]:
    """Return whether each of some rows of the length of the first one has its form, [N]."""
    marks = _marks(first)
    if len(marks) > _MOST_MARKS:
        is_first: npt.NDArray[np.bool_] = np.arange(len(which)) == 0
        return is_first
    starts = rows.starts[which] + MESSAGE_HEAD_BYTES
    is_alike = np.ones(len(which), np.bool_)
    for at in marks:  # a mark at a time: all at once would take an index of rows x marks
        is_alike &= rows.data[starts + at] == first[at]
    return is_alike


def _marks(payload: bytes) -> list[int]:
    """Return where the bytes lie that make the form of a row: of tags and lengths, and of the exact text."""
    return [
        at
        for field in wire.fields(payload)
        for at in range(field.start, field.end if field.number == EXACT_NUMBER else field.value_start)
    ]
