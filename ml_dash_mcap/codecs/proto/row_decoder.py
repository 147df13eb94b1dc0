"""Decodes rows of any kind, field by field."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from ...rows.plain_row import TIME_KEY
from ..encoded_channel import DecodableBlock
from . import exact_values, wire
from .layout import EXACT_NUMBER, TIME_NUMBER, Kind, Layout, Member
from .row_encoder import decode_array

if TYPE_CHECKING:
    from .block_decoder import BlockReader

Row = dict[str, Any]

Misfit = Callable[[bytes, Exception], "Row | None"]
"""Returns what stands for a payload that is no row, by the error that it caused."""

LEAST_ROWS = 16
"""Fewer are decoded one by one."""


class RowDecoder:
    """Makes rows of the messages of one layout. Any thread may call it."""

    def __init__(self, layout: Layout, misfit: Misfit | None = None) -> None:
        """Decode messages of a layout, or of an earlier one that it grew from.

        Args:
            layout: Of the rows.
            misfit: Returns what stands for a payload that is no row; None if such a payload is an error.
        """
        self.layout = layout
        self._misfit = misfit
        self._blocks: BlockReader | None = None

    def __call__(self, payload: bytes) -> Row | None:
        """Decode a row.

        Raises:
            ValueError: It is no message of the layout.
        """
        if self._misfit is None:
            return self.decode(payload)
        try:
            return self.decode(payload)
        except (ValueError, RecursionError) as error:
            return self._misfit(payload, error)

    def block(self, payloads: Sequence[bytes]) -> DecodableBlock | None:
        """Look at the rows of a block, so that those of one layout are decoded together."""
        if len(payloads) < LEAST_ROWS:
            return None
        if self._blocks is None:
            from .block_decoder import BlockReader  # numpy, which no appending thread waits for

            self._blocks = BlockReader(self.layout)
        return self._blocks.block(payloads)

    def decode(self, payload: bytes) -> Row:
        """Decode a row.

        Raises:
            ValueError: It is no message of the layout.
        """
        row: Row = {}
        time_s: float | None = None
        exact: dict[str, Any] = {}
        for field in wire.fields(payload):
            if field.number == TIME_NUMBER and field.wire_type == wire.FIXED64:
                (time_s,) = struct.unpack_from("<d", payload, field.value_start)
            elif field.number == EXACT_NUMBER and field.wire_type == wire.DELIMITED:
                exact = exact_values.decode(payload[field.value_start : field.end])
            else:
                _take(row, self.layout, payload, field)
        if exact:
            exact_values.put(row, exact)
        if time_s is not None:
            row[TIME_KEY] = time_s
        return row


def _take(row: Row, layout: Layout, data: bytes, field: wire.WireField) -> None:
    member = layout.by_number.get(field.number)
    if member is None:
        raise ValueError(f"it has the field {field.number}, which its schema does not describe")
    slot = member.slot
    expected = wire.DELIMITED if slot.is_list else slot.kind.wire_type
    if field.wire_type != expected:
        raise ValueError(f"its field {field.number} ({member.key!r}) is of the wire type {field.wire_type}")
    if slot.is_packed:
        row[member.key] = _packed(member, data, field)
    elif slot.is_list:
        values = row.setdefault(member.key, [])
        if not isinstance(values, list):
            raise ValueError(f"its key {member.key!r} is a list and a single value")
        values.append(_single(member, data, field))
    else:
        row[member.key] = _single(member, data, field)


def _single(member: Member, data: bytes, field: wire.WireField) -> Any:
    kind = member.slot.kind
    start, end = field.value_start, field.end
    if kind is Kind.BOOL:
        return wire.read_varint(data, start, end)[0] != 0
    if kind.struct_code is not None:
        return struct.unpack_from(f"<{kind.struct_code}", data, start)[0]
    if kind is Kind.DICT:
        inner: Row = {}
        for inner_field in wire.fields(data, start, end):
            _take(inner, member.inner or Layout(), data, inner_field)
        return inner
    if kind is Kind.ARRAY:
        return decode_array(data, start, end)
    return data[start:end].decode() if kind is Kind.TEXT else data[start:end]


def _packed(member: Member, data: bytes, field: wire.WireField) -> list[Any]:
    code = member.slot.kind.struct_code or ""
    count, rest = divmod(field.end - field.value_start, member.slot.kind.packed_bytes)
    if rest:
        raise ValueError(f"its field {field.number} ({member.key!r}) holds no whole number of values")
    values: list[Any] = list(struct.unpack_from(f"<{count}{code}", data, field.value_start))
    return nested(values, member.slot.lengths or ())


def nested(values: list[Any], lengths: tuple[int, ...]) -> list[Any]:
    """Return a flat list as lists in lists.

    Args:
        values: All elements.
        lengths: Of all dimensions but the first.

    Raises:
        ValueError: Their number does not fit.
    """
    for length in reversed(lengths):
        if len(values) % length:
            raise ValueError(f"{len(values)} values are no rows of {length}")
        values = [values[at : at + length] for at in range(0, len(values), length)]
    return values
