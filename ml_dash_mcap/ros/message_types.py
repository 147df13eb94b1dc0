"""What a ROS message is made of, whichever language said so."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

STRING = "string"

CODES: Mapping[str, str] = {
    "bool": "?",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
"""Numbers, to the codes that the `struct` module has for them."""

ROS1_ALIASES: Mapping[str, str] = {"byte": "int8", "char": "uint8"}
ROS2_ALIASES: Mapping[str, str] = {"byte": "uint8", "char": "uint8"}
"""What the two generations mean by names that say little (http://wiki.ros.org/msg, section "Field Types";
https://design.ros2.org/articles/legacy_interface_definition.html)."""

PLACEHOLDER = "structure_needs_at_least_one_member"
"""The field, of one byte, that ROS 2 sends for a message without fields."""


@dataclass(frozen=True, slots=True)
class Basic:
    """A number or a text."""

    name: str
    """One of `CODES`, or `STRING`."""


@dataclass(frozen=True, slots=True)
class Named:
    """Another message."""

    name: str
    """As `canonical` has it."""


@dataclass(frozen=True, slots=True)
class Array:
    """Several of a kind."""

    of: Type
    length: int | None
    """How many; None where each message says so."""


Type: TypeAlias = "Basic | Named | Array"

Fields: TypeAlias = Mapping[str, Type]
"""A message's fields, in the order on the wire."""


@dataclass(frozen=True, slots=True)
class Definitions:
    """A message, and all others that it is made of."""

    root: str
    """Its name, as `canonical` has it."""
    messages: Mapping[str, Fields]


def canonical(name: str) -> str:
    """Return a message's name as `package/Name`, whether `msg`, `srv` or `action` stood in between, or `::`."""
    parts = name.replace("::", "/").strip("/").split("/")
    return parts[0] if len(parts) == 1 else f"{parts[0]}/{parts[-1]}"
