"""Rows of protobuf messages as google's library reads them, put together as docs/guides/encodings.md says."""

from __future__ import annotations

import base64
import functools
import math
from typing import Any

import orjson
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

Row = dict[str, Any]

OPTION = 51_700
"""The number of the option in which a field's key and the lengths of its matrices stand."""

_SPECIAL = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}


@functools.lru_cache
def message_class(schema: bytes, name: str) -> Any:
    """Return google's class for a message; its pool refuses descriptors that are not sound."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(name))


@functools.lru_cache
def _options() -> tuple[Any, Any]:
    file = descriptor_pb2.FileDescriptorProto(name="o.proto", package="o")
    file.dependency.append("google/protobuf/descriptor.proto")
    file.extension.add(name="o", number=OPTION, extendee=".google.protobuf.FieldOptions", type=12, label=1)
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(descriptor_pb2.DESCRIPTOR.serialized_pb)
    pool.Add(file)
    options = message_factory.GetMessageClass(pool.FindMessageTypeByName("google.protobuf.FieldOptions"))
    return options, pool.FindExtensionByName("o.o")


@functools.lru_cache(maxsize=10_000)
def option(field: Any) -> Row:
    """Return our option of a field, by google's own parser."""
    options, extension = _options()
    text: bytes = options.FromString(field.GetOptions().SerializeToString()).Extensions[extension]
    row: Row = orjson.loads(text) if text else {}
    return row


def row_of(schema: bytes, name: str, payload: bytes) -> Row:
    """Return the row of a message. Empty lists of numbers are not in it, because google does not show them."""
    message = message_class(schema, name).FromString(payload)
    row = _dict(message)
    time_s, exact = row.pop("_ts"), row.pop("_exact", "{}")
    for pointer, value in _exact(exact).items():
        *inside, last = [token.replace("~1", "/").replace("~0", "~") for token in pointer.split("/")[1:]]
        container: Any = row
        for token in inside:
            container = container[int(token) if isinstance(container, list) else token]
        container[int(last) if isinstance(container, list) else last] = value
    return {**row, "_ts": time_s}


def _exact(text: str) -> Row:
    values: Row = orjson.loads(text)
    for spelling, containers in values.pop("_exact", {}).items():
        for pointer, keys in containers.items():
            container: Any = values
            for token in pointer.split("/")[1:]:
                container = container[
                    int(token) if isinstance(container, list) else token.replace("~1", "/").replace("~0", "~")
                ]
            for key in keys:
                container[key] = _SPECIAL[spelling] if spelling in _SPECIAL else base64.b64decode(container[key])
    return values


def _dict(message: Any) -> Row:
    return {option(field).get("key", field.name): _value(field, value) for field, value in message.ListFields()}


def _value(field: Any, value: Any) -> Any:
    if not field.is_repeated:
        return value if field.message_type is None else _dict(value)
    values = [inner if field.message_type is None else _dict(inner) for inner in value]
    for length in reversed(option(field).get("lengths", [])):
        values = [values[at : at + length] for at in range(0, len(values), length)]
    return values
