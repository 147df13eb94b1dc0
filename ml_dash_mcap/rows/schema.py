"""Converts the shape of a topic's rows into the JSON Schema that viewers understand, and back.

Foxglove and Lichtblick drop a whole topic whose schema has one construct they do not know (a list of types, an
array of arrays, ...), while a field that is missing from `properties` still arrives and still plots. So a field that
the subset cannot express is left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from . import packed_arrays, shape
from .plain_row import TIME_KEY
from .shape import NOTHING, ArrayType, Shape, join, of_dicts, of_lists, scalar

MAX_FIELDS = 4000
"""Fields of a topic, nested ones included, beyond which further ones are left out of its schema."""

_LONGEST_NAME, _NAME_LETTERS = 4096, 512 * 1024
"""Fields with longer names are left out of the schema, and so are those beyond so many letters in all names of a
topic: the schema stands in each segment, with room to grow."""

_TYPES = {
    shape.BOOLEAN: "boolean",
    shape.INTEGER: "integer",
    shape.FLOAT64: "number",
    shape.INTEGER | shape.FLOAT64: "number",
    shape.TEXT: "string",
    shape.DICT: "object",
    shape.LIST: "array",
}
"""The names of kinds of values in JSON Schema."""

_KINDS = {name: kinds for kinds, name in _TYPES.items() if kinds != shape.INTEGER | shape.FLOAT64}

_BASE64 = {"type": "string", "contentEncoding": "base64"}

_OPAQUE = scalar(shape.OPAQUE)


class TopicShape:
    """The shape of a topic's rows, widened row by row, bounded by the room that a schema has."""

    def __init__(self) -> None:
        self.shape = NOTHING
        self._fields, self._letters = MAX_FIELDS, _NAME_LETTERS
        """Fields and letters of names that there is still room for."""

    def add(self, row: Shape) -> None:
        """Widen by the shape of a row."""
        self.shape = join(self.shape, row, self._admit)

    def _admit(self, name: str) -> bool:
        if self._fields <= 0 or len(name) > min(_LONGEST_NAME, self._letters):
            return False
        self._fields -= 1
        self._letters -= len(name)
        return True


def has_only_integers(row: Shape) -> bool:
    """Whether some part has only integers, so that one fraction would widen it."""
    if row.kinds & shape.INTEGER and not row.kinds & shape.FLOAT64:
        return True
    return any(map(has_only_integers, row.fields.values())) or (row.items is not None and has_only_integers(row.items))


def to_json(rows: Shape, title: str) -> dict[str, Any]:
    """Return a topic's JSON Schema, within the viewers' subset.

    Args:
        rows: The shape of the topic's rows.
        title: The topic's name.
    """
    schema = _object(rows, [MAX_FIELDS])
    schema["properties"][TIME_KEY] = {"type": "number"}  # always there, even if other fields have no room
    return {"type": "object", "title": title, **schema}


def _of_field(values: Shape, budget: list[int]) -> dict[str, Any] | None:
    """Return the schema of one field, or None where the subset has no words for it."""
    words = words_of(values)
    if not words or budget[0] <= 0:
        return None
    budget[0] -= 1
    if words["type"] == "array":
        return _array(values, words, budget)
    return {**words, **_object(values, budget)} if words["type"] == "object" else words


def words_of(values: Shape) -> dict[str, Any]:
    """Return the schema's keywords for values, without those for their contents; empty if the subset has none."""
    kinds = values.value_kinds
    if kinds == shape.ARRAY:
        return {**_BASE64, "description": description(values.array)}
    if kinds & shape.BYTES and not kinds & ~(shape.BYTES | shape.ARRAY):
        return dict(_BASE64)
    if kinds == shape.LIST and values.longest < shape.UNBOUNDED:
        return {"type": "array", "minItems": values.shortest, "maxItems": values.longest}
    return {"type": _TYPES[kinds]} if kinds in _TYPES else {}


def _object(dicts: Shape, budget: list[int]) -> dict[str, Any]:
    schemas = {name: _of_field(values, budget) for name, values in dicts.fields.items()}
    return {"properties": {name: schema for name, schema in schemas.items() if schema is not None}}


def _array(lists: Shape, words: dict[str, Any], budget: list[int]) -> dict[str, Any] | None:
    if lists.items is None or lists.items.kinds & (shape.LIST | shape.BYTES | shape.ARRAY):
        return None
    items = _of_field(lists.items, budget)
    return None if items is None else {"type": words.pop("type"), "items": items, **words}


def description(array: ArrayType | None) -> str:
    """Return the type and the lengths of arrays as `packed_arrays` describes them; "array" where too much differs."""
    if array is None or array.dtype is None or array.lengths is None:
        return "array"
    return f"{array.dtype}[{','.join('' if length is None else str(length) for length in array.lengths)}]"


def of_json(schema: Mapping[str, Any]) -> Shape:
    """Return the least shape of the values that a JSON Schema describes, whoever wrote it.

    Parts that it describes in other words than `to_json` are opaque.
    """
    type_ = schema.get("type")
    if type_ == "array":
        items, shortest, longest = schema.get("items"), schema.get("minItems"), schema.get("maxItems")
        inner = of_json(items) if isinstance(items, dict) else _OPAQUE
        if not isinstance(shortest, int) or not isinstance(longest, int):
            shortest, longest = 0, shape.UNBOUNDED
        return of_lists(inner, shortest, longest)
    if type_ == "object":
        properties = schema.get("properties")
        fields = properties.items() if isinstance(properties, dict) else ()
        return of_dicts({name: of_json(inner) for name, inner in fields if isinstance(inner, dict)})
    if type_ == "string" and schema.get("contentEncoding") == "base64":
        return of_description(schema.get("description"))
    kinds = _KINDS.get(type_) if isinstance(type_, str) else None
    return _OPAQUE if kinds is None else scalar(kinds)


def of_description(description: object) -> Shape:
    """Return the shape of arrays that a schema describes; that of bytes if it describes none."""
    if description == "array":
        return Shape(shape.ARRAY, array=ArrayType(None, None))
    parsed = packed_arrays.parse(description) if isinstance(description, str) else None
    return scalar(shape.BYTES) if parsed is None else Shape(shape.ARRAY, array=ArrayType(*parsed))
