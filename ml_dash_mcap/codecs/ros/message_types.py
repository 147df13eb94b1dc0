"""The model of a ROS message's type, for definitions in every language, and for reading and writing messages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np

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

_DTYPES: Mapping[str, np.dtype[Any]] = {
    name: np.dtype("u1" if code == "?" else f"<{code}") for name, code in CODES.items()
}

ROS1_ALIASES: Mapping[str, str] = {"byte": "int8", "char": "uint8"}
ROS2_ALIASES: Mapping[str, str] = {"byte": "uint8", "char": "uint8"}
"""The types that the two generations mean by the names `byte` and `char` (http://wiki.ros.org/msg,
section "Field Types";
https://design.ros2.org/articles/legacy_interface_definition.html)."""

PLACEHOLDER = "structure_needs_at_least_one_member"
"""The field, of one byte, that ROS 2 sends for a message without fields."""

APPENDABLE, MUTABLE = "appendable", "mutable"

_SUBFOLDERS = frozenset({"msg", "srv", "action"})


@dataclass(frozen=True, slots=True)
class Basic:
    """A number or a text."""

    name: str
    """One of `CODES`, or `STRING`."""
    is_enum: bool = False
    """Whether the number is one of an enumeration, which XCDR2 tells apart in lists."""

    @property
    def is_text(self) -> bool:
        """Whether it is a text, in UTF-8."""
        return self.name == STRING

    @property
    def dtype(self) -> np.dtype[Any]:
        """The bytes of the number, little-endian; those of a bool are a uint8."""
        return _DTYPES[self.name]


@dataclass(frozen=True, slots=True)
class Named:
    """Another message."""

    name: str
    """As `canonical` has it."""


@dataclass(frozen=True, slots=True)
class Array:
    """A list or an array of values of one type."""

    of: Type
    length: int | None
    """How many; None where each message says so."""


@dataclass(frozen=True, slots=True)
class Optional:
    """A value that each message has or lacks, in which case it is None."""

    of: Type


@dataclass(frozen=True, slots=True)
class Undecoded:
    """A type that definitions may use and that this library does not decode."""

    name: str
    """Such as "wstring"."""


Type: TypeAlias = "Basic | Named | Array | Optional | Undecoded"

Fields: TypeAlias = Mapping[str, Type]
"""A message's fields, in the order on the wire."""


@dataclass(frozen=True, slots=True)
class Definitions:
    """A message, and all others that it is made of."""

    root: str
    """Its name, as `canonical` has it."""
    messages: Mapping[str, Fields]
    extensibility: Mapping[str, str] = field(default_factory=dict)
    """Messages whose definition says whether they are "final", "appendable" or "mutable"."""
    has_placeholders: bool = True
    """Whether CDR has a byte for a message without fields, as ROS 2 sends it."""
    guesses: tuple[str, ...] = ()
    """Assumptions that were made when missing definitions were looked up, in words."""

    readers: dict[Any, Any] = field(default_factory=dict, compare=False, repr=False)
    """The compiled functions that read this message, by wire format, default extensibility and handling of bad
    texts."""

    def has_optional(self) -> bool:
        """Whether a field of any message may be absent."""
        return any(
            isinstance(field_type, Optional) for fields in self.messages.values() for field_type in fields.values()
        )


def canonical(name: str) -> str:
    """Return a message's name as `package/Name`, whether `msg`, `srv` or `action` stood in between, or `::`."""
    parts = name.replace("::", "/").strip("/").split("/")
    if len(parts) > 2 and parts[-2] in _SUBFOLDERS:
        del parts[-2]
    return "/".join(parts)


def numbers_in(type_: Type) -> Basic | None:
    """Return the numbers that a list directly holds; None for a list of anything else."""
    item = type_.of if isinstance(type_, Array) else None
    return item if isinstance(item, Basic) and not item.is_text else None


def innermost_of(type_: Type) -> Type:
    """Return the type of the innermost items of a list, or the type itself."""
    while isinstance(type_, (Array, Optional)):
        type_ = type_.of
    return type_


def shortened(name: str) -> str:
    """Return a name without what stands between its first and its last part."""
    parts = name.split("/")
    return name if len(parts) < 3 else f"{parts[0]}/{parts[-1]}"
