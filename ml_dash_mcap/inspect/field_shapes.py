"""What kind of values a field has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..rows import packed

_TYPES = {bool: "boolean", int: "integer", float: "number", str: "string", bytes: "bytes", dict: "object"}


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


def of_schema(schema: Mapping[str, Any]) -> Field:
    """Return what a JSON Schema says of a field."""
    type_ = schema.get("type")
    if type_ == "array":
        items = schema.get("items")
        inner = of_schema(items) if isinstance(items, dict) else Field("any")
        shortest, longest = schema.get("minItems"), schema.get("maxItems")
        length = shortest if isinstance(shortest, int) and shortest == longest else None
        return Field(inner.type, (length, *inner.shape))
    if type_ == "string" and schema.get("contentEncoding") == "base64":
        return _of_packed(schema) or Field("bytes")
    return Field(type_ if isinstance(type_, str) else "any")


def _of_packed(schema: Mapping[str, Any]) -> Field | None:
    """Return what a schema says of arrays of numpy; None if it is of bytes."""
    said = schema.get("description")
    if said == "array":
        return Field("array")
    found = packed.parse(said) if isinstance(said, str) else None
    return None if found is None else Field(*found)


def of_value(value: Any) -> Field:
    """Return what one value of a field shows."""
    if hasattr(value, "dtype"):
        return Field(value.dtype.name, value.shape)
    if not isinstance(value, list):
        return Field(_TYPES.get(type(value), "any"))
    kinds = set(map(type, value))  # a map has millions of elements of one type
    inner = {Field(_TYPES.get(kind, "any")) for kind in kinds - {list}}
    inner |= {of_value(element) for element in value if type(element) is list} if list in kinds else set()
    types, shapes = {one.type for one in inner}, {one.shape for one in inner}
    type_ = types.pop() if len(types) == 1 else "number" if types == {"integer", "number"} else "any"
    if len(shapes) == 1:
        return Field(type_, (len(value), *shapes.pop()))
    return Field(type_, (len(value), None) if shapes and () not in shapes else (len(value),))
