"""The forms and shapes of rows in an encoding of which only whole rows are known: each row is decoded."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import islice

import numpy as np
import numpy.typing as npt

from ..mcap.row_arrays import Rows, by_channel
from ..rows.schema import TopicShape
from ..rows.shape import Shape
from ..rows.value_shapes import of_values
from .codec import Codec
from .encoded_channel import Row

_SLICE = 32
_PAUSE_S = 2e-5
"""After so many decoded rows the writer thread sleeps for a moment, so that a control loop never waits for them all."""


class DecodedForms:
    """The forms of the rows of all channels of an encoding. Rows with the same keys in the same order have one form."""

    size = 0
    """Nothing is remembered from block to block but the shapes."""

    def __init__(self, decode: Callable[[bytes], Row]) -> None:
        """Begin without rows.

        Args:
            decode: Makes a row of a payload.
        """
        self._decode = decode
        self._shapes: dict[int, TopicShape] = {}
        self._forms: dict[tuple[str, ...], int] = {}
        self._keys: list[frozenset[str]] = []
        """By form, of all channels together."""

    def begin_block(self) -> None:
        """Begin a block."""
        self.forget()

    def forget(self) -> None:
        """Forget all but the shapes."""
        self._forms, self._keys = {}, []

    def add_channel(self, channel: int, codec: Codec) -> None:
        """Pass over it: the rows tell all."""

    def learn(self, channel: int, payload: bytes) -> int:
        """Widen a channel's shape by one row; returns the row's form."""
        return self._learn(channel, [self._decode(payload)])[0]

    def of_rows(self, rows: Rows) -> npt.NDArray[np.int32]:
        """Return the form of each row, [N]."""
        forms = np.empty(len(rows), np.int32)
        for channel, which in by_channel(rows):
            places = iter(which.tolist())
            while part := list(islice(places, _SLICE)):
                forms[part] = self._learn(channel, [self._decode(rows.payload(row)) for row in part])
                time.sleep(_PAUSE_S)
        return forms

    def shape_of(self, channel: int) -> Shape | None:
        """Return the shape of a channel's rows so far."""
        topic = self._shapes.get(channel)
        return None if topic is None else topic.shape

    def keys_of(self, channel: int, form: int) -> frozenset[str]:
        """Return the top-level keys of a form."""
        return self._keys[form]

    def _learn(self, channel: int, decoded: list[Row]) -> list[int]:
        """Widen a channel's shape by some rows; returns their forms."""
        self._shapes.setdefault(channel, TopicShape()).add(of_values(decoded, is_coarse=True))
        return [self._form(tuple(row)) for row in decoded]

    def _form(self, keys: tuple[str, ...]) -> int:
        form = self._forms.get(keys)
        if form is None:
            form = self._forms[keys] = len(self._keys)
            self._keys.append(frozenset(keys))
        return form
