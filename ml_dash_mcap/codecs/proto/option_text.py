"""Writes the options of files, messages and fields as a .proto file has them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import Any

from google.protobuf import descriptor_pb2

from . import names

_Field = descriptor_pb2.FieldDescriptorProto

_UNSAFE = re.compile(r'[\x00-\x1f"\\\x7f]')


def quoted(text: str) -> str:
    """Return a text as a literal."""
    return '"' + _UNSAFE.sub(lambda match: f"\\{ord(match[0]):03o}", text) + '"'


def bracketed(entries_: Iterable[str]) -> str:
    """Return options behind a field or a value; nothing without any."""
    text = ", ".join(entries_)
    return f" [{text}]" if text else ""


def entries(options: Any) -> list[str]:
    """Return the options of something as `name = value`, without those that extensions define."""
    return list(_entries(options, ""))


def of_field(field: Any) -> str:
    """Return what stands in brackets behind a field: its default, its name in JSON, its options."""
    listed = []
    if field.HasField("default_value"):
        listed.append(f"default = {_default(field)}")
    if field.json_name not in ("", names.json_name(field.name)) and not field.extendee:
        listed.append(f"json_name = {quoted(field.json_name)}")
    return bracketed([*listed, *entries(field.options)])


def _entries(options: Any, prefix: str) -> Iterator[str]:
    for described, value in options.ListFields():
        if described.name == "uninterpreted_option" or described.is_extension or described.name == "map_entry":
            continue
        name = f"{prefix}{described.name}"
        for each in [value] if _is_single(described) else value:
            if described.message_type is None:
                yield f"{name} = {_value(described, each)}"
            elif _is_single(described):
                yield from _entries(each, f"{name}.")


def _is_single(described: Any) -> bool:
    if hasattr(described, "is_repeated"):
        return not described.is_repeated
    return bool(described.label != _Field.LABEL_REPEATED)  # protobuf before 6.31


def _value(described: Any, value: Any) -> str:
    if described.enum_type is not None:
        named = described.enum_type.values_by_number.get(value)
        return str(value) if named is None else str(named.name)
    if isinstance(value, bool):
        return "true" if value else "false"
    return quoted(value) if isinstance(value, str) else str(value)


def _default(field: Any) -> str:
    """Return a default as a literal. Those of bytes are escaped in descriptors, those of texts are not."""
    if field.type == _Field.TYPE_STRING:
        return quoted(field.default_value)
    return f'"{field.default_value}"' if field.type == _Field.TYPE_BYTES else str(field.default_value)
