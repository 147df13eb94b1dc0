"""One JSON Schema for a topic whose segments have one each."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import orjson

from ..codecs import json_depth
from ..mcap.records import Channel
from ..query.file import File
from ..rows import packed
from ..rows.encode import TIME_KEY
from . import field_shapes
from .field_shapes import Field


def read(channels: Iterable[tuple[File, Channel]]) -> dict[str, Any]:
    """Return a topic's JSON Schema, merged over its channels; empty if it has none."""
    merged: dict[str, Any] = {}
    for file, channel in channels:
        described = file.index.schema_of(channel)
        if described is None or described.encoding != "jsonschema":
            continue
        if not json_depth.is_within(described.data, json_depth.MOST):
            continue
        try:
            parsed = orjson.loads(described.data)
        except orjson.JSONDecodeError:
            continue
        if isinstance(parsed, dict):
            merged = _merge_schemas(merged, parsed) if merged else parsed
    return merged


def fields(schema: Mapping[str, Any]) -> dict[str, Field]:
    """Return the fields of a JSON Schema by dotted name, without the time stamp."""
    return {name: field for name, field in _walk_fields(schema, "") if name != TIME_KEY}


def _walk_fields(schema: Mapping[str, Any], parent: str) -> Iterable[tuple[str, Field]]:
    properties = schema.get("properties")
    for name, inner in properties.items() if isinstance(properties, dict) else ():
        if not isinstance(inner, dict):
            continue
        dotted = f"{parent}{name}"
        if inner.get("type") == "object" and inner.get("properties"):
            yield from _walk_fields(inner, dotted + ".")
        else:
            yield dotted, field_shapes.of_schema(inner)


def _merge_schemas(first: dict[str, Any], second: dict[str, Any]) -> dict[str, Any]:
    """Cover what two segments' schemas cover: all their fields, `number` where one has integers."""
    merged = {**first, **second}
    if (first.get("type"), second.get("type")) in (("integer", "number"), ("number", "integer")):
        merged["type"] = "number"
    descriptions = first.get("description"), second.get("description")
    if descriptions[0] != descriptions[1] and "contentEncoding" in merged:
        merged["description"] = _common(*descriptions)
    ours, theirs = first.get("properties"), second.get("properties")
    if isinstance(ours, dict) and isinstance(theirs, dict):
        merged["properties"] = {name: _either(ours.get(name), theirs.get(name)) for name in {**ours, **theirs}}
    if isinstance(first.get("items"), dict) and isinstance(second.get("items"), dict):
        merged["items"] = _merge_schemas(first["items"], second["items"])
    for key, choose in (("minItems", min), ("maxItems", max)):
        if isinstance(first.get(key), int) and isinstance(second.get(key), int):
            merged[key] = choose(first[key], second[key])
    return merged


def _common(first: Any, second: Any) -> str:
    """Return what describes two segments' arrays; bytes where one has such."""
    if not isinstance(first, str) or not isinstance(second, str):
        return ""
    if packed.parse(first) is None or packed.parse(second) is None:
        return "array"
    return packed.common(first, second) or "array"


def _either(first: Any, second: Any) -> Any:
    if isinstance(first, dict) and isinstance(second, dict):
        return _merge_schemas(first, second)
    return first if second is None else second
