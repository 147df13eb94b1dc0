"""The form of each row of a block, by which rows are merged without being decoded and schemas are learned."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import numpy.typing as npt

from ..codecs.json_skeleton import LONG_ROW_BYTES, UNKNOWN, Bones, Skeletons, guess
from ..mcap.message_records import MESSAGE_HEAD_BYTES
from ..mcap.row_arrays import Rows, taken
from ..rows.shape import Shape
from .channels import ChannelInfo
from .fallbacks import Fallbacks

_SKELETON_BYTES = 8 * 1024 * 1024
"""What is remembered of the forms of rows of all topics, in bytes, about; with more, all begin anew."""

Forms = npt.NDArray[np.int32]
"""The form of each row, [N]: an index into the forms of its channel, or `UNKNOWN`."""


class RowForms:
    """The forms and the shape of the rows of each channel so far. Used by the writer thread only."""

    def __init__(self, channels: Mapping[int, ChannelInfo], fallbacks: Fallbacks) -> None:
        """Begin with no rows.

        Args:
            channels: The topics by number; others may add to it meanwhile.
            fallbacks: Counts what fails for many rows at once.
        """
        self._channels = channels
        self._fallbacks = fallbacks
        self._skeletons: dict[int, Skeletons] = {}

    def shapes_of(self, numbers: Iterable[int]) -> dict[int, Shape]:
        """Return the shape of the rows so far of those of some channels whose schema is inferred."""
        return {number: self._skeletons[number].shape for number in numbers if number in self._skeletons}

    def keys_of(self, number: int, form: int) -> frozenset[str]:
        """Return the top-level keys of a channel's form, which is not `UNKNOWN`."""
        return self._skeletons[number].forms[form].keys

    def of_block(self, rows: Rows) -> Forms:
        """Return the form of each row of a block, and widen the shapes of channels that have rows of a new form."""
        is_too_much = sum([skeletons.size for skeletons in self._skeletons.values()]) > _SKELETON_BYTES
        for skeletons in self._skeletons.values():
            skeletons.forget() if is_too_much else skeletons.begin_block()
        inferred = [number for number, info in list(self._channels.items()) if info.schema is None]
        is_inferred = np.isin(rows.channels, inferred)
        try:
            return self._classify(rows, is_inferred)
        except Exception as error:
            self._fallbacks.note("telling the forms of a block's rows", error)
        for skeletons in self._skeletons.values():
            skeletons.forget()
        return self._learn_each(rows, np.flatnonzero(is_inferred))

    def _learn_each(self, rows: Rows, which: npt.NDArray[np.intp]) -> Forms:
        """Decode some of the rows; fields of a row that cannot be decoded may be missing in the schema."""
        forms = np.full(len(rows), UNKNOWN, np.int32)
        for row in which.tolist():
            try:
                forms[row] = self._skeletons_of(int(rows.channels[row])).learn(rows.payload(row))
            except Exception as error:
                self._fallbacks.note("decoding a row", error)
        return forms

    def _classify(self, rows: Rows, is_inferred: npt.NDArray[np.bool_]) -> Forms:
        forms = np.full(len(rows), UNKNOWN, np.int32)
        is_pending = is_inferred
        for first, last in rows.uniform:
            forms[first:last] = self._skeletons_of(int(rows.channels[first])).learn(rows.payload(first))
            is_pending[first:last] = False
        is_long = is_pending & (rows.ends - rows.starts >= LONG_ROW_BYTES)
        if is_long.any():
            long = np.flatnonzero(is_long)
            forms[long] = self._learn_each(rows, long)[long]
            is_pending &= ~is_long
        which = np.flatnonzero(is_pending)
        if len(which):
            forms[which] = self._classify_short(rows if len(which) == len(rows) else taken(rows, which))
        return forms

    def _classify_short(self, rows: Rows) -> Forms:
        """Return the forms of rows none of which is long, by their skeletons."""
        bones = Bones(rows.data, rows.starts + MESSAGE_HEAD_BYTES, rows.ends, MESSAGE_HEAD_BYTES)
        forms = guess(bones, rows.channels, self._skeletons)
        if forms is None:
            forms = np.full(len(rows), UNKNOWN, np.int32)
            for number, which in by_channel(rows):
                forms[which] = self._skeletons_of(number).classify(bones, which)
        return forms

    def _skeletons_of(self, number: int) -> Skeletons:
        skeletons = self._skeletons.get(number)
        if skeletons is None:
            skeletons = self._skeletons[number] = Skeletons()
        return skeletons


def by_channel(rows: Rows) -> list[tuple[int, npt.NDArray[np.intp]]]:
    """Return each channel's id with the numbers of its rows, in order; the rows are one or more."""
    order = np.argsort(rows.channels.astype(np.uint16), kind="stable")  # of 16 bits numpy sorts in linear time
    parts = np.split(order, np.flatnonzero(np.diff(rows.channels[order])) + 1)
    return [(int(rows.channels[part[0]]), part) for part in parts]
