"""The template of rows that have the same fields in the same order: where their tags, lengths and values lie.

A template is made from one row. What it says of another row is true of every row whose tags and lengths turn out to be
those of the template: the decoder of single rows would then read the same fields at the same places.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from . import wire
from .layout import EXACT_NUMBER, TIME_NUMBER, Kind, Layout, Member, Slot

TIME_MEMBER = Member(TIME_NUMBER, "", Slot(Kind.DOUBLE))
"""The field of the time stamp, which no layout lists."""

ALL_ALIKE: frozenset[Kind] = frozenset()
TEXTS_DIFFER = frozenset((Kind.TEXT, Kind.BYTES))
LENGTHS_DIFFER = frozenset(Kind) - {Kind.DICT}
"""The kinds of fields whose lengths may differ from row to row, for three sorts of templates."""

_MOST_VALUES = 4096
"""Rows with more fields, those in lists of dicts included, have no template."""


class FixedRun(NamedTuple):
    """Bytes at fixed distances from each other."""

    length: int
    marks: tuple[tuple[int, int], ...]
    """The places of tags and lengths in the run, each with the byte that is there."""
    booleans: tuple[int, ...]
    """The places of booleans."""


class Varying(NamedTuple):
    """A length, and as many bytes."""

    value: int
    """The number of the value that the bytes are."""


class Enter(NamedTuple):
    """The length of a dict. The dict follows."""


class Leave(NamedTuple):
    """The end of the dict that was entered last."""


Step = FixedRun | Varying | Enter | Leave


class FixedPlace(NamedTuple):
    """Where a value of fixed length lies."""

    step: int
    """The number of the run."""
    at: int
    """Where in the run it begins."""
    length: int


class Leaf(NamedTuple):
    """The values of a field that is no dict."""

    member: Member
    values: list[int]
    """The numbers of the values: one, or of lists of texts one for each text."""


Node = Any
"""What a row has under a key: a `Leaf`, a dict of nodes by key, or a list of such dicts."""


@dataclass(slots=True)
class RowTemplate:
    """How rows are laid out that have the same fields in the same order."""

    steps: list[Step] = field(default_factory=list)
    places: list[FixedPlace | None] = field(default_factory=list)
    """Of each value; None for those that a step `Varying` finds."""
    members: list[Member] = field(default_factory=list)
    """Of each value: its field."""
    row: dict[str, Node] = field(default_factory=dict)
    """The values by key, without the time stamp."""
    time: int = -1
    """The number of the value that is the time stamp."""

    @property
    def is_fixed(self) -> bool:
        """Whether all rows have one length, and all values lie at the same places."""
        return len(self.steps) == 1 and isinstance(self.steps[0], FixedRun)

    @property
    def length(self) -> int:
        """How many bytes the runs of a row have: all bytes, if it is fixed."""
        return sum(step.length for step in self.steps if isinstance(step, FixedRun))


def of_row(payload: bytes, layout: Layout, differ: Collection[Kind]) -> RowTemplate | None:
    """Return the template of a row; None for rows that only Python objects hold, or that are none of the layout.

    Args:
        payload: The row.
        layout: Of the topic.
        differ: The kinds of fields whose lengths may differ in other rows of the template.
    """
    parser = _RowParser(payload, differ)
    try:
        parser.fields(layout, 0, len(payload), parser.template.row)
    except (ValueError, RecursionError):
        return None
    parser.end_run(len(payload))
    return parser.template if parser.template.time >= 0 else None


class _UnfitError(ValueError):
    """The row has something that templates do not express."""


class _RowParser:
    """Walks through a row."""

    def __init__(self, payload: bytes, differ: Collection[Kind]) -> None:
        self.template = RowTemplate()
        self._payload = payload
        self._differ = differ
        self._start = 0
        """Where the run began that is not ended yet."""
        self._marks: list[int] = []
        self._booleans: list[int] = []

    def fields(self, layout: Layout, at: int, end: int, into: dict[str, Node]) -> None:
        """Take the fields of a dict."""
        for wire_field in wire.fields(self._payload, at, end):
            if layout.is_row and wire_field.number == TIME_NUMBER:
                self._take_time(wire_field)
                continue
            member = layout.by_number.get(wire_field.number)
            if member is None or (layout.is_row and wire_field.number == EXACT_NUMBER) or not _fits(member, wire_field):
                raise _UnfitError
            if member.slot.kind is Kind.DICT:
                self._take_dict(member, wire_field, into)
            else:
                _put(into, member, self._value(member, wire_field))

    def _take_time(self, wire_field: wire.WireField) -> None:
        if wire_field.wire_type != wire.FIXED64 or self.template.time >= 0:
            raise _UnfitError
        self.template.time = self._value(TIME_MEMBER, wire_field)

    def _take_dict(self, member: Member, wire_field: wire.WireField, into: dict[str, Node]) -> None:
        inner: dict[str, Node] = {}
        if self._differ:
            self._mark(wire_field.start, self._length_start(wire_field))
            self.end_run(wire_field.value_start)
            self.template.steps.append(Enter())
        else:
            self._mark(wire_field.start, wire_field.value_start)
        self.fields(member.inner or Layout(), wire_field.value_start, wire_field.end, inner)
        if self._differ:
            self.end_run(wire_field.end)
            self.template.steps.append(Leave())
        if not inner:
            raise _UnfitError
        if not member.slot.is_list:
            if member.key in into:
                raise _UnfitError
            into[member.key] = inner
            return
        dicts = into.setdefault(member.key, [])
        if not isinstance(dicts, list):
            raise _UnfitError
        dicts.append(inner)

    def _value(self, member: Member, wire_field: wire.WireField) -> int:
        """Take a value; returns its number."""
        template = self.template
        number = len(template.places)
        if number >= _MOST_VALUES:
            raise _UnfitError
        template.members.append(member)
        if wire_field.wire_type == wire.DELIMITED and member.slot.kind in self._differ:
            self._mark(wire_field.start, self._length_start(wire_field))
            self.end_run(wire_field.end)
            template.steps.append(Varying(number))
            template.places.append(None)
            return number
        self._mark(wire_field.start, wire_field.value_start)
        if member.slot.kind is Kind.BOOL and not member.slot.is_list:
            if wire_field.end - wire_field.value_start != 1:
                raise _UnfitError
            self._booleans.append(wire_field.value_start)
        template.places.append(
            FixedPlace(
                len(template.steps), wire_field.value_start - self._start, wire_field.end - wire_field.value_start
            )
        )
        return number

    def _length_start(self, wire_field: wire.WireField) -> int:
        return wire.read_varint(self._payload, wire_field.start, wire_field.end)[1]

    def _mark(self, start: int, end: int) -> None:
        self._marks += range(start, end)

    def end_run(self, next_start: int) -> None:
        """End the run behind the last byte that was marked or taken.

        Args:
            next_start: Where the next run begins.
        """
        length = self._end() - self._start
        if length:
            marks = tuple((at - self._start, self._payload[at]) for at in self._marks)
            self.template.steps.append(FixedRun(length, marks, tuple(at - self._start for at in self._booleans)))
        self._start = next_start
        self._marks, self._booleans = [], []

    def _end(self) -> int:
        """Return where the run ends so far."""
        ends = [self._marks[-1] + 1] if self._marks else [self._start]
        place = self.template.places[-1] if self.template.places else None
        if place is not None and place.step == len(self.template.steps):
            ends.append(self._start + place.at + place.length)
        return max(ends)


def _fits(member: Member, wire_field: wire.WireField) -> bool:
    """Whether a field is encoded as its type says."""
    slot = member.slot
    if wire_field.wire_type != (wire.DELIMITED if slot.is_list else slot.kind.wire_type):
        return False
    return not slot.is_packed or not (wire_field.end - wire_field.value_start) % bytes_of_each(slot)


def bytes_of_each(slot: Slot) -> int:
    """Return of how many bytes the bytes of a list of packed numbers are a multiple."""
    return slot.kind.packed_bytes * math.prod(slot.lengths or ())


def _put(into: dict[str, Node], member: Member, value: int) -> None:
    """Put a value under its key."""
    before = into.get(member.key)
    if before is None:
        into[member.key] = Leaf(member, [value])
    elif isinstance(before, Leaf) and before.member is member and member.slot.is_list and not member.slot.is_packed:
        before.values.append(value)
    else:
        raise _UnfitError
