"""Describes a field's type in short: one word and the lengths of its lists."""

from __future__ import annotations

from dataclasses import dataclass

from ..rows import shape
from ..rows.shape import Shape, of_lists, scalar

_ANY = "any"

_NAMES = {
    shape.BOOLEAN: "boolean",
    shape.INTEGER: "integer",
    shape.FLOAT64: "number",
    shape.TEXT: "string",
    shape.BYTES: "bytes",
    shape.DICT: "object",
}
_KINDS = {name: kind for kind, name in _NAMES.items() if name != "object"}


@dataclass(frozen=True, slots=True)
class Field:
    """A field's type and shape; `str()` says both, as in `number[7]`, `string` or `number[4,4]`."""

    type: str
    """Of the value, or of each element: "number", "integer", "boolean", "string", "bytes", "object"; that of numpy,
    such as "uint8", for large arrays, "array" where it differs; "any" where they differ or are not known."""
    shape: tuple[int | None, ...] = ()
    """() for a single value, (7,) for a vector, (4, 4) for a matrix; None where lengths differ."""

    def __str__(self) -> str:
        lengths = ",".join("" if length is None else str(length) for length in self.shape)
        return f"{self.type}[{lengths}]" if self.shape else self.type

    def __repr__(self) -> str:
        return str(self)

    def least_shape(self) -> Shape | None:
        """Return the least shape of values of this type, with all lengths; None where they are not known."""
        if self.type not in _KINDS or not all(self.shape):
            return None
        values = scalar(_KINDS[self.type])
        for length in reversed(self.shape):
            values = of_lists(values, length or 0, length or 0)
        return values


def completed(field: Field, example: Field) -> Field:
    """Return a field with the lengths of an example, where it is one of lists whose lengths are not known."""
    if field.type not in _NAMES.values():  # the shape of arrays is that of all of them
        return field
    is_alike = example.type in (field.type, "integer") and len(field.shape) == len(example.shape)
    return Field(field.type, example.shape) if is_alike and field.shape[1:] == example.shape[1:] else field


def of_shape(values: Shape) -> Field:
    """Return the type of a field that has some values."""
    array = values.array
    if array is not None and values.value_kinds == shape.ARRAY:
        return Field("array") if array.dtype is None or array.lengths is None else Field(array.dtype, array.lengths)
    if values.kinds == shape.LIST and values.items is not None:
        elements = of_shape(values.items)
        if values.shortest == values.longest:
            return Field(elements.type, (values.shortest, *elements.shape))
        is_told = values.longest == shape.UNBOUNDED  # by a schema; lengths in ragged lists say little
        return Field(elements.type, (None, *elements.shape) if is_told else (None,))
    return Field(_type(values))


def _type(values: Shape) -> str:
    """Return the one type of values of several kinds; that of lists beside others is that of their elements."""
    names = {name for kind, name in _NAMES.items() if values.kinds & kind}
    if values.items is not None:
        names.add(of_shape(values.items).type)
    has_others = values.kinds & (shape.NULL | shape.OPAQUE | shape.ARRAY)
    if has_others or not names or (len(names) > 1 and names != {"integer", "number"}):
        return _ANY
    return "number" if len(names) > 1 else names.pop()
