"""The text of the definitions of our messages, and the messages that such a text describes.

The comment that describes a message has no square brackets, which `rosidl` would take for a unit.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

from ....codecs.ros import definitions
from ....codecs.ros.message_types import Definitions
from ....errors import EncodingError
from .lossless import STATE, Message, MessageField, size

MARK = "# ml_dash "
"""Begins the comment."""

SEPARATOR = "=" * 80
_HEADER = "builtin_interfaces/Time stamp\nstring frame_id\n"
_HEADER_ROS1 = "uint32 seq\ntime stamp\nstring frame_id\n"
_TIME = "int32 sec\nuint32 nanosec\n"
_TEXTS = ("topic", "description")
"""Entries about a topic that are stored as they are; all others are JSON in a text, which hides their brackets."""

# rosidl takes text in square brackets in a comment for a unit; others than such plain ones are not written.
_UNIT = re.compile(r"[^\[\],#\n]{1,40}")
_SECTION = re.compile(r"^MSG: *(?:\w+/)(?:msg/)?(\w+) *$")


def text(message: Message, package: str) -> str:
    """Return the definition of one message: the content of its `.msg` file."""
    metadata = message.about.get("metadata")
    units = metadata.get("units") if isinstance(metadata, Mapping) else None
    lines = [MARK + _describe(message)]
    if message.is_row:
        lines += ["", "std_msgs/Header header", "float64 ts  # the exact time stamp, in seconds"]
    if message.is_stated:
        lines.append(f"uint8[{len(message.fields)}] {STATE}  # of each field: 0 missing, 1 present, 2 None, 3 integer")
    for field in message.fields:
        unit = units.get(field.key) if isinstance(units, Mapping) else None
        lines.append(_line(field, package, unit))
        if field.integers is not None:
            lines.append(f"uint8{_brackets(field)} {field.integers}  # 1 where {field.name} has an integer")
    return "\n".join(lines) + "\n"


def embedded(message: Message, package: str, *, is_ros1: bool = False) -> str:
    """Return the definition of a message followed by those of all messages in it, as bags carry them."""
    parts = list(message.parts())
    sections = [text(message, package)]
    if message.is_row:
        sections.append("MSG: std_msgs/Header\n" + (_HEADER_ROS1 if is_ros1 else _HEADER))
        if not is_ros1:
            sections.append("MSG: builtin_interfaces/Time\n" + _TIME)
    sections += [f"MSG: {package}/{part.name}\n" + text(part, package) for part in parts[:-1]]
    return f"{SEPARATOR}\n".join(sections)


def describe(message: Message, package: str, *, is_ros1: bool = False) -> Definitions:
    """Return what a message is made of, as its definition says it.

    Raises:
        EncodingError: A name in it is none that a definition can have.
    """
    text = embedded(message, package, is_ros1=is_ros1)
    return definitions.parse(f"{package}/msg/{message.name}", text, is_ros1=is_ros1)


def parse(name: str, definition: str) -> Message | None:
    """Return the message that a definition describes, as `embedded` writes it; None if it is not one of ours.

    Args:
        name: Of the message, with or without its package.
        definition: With those of the messages in it.
    """
    described: dict[str, dict[str, Any]] = {}
    current = name.rpartition("/")[2]
    for line in definition.splitlines():
        section = _SECTION.match(line)
        if section is not None:
            current = section[1]
        elif line.startswith(MARK):
            try:
                comment = json.loads(line[len(MARK) :])
            except ValueError:
                return None
            if isinstance(comment, dict) and isinstance(comment.get("fields"), dict):
                described[current] = comment
    try:
        message = _message(name.rpartition("/")[2], described, is_row=True)
        describe(message, "package")
        return message
    except (EncodingError, KeyError, ValueError, TypeError, AttributeError, RecursionError):
        return None


def _line(field: MessageField, package: str, unit: object) -> str:
    kind = {"json": "string", "bytes": "uint8[]"}.get(field.kind, field.kind)
    if field.message is not None:
        kind = f"{package}/{field.message.name}"
    notes = []
    if isinstance(unit, str) and _UNIT.fullmatch(unit):
        notes.append(f"[{unit}]")
    if field.shape is not None and len(field.shape) > 1:
        notes.append(f"shape {_spelled(field.shape)}, row by row")
    if field.kind == "json":
        notes.append("JSON")
    return f"{kind}{_brackets(field)} {field.name}" + (f"  # {' '.join(notes)}" if notes else "")


def _brackets(field: MessageField) -> str:
    if field.shape is None:
        return "[]"
    return f"[{size(field.shape)}]" if field.shape else ""


def _spelled(shape: tuple[int, ...] | None) -> str:
    return "*" if shape is None else "x".join(map(str, shape))


def _describe(message: Message) -> str:
    fields: dict[str, dict[str, str]] = {}
    for field in message.fields:
        details = {"key": field.key} if field.key != field.name else {}
        details["kind"] = field.kind
        if field.shape != ():
            details["shape"] = _spelled(field.shape)
        if field.message is not None:
            details["message"] = field.message.name
        if field.integers is not None:
            details["integers"] = field.integers
        if field.is_array:
            details["array"] = "yes"
        fields[field.name] = details
    described: dict[str, Any] = {"version": 1, **({"stated": True} if message.is_stated else {}), "fields": fields}
    for name, value in message.about.items():
        described[name] = value if name in _TEXTS else json.dumps(value)
    # JSON's escapes keep the brackets away from rosidl and come back when the JSON is read.
    return json.dumps(described).replace("[", "\\u005b").replace("]", "\\u005d")


def _message(name: str, described: Mapping[str, dict[str, Any]], *, is_row: bool) -> Message:
    comment = described[name]
    fields = []
    for field_name, details in comment["fields"].items():
        inner = _message(details["message"], described, is_row=False) if "message" in details else None
        spelled = details.get("shape", "")
        shape = None if spelled == "*" else tuple(int(length) for length in spelled.split("x") if length)
        key, is_array = details.get("key", field_name), "array" in details
        fields.append(MessageField(key, field_name, details["kind"], shape, inner, details.get("integers"), is_array))
    own_keys = ("version", "stated", "fields")
    about = {
        key: value if key in _TEXTS else json.loads(value) for key, value in comment.items() if key not in own_keys
    }
    return Message(name, tuple(fields), bool(comment.get("stated", False)), is_row, about)
