"""Merges the schemas that a topic has in its segments into one JSON Schema."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from typing import Any

import orjson

from ..codecs import json_depth
from ..mcap.records import Channel, Schema
from ..query.file import File
from ..rows import schema
from ..rows.plain_row import TIME_KEY
from . import field_shapes
from .field_shapes import Field


def read(channels: Iterable[tuple[File, Channel]]) -> dict[str, Any]:
    """Return the JSON Schema of a topic's rows, merged over its channels; empty if none is known."""
    merged: dict[str, Any] = {}
    for file, channel in channels:
        described = file.index.schema_of(channel)
        parsed = None if described is None else _parsed(described, channel.topic)
        if parsed is not None:
            merged = _merge_schemas(merged, parsed) if merged else parsed
    return merged


def _parsed(described: Schema, topic: str) -> dict[str, Any] | None:
    """Return the JSON Schema that one schema says; None if it says none."""
    if described.encoding == "protobuf":
        return _of_descriptors(described.data, described.name, topic)
    if described.encoding != "jsonschema" or not json_depth.is_within(described.data, json_depth.MOST):
        return None
    try:
        parsed = orjson.loads(described.data)
    except orjson.JSONDecodeError:
        return None
    return parsed if isinstance(parsed, dict) else None


@functools.lru_cache(maxsize=256)
def _of_descriptors(descriptors: bytes, name: str, topic: str) -> dict[str, Any] | None:
    """Return the JSON Schema of rows that are messages of a type of ours; None for messages of other types."""
    # Imported here, as they bring protobuf.
    from ..codecs.proto import descriptor, layout_shape

    layout = descriptor.decode(descriptors, name)
    return None if layout is None else schema.to_json(layout_shape.of_layout(layout), topic)


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
