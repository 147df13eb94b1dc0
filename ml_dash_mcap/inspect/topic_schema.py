"""Merges the JSON Schemas that a topic has in its segments into one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import orjson

from ..codecs import json_depth
from ..mcap.records import Channel
from ..query.file import File
from ..rows import schema
from ..rows.plain_row import TIME_KEY
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


def fields(described: Mapping[str, Any]) -> dict[str, Field]:
    """Return the fields of a JSON Schema by dotted name, without the time stamp."""
    return {name: field for name, field in _walk_fields(described, "") if name != TIME_KEY}


def _walk_fields(described: Mapping[str, Any], parent: str) -> Iterable[tuple[str, Field]]:
    properties = described.get("properties")
    for name, inner in properties.items() if isinstance(properties, dict) else ():
        if not isinstance(inner, dict):
            continue
        dotted = f"{parent}{name}"
        if inner.get("type") == "object" and inner.get("properties"):
            yield from _walk_fields(inner, dotted + ".")
        else:
            yield dotted, field_shapes.of_shape(schema.of_json(inner))


_PARTS = ("properties", "items")


def _merge_schemas(first: dict[str, Any], second: dict[str, Any]) -> dict[str, Any]:
    """Return a schema for the values of two segments' schemas. Other tools' keywords come from the second one."""
    merged = {**first, **second}
    both = schema.of_json(_without_parts(first)) | schema.of_json(_without_parts(second))
    words = schema.words_of(both)
    merged.update(words)
    if "contentEncoding" in words and "description" not in words and both.array is not None:
        del merged["description"]  # bytes beside arrays
    properties = first.get("properties"), second.get("properties")
    if isinstance(properties[0], dict) and isinstance(properties[1], dict):
        names = {**properties[0], **properties[1]}
        merged["properties"] = {name: _either(properties[0].get(name), properties[1].get(name)) for name in names}
    if isinstance(first.get("items"), dict) and isinstance(second.get("items"), dict):
        merged["items"] = _merge_schemas(first["items"], second["items"])
    return merged


def _without_parts(described: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in described.items() if key not in _PARTS}


def _either(first: Any, second: Any) -> Any:
    if isinstance(first, dict) and isinstance(second, dict):
        return _merge_schemas(first, second)
    return first if second is None else second
