"""The JSON Schema of a topic's rows as bytes, for all encodings that are described by one."""

from __future__ import annotations

import json

import orjson

from ..rows import schema
from ..rows.shape import Shape

ENCODING = "jsonschema"


def of_shape(shape: Shape | None, title: str) -> bytes:
    """Return the schema of rows of a shape.

    Args:
        shape: The shape of the rows so far; None before the first row.
        title: The topic's name.
    """
    return orjson.dumps({"type": "object", "title": title} if shape is None else schema.to_json(shape, title))


def padded(text: bytes, length: int) -> bytes:
    """Return a schema with blanks behind it, which are no part of it."""
    return text.ljust(length)


def mended(text: bytes) -> bytes | None:
    """Return a schema of any object, as long as a text that is no whole schema; None if the text is whole."""
    try:
        if isinstance(json.loads(text), dict):  # not orjson, which refuses some of what other writers take for JSON
            return None
    except ValueError:
        pass
    bare = next((schema for schema in (b'{"type":"object"}', b"{}") if len(schema) <= len(text)), None)
    return None if bare is None else padded(bare, len(text))
