"""What a topic's rows look like: inferred, widened, and said in the JSON Schema that viewers understand.

Foxglove and Lichtblick drop a whole topic whose schema has one construct they do not know (a list of types, an
array of arrays, ...), while a field that is missing from `properties` still arrives and still plots. So a field that
the subset cannot express is left out.
"""

from __future__ import annotations

from typing import Any

import orjson

from . import packed
from .encode import TIME_KEY

MAX_FIELDS = 4000
"""Fields of a topic, nested ones included, beyond which further ones are left out of its schema."""

_LONGEST_NAME, _NAME_LETTERS = 4096, 512 * 1024
"""Fields with longer names are left out of the schema, and so are those beyond so many letters in all names of a
topic: the schema stands in each segment, with room to grow."""


class Unsaid:
    """Stands for a value of which nothing is known: its field is left out of the schema."""


class Shape:
    """The kinds of value that one field has had so far, with the shapes of what it contains."""

    __slots__ = ("_room", "description", "fields", "items", "kinds", "longest", "shortest")

    def __init__(self, room: list[int] | None = None) -> None:
        """Begin with nothing.

        Args:
            room: Fields and letters of names that the whole topic may still have, shared by all its shapes.
        """
        self.kinds: set[str] = set()
        """Of null, boolean, integer, number, string, bytes, packed, object, array, unsaid."""
        self.fields: dict[str, Shape] = {}
        """Of the objects: every key seen."""
        self.items: Shape | None = None
        """Of the arrays: all elements seen, None while all were empty."""
        self.shortest: int | None = None
        self.longest: int = 0
        """Of the arrays: their lengths."""
        self.description: str | None = None
        """Of the packed arrays of numpy: type and shape, as `packed` describes them; "" where they differ."""
        self._room = [MAX_FIELDS, _NAME_LETTERS] if room is None else room

    def add(self, value: Any) -> bool:
        """Widen by one value; returns whether that changed anything."""
        kind = _kind(value)
        changed = kind not in self.kinds
        self.kinds.add(kind)
        if kind == "object":
            changed |= self._add_fields(value)
        elif kind == "array":
            changed |= self._add_items(value)
        elif kind == "packed":
            changed |= self._add_packed(value)
        return changed

    def _add_packed(self, value: Any) -> bool:
        spelled = value if isinstance(value, packed.Spelling) else packed.spelling(value)
        before, described = self.description, packed.described(spelled)
        self.description = described if before is None else packed.common(before, described)
        return self.description != before

    def _add_fields(self, value: dict[str, Any]) -> bool:
        changed = False
        for name, inner in value.items():
            shape = self.fields.get(name)
            if shape is None:
                room = self._room
                if room[0] <= 0 or len(name) > min(_LONGEST_NAME, room[1]):
                    continue
                room[0] -= 1
                room[1] -= len(name)
                shape = self.fields[name] = Shape(room)
            changed |= shape.add(inner)
        return changed

    def _add_items(self, value: list[Any]) -> bool:
        length = len(value)
        changed = self.shortest is None or length < self.shortest or length > self.longest
        self.shortest = length if self.shortest is None else min(self.shortest, length)
        self.longest = max(self.longest, length)
        if not value:
            return changed
        if self.items is None:
            self.items = Shape(self._room)
        return self.items._add_elements(value) or changed

    def _add_elements(self, values: list[Any]) -> bool:
        """Widen by the elements of an array; of arrays in it, which no schema has words for, by no more than that."""
        types = set(map(type, values))
        kinds = {_KINDS.get(type_, "packed") for type_ in types}
        changed = not kinds <= self.kinds
        self.kinds |= kinds
        if dict in types:
            for value in values:
                if type(value) is dict:
                    changed |= self._add_fields(value)
        return changed

    def has_integers(self) -> bool:
        """Whether some part has only had integers, so that one fraction would widen it."""
        if "integer" in self.kinds and "number" not in self.kinds:
            return True
        return any(shape.has_integers() for shape in self._parts())

    def _parts(self) -> list[Shape]:
        return [*self.fields.values(), *([self.items] if self.items is not None else [])]


def _kind(value: Any) -> str:
    return _KINDS.get(type(value), "packed")


_KINDS = {
    type(None): "null",
    bool: "boolean",
    int: "integer",
    float: "number",
    str: "string",
    bytes: "bytes",
    dict: "object",
    Unsaid: "unsaid",
    list: "array",
}


def infer(rows: list[dict[str, Any]]) -> Shape:
    """Return the shape that covers rows, as `decode` gives them (non-finite numbers and bytes restored)."""
    shape = Shape()
    for row in rows:
        shape.add(row)
    return shape


def to_json(shape: Shape, title: str) -> dict[str, Any]:
    """Say a topic's shape as a JSON Schema within the viewers' subset.

    Args:
        shape: Of the topic's rows.
        title: The topic's name.
    """
    said = _object(shape, [MAX_FIELDS])
    said["properties"][TIME_KEY] = {"type": "number"}  # whatever else finds no room
    return {"type": "object", "title": title, **said}


def _say(shape: Shape, budget: list[int]) -> dict[str, Any] | None:
    """Return the schema of one field, or None where the subset has no words for it."""
    kinds = shape.kinds - {"null"}
    if kinds == {"bytes", "packed"}:
        kinds = {"bytes"}
    if kinds == {"integer", "number"}:
        kinds = {"number"}
    if len(kinds) != 1 or budget[0] <= 0 or kinds == {"unsaid"}:
        return None
    budget[0] -= 1
    (kind,) = kinds
    if kind == "object":
        return {"type": "object", **_object(shape, budget)}
    if kind == "array":
        return _array(shape, budget)
    if kind == "bytes":
        return {"type": "string", "contentEncoding": "base64"}
    if kind == "packed":
        return {"type": "string", "contentEncoding": "base64", "description": shape.description or "array"}
    return {"type": kind}


def _object(shape: Shape, budget: list[int]) -> dict[str, Any]:
    said = {name: _say(inner, budget) for name, inner in shape.fields.items()}
    return {"properties": {name: schema for name, schema in said.items() if schema is not None}}


def _array(shape: Shape, budget: list[int]) -> dict[str, Any] | None:
    if shape.items is None or not shape.items.kinds.isdisjoint({"array", "bytes", "packed"}):
        return None
    items = _say(shape.items, budget)
    if items is None:
        return None
    return {"type": "array", "items": items, "minItems": shape.shortest, "maxItems": shape.longest}


def to_bytes(schema: dict[str, Any], reserve: int = 0) -> bytes:
    """Serialise a schema, padded with blanks to a length of `reserve` bytes so that it can grow in place."""
    return orjson.dumps(schema).ljust(reserve)
