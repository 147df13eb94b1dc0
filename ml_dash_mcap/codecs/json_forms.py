"""The forms of JSON rows, told by their skeletons, for the writer thread."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..mcap.message_records import MESSAGE_HEAD_BYTES
from ..mcap.row_arrays import Rows, by_channel, sliced, slices
from ..rows.shape import Shape
from .codec import UNKNOWN_FORM, Codec
from .json_bones import Bones
from .json_guess import guess
from .json_skeleton import Skeletons

_SLICE_BYTES = 256 * 1024
"""So many bytes of rows are looked at at a time. What is made of them stays in the processor's cache, and its memory
with the allocator: for a whole block of 1.5 MB at once the system gave and took 770 pages each time."""


class JsonForms:
    """The forms of the rows of all topics that are recorded in JSON."""

    def __init__(self) -> None:
        self._skeletons: dict[int, Skeletons] = {}

    @property
    def size(self) -> int:
        """How much is remembered, in bytes, about."""
        return sum([skeletons.size for skeletons in self._skeletons.values()])

    def begin_block(self) -> None:
        """Begin a block."""
        for skeletons in self._skeletons.values():
            skeletons.begin_block()

    def forget(self) -> None:
        """Forget all but the shapes."""
        for skeletons in self._skeletons.values():
            skeletons.forget()

    def add_channel(self, channel: int, codec: Codec) -> None:
        """Pass over it: the rows tell all."""

    def learn(self, channel: int, payload: bytes) -> int:
        """Widen a topic's shape by one row; returns the row's form."""
        return self._of(channel).learn(payload)

    def of_rows(self, rows: Rows) -> npt.NDArray[np.int32]:
        """Return the forms of rows, none of them a long one: its skeleton would take many times its memory."""
        forms = np.empty(len(rows), np.int32)
        for first, last in slices(rows, _SLICE_BYTES):
            forms[first:last] = self._of_slice(sliced(rows, first, last))
        return forms

    def _of_slice(self, rows: Rows) -> npt.NDArray[np.int32]:
        bones = Bones(rows.data, rows.starts + MESSAGE_HEAD_BYTES, rows.ends, MESSAGE_HEAD_BYTES)
        forms = guess(bones, rows.channels, self._skeletons)
        if forms is None:
            forms = np.full(len(rows), UNKNOWN_FORM, np.int32)
            for channel, which in by_channel(rows):
                forms[which] = self._of(channel).classify(bones, which)
        return forms

    def shape_of(self, channel: int) -> Shape | None:
        """Return the shape of a topic's rows so far."""
        skeletons = self._skeletons.get(channel)
        return None if skeletons is None else skeletons.shape

    def keys_of(self, channel: int, form: int) -> frozenset[str]:
        """Return the top-level keys of a topic's form."""
        return self._skeletons[channel].forms[form].keys

    def _of(self, channel: int) -> Skeletons:
        skeletons = self._skeletons.get(channel)
        if skeletons is None:
            skeletons = self._skeletons[channel] = Skeletons()
        return skeletons
