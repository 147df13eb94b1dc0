"""Whether the values of a row are what the schema of its topic promises.

Only the fields in `properties` are looked at, and null fits everywhere: it is how a missing or non-finite value is spelled.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Iterator
from reprlib import repr as shown

CLASSES: dict[str, type | tuple[type, ...]] = {
    "object": dict,
    "array": list,
    "string": str,
    "boolean": bool,
    "number": (int, float),
    "integer": int,
}


def mismatches(value: object, schema: object, path: str = "$") -> Iterator[str]:
    """What in a decoded row contradicts its schema: one sentence each, which starts with the path of the value."""
    if value is None or not isinstance(schema, dict):
        return
    kind = schema.get("type", "number" if "oneOf" in schema else None)
    if not isinstance(kind, str) or kind not in CLASSES:
        return
    if not isinstance(value, CLASSES[kind]) or (isinstance(value, bool) and kind != "boolean"):
        yield f"{path} is {shown(value)}, but its schema says {kind}"
    elif isinstance(value, dict):
        for name, field in _properties(schema).items():
            yield from mismatches(value.get(name), field, f"{path}.{name}")
    elif isinstance(value, list):
        if _all_fit(value, schema.get("items")):
            return
        for number, item in enumerate(value):
            yield from mismatches(item, schema.get("items"), f"{path}[{number}]")
    else:
        yield from _scalar_mismatches(value, schema, path)


_EXACT: dict[object, set[type]] = {
    "number": {int, float, type(None)},
    "integer": {int, type(None)},
    "boolean": {bool, type(None)},
    "string": {str, type(None)},
}


def _all_fit(values: list[object], schema: object) -> bool:
    """Whether plain values surely fit: most lists are long and plain, and this is far faster than value by value."""
    if not isinstance(schema, dict) or not schema.keys() <= {"type"}:
        return False
    return {*map(type, values)} <= _EXACT.get(schema.get("type"), set())


def _properties(schema: dict[str, object]) -> dict[str, object]:
    properties = schema.get("properties")
    return properties if isinstance(properties, dict) else {}


def _scalar_mismatches(value: object, schema: dict[str, object], path: str) -> Iterator[str]:
    choices = schema.get("enum")
    if isinstance(choices, list) and value not in choices:
        yield f"{path} is {shown(value)}, which is not in its enum"
    if schema.get("contentEncoding") == "base64" and not _is_base64(str(value)):
        yield f"{path} is {shown(value)}, but its schema says base64"


def _is_base64(text: str) -> bool:
    try:
        base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError):
        return False
    return True
