"""The subset of JSON Schema that the viewers read; anything outside it costs them the whole topic.

Tried construct by construct with Lichtblick 1.28. A keyword that was not tried counts as outside.
"""

from __future__ import annotations

from collections.abc import Iterator
from reprlib import repr as shown

IGNORED = frozenset(
    {
        "$schema",
        "$id",
        "title",
        "description",
        "$comment",
        "required",
        "additionalProperties",
        "patternProperties",
        "format",
        "minimum",
        "maximum",
        "minItems",
        "maxItems",
    }
)
"""Keywords that the viewers skip, whatever they say."""

SCALARS = frozenset({"boolean", "number", "integer", "string"})

KEYWORDS = {
    "object": frozenset({"type", "properties"}),
    "array": frozenset({"type", "items"}),
    "string": frozenset({"type", "enum", "contentEncoding"}),
    "boolean": frozenset({"type", "enum"}),
    "number": frozenset({"type", "enum"}),
    "integer": frozenset({"type", "enum"}),
}
"""For each type the keywords that may stand beside the ignored ones."""


def violations(schema: object) -> list[str]:
    """What in the schema of a topic loses the topic: one sentence each, which starts with the path of the construct."""
    if not isinstance(schema, dict):
        return [f"$ is {shown(schema)}, not an object with a type"]
    if schema.get("type") != "object":
        return [f'$ has the type {shown(schema.get("type"))}; a root must be of type "object"']
    return list(_object(schema, "$"))


def _object(schema: dict[str, object], path: str) -> Iterator[str]:
    yield from _keywords(schema, "object", path)
    properties = schema.get("properties", {})
    if not isinstance(properties, dict):
        yield f"{path}.properties is {shown(properties)}, not an object"
        return
    for name, field in properties.items():
        yield from _field(field, f"{path}.{name}")


def _field(schema: object, path: str) -> Iterator[str]:
    if not isinstance(schema, dict):
        yield f"{path} is {shown(schema)}, not an object with a type"
    elif "type" not in schema and "oneOf" in schema:
        yield from _constants(schema, path)
    elif schema.get("type") == "object":
        yield from _nested(schema, path)
    elif schema.get("type") == "array":
        yield from _keywords(schema, "array", path)
        yield from _items(schema, path)
    else:
        yield from _scalar(schema, path)


def _nested(schema: dict[str, object], path: str) -> Iterator[str]:
    if "properties" not in schema:
        yield f"{path} is a nested object without properties"
    yield from _object(schema, path)


def _scalar(schema: dict[str, object], path: str) -> Iterator[str]:
    kind = schema.get("type")
    if not isinstance(kind, str) or kind not in SCALARS:
        yield (
            f"{path} has the type {shown(kind)}, which the viewers do not know"
            if "type" in schema
            else f"{path} has no type"
        )
        return
    yield from _keywords(schema, kind, path)
    if "enum" in schema and not isinstance(schema["enum"], list):
        yield f"{path}.enum is {shown(schema['enum'])}, not a list"
    if schema.get("contentEncoding", "base64") != "base64" and kind == "string":
        yield f"{path} has the contentEncoding {shown(schema['contentEncoding'])}; only base64 is read"


def _items(schema: dict[str, object], path: str) -> Iterator[str]:
    if "items" not in schema:
        yield f"{path} is an array without items"
        return
    items, path = schema["items"], f"{path}[]"
    if not isinstance(items, dict):
        yield f"{path} is {shown(items)}, not an object with a type"
    elif items.get("type") == "array":
        yield f"{path} is an array of arrays"
    elif items.get("type") == "object":
        yield from _nested(items, path)
    elif "contentEncoding" in items:
        yield f"{path} is an array of encoded strings"
    else:
        yield from _scalar(items, path)


def _constants(schema: dict[str, object], path: str) -> Iterator[str]:
    yield from _unknown(schema, frozenset({"oneOf"}), path)
    choices = schema["oneOf"]
    if not isinstance(choices, list) or not choices:
        yield f"{path}.oneOf is {shown(choices)}, not a list of constants"
        return
    for number, choice in enumerate(choices):
        if not _is_constant(choice):
            yield f"{path}.oneOf[{number}] is {shown(choice)}, not a title and a number as const"
        else:
            yield from _unknown(choice, frozenset({"const"}), f"{path}.oneOf[{number}]")


def _is_constant(choice: object) -> bool:
    if not isinstance(choice, dict) or not isinstance(choice.get("title"), str):
        return False
    return isinstance(choice.get("const"), int | float) and not isinstance(choice.get("const"), bool)


def _keywords(schema: dict[str, object], kind: str, path: str) -> Iterator[str]:
    yield from _unknown(schema, KEYWORDS[kind], path)


def _unknown(schema: dict[str, object], known: frozenset[str], path: str) -> Iterator[str]:
    for keyword in schema:
        if keyword not in known and keyword not in IGNORED:
            yield f"{path} has the keyword {keyword!r}, which is outside the viewers' subset there"
