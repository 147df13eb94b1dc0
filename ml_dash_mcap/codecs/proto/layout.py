"""The layout of a topic's rows as protobuf messages: which field number holds which key, as which type.

A layout only ever grows: a key that comes later, or with values of another type, gets a further field. So bytes that
were written under an earlier layout are read the same under every later one.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any, NamedTuple

from . import wire

TIME_NUMBER = 1
"""The field number of the time stamp, which is always the last field in the bytes of a row."""

EXACT_NUMBER = 2
"""The field number of the text that holds what no other field can express (see `exact_values`)."""

_FIRST_NUMBER = 3
_FIRST_NUMBER_INSIDE = 1

_RESERVED_NUMBERS = range(19_000, 20_000)
"""Protobuf keeps these for itself."""


MOST_DEPTH = 32
"""So many dicts may lie in each other as messages. Decoders of protobuf refuse more than 100."""

MOST_OPAQUE = 100
"""So many paths of values without a field are named."""


class Kind(Enum):
    """The type of a field."""

    DOUBLE = "double"
    INT = "sfixed64"
    """Integers that 64 bits with a sign hold. They have a fixed width, so that rows of one kind have one length."""
    UINT = "fixed64"
    """Integers from 2**63 on, and lists that have one of these and none below 0."""
    BOOL = "bool"
    TEXT = "string"
    BYTES = "bytes"
    DICT = "message"
    ARRAY = "Array"
    """A large array of numpy, with its type and shape beside its bytes."""

    @property
    def struct_code(self) -> str | None:
        """The format of `struct` for one number; None for what has no fixed width."""
        return _STRUCT_CODES.get(self)

    @property
    def packed_bytes(self) -> int:
        """How many bytes one number has in a list of packed ones."""
        return struct.calcsize(f"<{_STRUCT_CODES[self]}")

    @property
    def is_packed(self) -> bool:
        """Whether lists of it are one field of packed numbers."""
        return self in _STRUCT_CODES

    @property
    def wire_type(self) -> int:
        """The wire type of a single value."""
        return _WIRE_TYPES.get(self, wire.DELIMITED)


_STRUCT_CODES = {Kind.DOUBLE: "d", Kind.INT: "q", Kind.UINT: "Q", Kind.BOOL: "?"}
_WIRE_TYPES = {Kind.DOUBLE: wire.FIXED64, Kind.INT: wire.FIXED64, Kind.UINT: wire.FIXED64, Kind.BOOL: wire.VARINT}


class Slot(NamedTuple):
    """The type of a value, as far as a field is made for it."""

    kind: Kind
    lengths: tuple[int, ...] | None = None
    """None for a single value. For lists, the lengths of all dimensions but the first: () for [N], (4,) for [N, 4]."""

    @property
    def is_list(self) -> bool:
        """Whether it is one of lists."""
        return self.lengths is not None

    @property
    def is_packed(self) -> bool:
        """Whether it is one field of packed numbers."""
        return self.lengths is not None and self.kind.is_packed


@dataclass(frozen=True, slots=True)
class Member:
    """One field of a message."""

    number: int
    key: str
    """The key in the row's dict."""
    slot: Slot
    inner: Layout | None = None
    """Of dicts: the layout of these."""
    array: str = ""
    """Of large arrays: the type and shape that all of them have, see `rows.schema.description`."""

    @property
    def tag(self) -> bytes:
        """The bytes before the value, or before its length."""
        is_delimited = self.slot.is_list or self.slot.kind.wire_type == wire.DELIMITED
        return wire.tag(self.number, wire.DELIMITED if is_delimited else self.slot.kind.wire_type)


@dataclass(frozen=True, slots=True)
class Layout:
    """The fields of one message. It does not change; `with_members` returns another one."""

    members: tuple[Member, ...] = ()
    """In the order of their numbers."""
    is_row: bool = False
    """Whether it is the message of a whole row, which has a time stamp and an exact text besides."""
    opaque: tuple[str, ...] = ()
    """Of a row: the paths (dotted) of values that some rows have in the exact text, because no field expresses them."""
    units: tuple[tuple[str, str], ...] = ()
    """Of a row: the paths (dotted) of fields that have a unit, with the unit."""
    size: int = field(init=False, compare=False, repr=False)
    """The number of fields, those inside included."""
    letters: int = field(init=False, compare=False, repr=False)
    """The length of all keys together, those inside included."""
    by_number: Mapping[int, Member] = field(init=False, compare=False, repr=False)
    by_key: Mapping[str, Mapping[Slot, Member]] = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "by_number", {member.number: member for member in self.members})
        by_key: dict[str, dict[Slot, Member]] = {}
        for member in self.members:
            by_key.setdefault(member.key, {})[member.slot] = member
        object.__setattr__(self, "by_key", by_key)
        inner = [member.inner for member in self.members if member.inner is not None]
        object.__setattr__(self, "size", len(self.members) + sum(layout.size for layout in inner))
        letters = sum(len(member.key) for member in self.members) + sum(layout.letters for layout in inner)
        object.__setattr__(self, "letters", letters)

    @property
    def next_number(self) -> int:
        """The number for the next field."""
        if not self.members:
            return _FIRST_NUMBER if self.is_row else _FIRST_NUMBER_INSIDE
        return number_after(self.members[-1].number)

    def member(self, key: str, slot: Slot) -> Member | None:
        """Return the field of a key for values of a type; None if there is none yet."""
        slots = self.by_key.get(key)
        return None if slots is None else slots.get(slot)

    def with_members(self, changed: Mapping[int, Member]) -> Layout:
        """Return a layout with further fields, by number in order, or with others in the place of fields it has."""
        kept = tuple(changed.get(member.number, member) for member in self.members)
        added = tuple(member for number, member in changed.items() if number not in self.by_number)
        return replace(self, members=kept + added)

    def lacks_opaque(self, paths: Iterable[str]) -> bool:
        """Whether it does not name some values yet which no field expresses, and has room to do so."""
        return len(self.opaque) < MOST_OPAQUE and not set(paths) <= set(self.opaque)

    def with_opaque(self, paths: Iterable[str]) -> Layout:
        """Return a layout that names some more values which no field expresses; the same object if there is no room."""
        opaque = tuple(dict.fromkeys((*self.opaque, *paths)))[:MOST_OPAQUE]
        return self if opaque == self.opaque else replace(self, opaque=opaque)


def number_after(number: int) -> int:
    """Return the next number that a field may have."""
    return _RESERVED_NUMBERS.stop if number + 1 in _RESERVED_NUMBERS else number + 1


ROW = Layout(is_row=True)
"""The layout of rows before the first one."""

Fields = Mapping[str, Any]
