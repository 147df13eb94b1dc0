"""Tells the form of each row of a block, so that rows merge without being decoded and schemas are learned."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import numpy.typing as npt

from ..codecs.codec import LONG_ROW_BYTES, UNKNOWN_FORM, BlockForms
from ..mcap.row_arrays import Rows, are_of, taken
from ..rows.shape import Shape
from .channels import ChannelInfo
from .fallbacks import Fallbacks

_REMEMBERED_BYTES = 8 * 1024 * 1024
"""About how many bytes the remembered forms of all topics of an encoding may take. Beyond that, all are forgotten."""

Forms = npt.NDArray[np.int32]
"""The form of each row, [N]: an index into the forms of its channel, or `UNKNOWN_FORM`."""


class RowForms:
    """The forms and the shape of the rows of each channel so far. Used by the writer thread only."""

    def __init__(self, channels: Mapping[int, ChannelInfo], fallbacks: Fallbacks) -> None:
        """Begin with no rows.

        Args:
            channels: The topics by number; others may add to it meanwhile.
            fallbacks: Counts work that failed for many rows at once.
        """
        self._channels = channels
        self._fallbacks = fallbacks
        self._forms: dict[str, BlockForms] = {}
        """By message encoding."""
        self._added: set[int] = set()
        """The channels that the forms know."""

    def shapes_of(self, numbers: Iterable[int]) -> dict[int, Shape]:
        """Return the shape of all rows so far by channel, for the channels among `numbers` whose schema is inferred."""
        shapes = {number: self._shape_of(number) for number in numbers if self._channels[number].is_inferred}
        return {number: shape for number, shape in shapes.items() if shape is not None}

    def _shape_of(self, number: int) -> Shape | None:
        try:
            return self._of(number).shape_of(number)
        except Exception as error:
            self._fallbacks.note("telling the shape of a topic's rows", error, "the schema stays as it was")
            return None

    def keys_of(self, number: int, form: int) -> frozenset[str]:
        """Return the top-level keys of a channel's form, which is not `UNKNOWN_FORM`."""
        return self._of(number).keys_of(number, form)

    def of_block(self, rows: Rows) -> Forms:
        """Return the form of each row of a block, and widen the shapes of channels that have rows of a new form."""
        inferred = [number for number, info in list(self._channels.items()) if info.is_inferred]
        is_inferred = are_of(rows.channels, inferred)
        try:
            for forms in self._forms.values():
                forms.forget() if forms.size > _REMEMBERED_BYTES else forms.begin_block()
            return self._classify(rows, is_inferred.copy())
        except Exception as error:
            self._fallbacks.note("telling the forms of a block's rows", error)
        self._forget()
        return self._learn_each(rows, np.flatnonzero(is_inferred))

    def _forget(self) -> None:
        for encoding, forms in self._forms.items():
            try:
                forms.forget()
            except Exception as error:
                self._fallbacks.note(f"forgetting the forms of {encoding} rows", error, "they stay")

    def _learn_each(self, rows: Rows, which: npt.NDArray[np.intp]) -> Forms:
        """Decode some of the rows. The schema may lack the fields of a row that cannot be decoded."""
        forms = np.full(len(rows), UNKNOWN_FORM, np.int32)
        for row in which.tolist():
            number = int(rows.channels[row])
            try:
                forms[row] = self._of(number).learn(number, rows.payload(row))
            except Exception as error:
                self._fallbacks.note("decoding a row", error, "the schema may lack its fields")
        return forms

    def _classify(self, rows: Rows, is_pending: npt.NDArray[np.bool_]) -> Forms:
        forms = np.full(len(rows), UNKNOWN_FORM, np.int32)
        for first, last in rows.uniform:
            number = int(rows.channels[first])
            # Rows of append_columns() are known to be of one form: the first one stands for all.
            forms[first:last] = self._of(number).learn(number, rows.payload(first))
            is_pending[first:last] = False
        is_long = is_pending & (rows.ends - rows.starts >= LONG_ROW_BYTES)
        if is_long.any():
            long = np.flatnonzero(is_long)
            forms[long] = self._learn_each(rows, long)[long]
            is_pending &= ~is_long
        for block_forms, which in self._by_codec(rows, np.flatnonzero(is_pending)):
            forms[which] = block_forms.of_rows(rows if len(which) == len(rows) else taken(rows, which))
        return forms

    def _by_codec(self, rows: Rows, which: npt.NDArray[np.intp]) -> list[tuple[BlockForms, npt.NDArray[np.intp]]]:
        """Return the forms of each encoding of some rows, with the numbers of the rows that have it."""
        numbers: dict[int, list[int]] = {}
        by_id: dict[int, BlockForms] = {}
        for number in np.flatnonzero(np.bincount(rows.channels[which])).tolist():
            forms = self._of(number)
            by_id[id(forms)] = forms
            numbers.setdefault(id(forms), []).append(number)
        if len(by_id) == 1:
            return [(forms, which) for forms in by_id.values()]
        return [(by_id[key], which[are_of(rows.channels[which], ids)]) for key, ids in numbers.items()]

    def _of(self, number: int) -> BlockForms:
        codec = self._channels[number].codec
        if codec is None:
            raise LookupError(f"the encoding of channel {number} is not known here")
        forms = self._forms.get(codec.message_encoding)
        if forms is None:
            forms = self._forms[codec.message_encoding] = codec.forms()
        if number not in self._added:
            forms.add_channel(number, codec)
            self._added.add(number)
        return forms
