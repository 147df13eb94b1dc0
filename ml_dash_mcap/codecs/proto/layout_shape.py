"""The shape of rows that a layout describes, for all that asks for the types of fields in whichever encoding."""

from __future__ import annotations

from ...rows import shape
from ...rows.schema import of_description
from ...rows.shape import NOTHING, Shape, of_dicts, of_lists, scalar
from .layout import Kind, Layout, Member

_KINDS = {
    Kind.DOUBLE: shape.FLOAT64,
    Kind.INT: shape.INTEGER,
    Kind.UINT: shape.INTEGER,
    Kind.BOOL: shape.BOOLEAN,
    Kind.TEXT: shape.TEXT,
    Kind.BYTES: shape.BYTES,
}


def of_layout(layout: Layout) -> Shape:
    """Return the shape of the dicts of a layout. Lengths of lists are not known, but those of lists inside."""
    fields: dict[str, Shape] = {}
    for member in layout.members:
        fields[member.key] = fields.get(member.key, NOTHING) | of_member(member)
    return of_dicts(fields)


def of_member(member: Member) -> Shape:
    """Return the shape of the values of a field."""
    kind, lengths = member.slot.kind, member.slot.lengths
    if kind is Kind.DICT:
        values = of_layout(member.inner or Layout())
    else:
        values = of_description(member.array or "array") if kind is Kind.ARRAY else scalar(_KINDS[kind])
    if lengths is None:
        return values
    for length in reversed(lengths):
        values = of_lists(values, length, length)
    return of_lists(values, 0, shape.UNBOUNDED)
