"""Widens a layout by the fields that a row needs, within limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Protocol

from ...rows import schema
from ...rows.plain_row import has_lone_surrogates
from ...rows.shape import ArrayType
from .layout import MOST_DEPTH, Kind, Layout, Member, Slot, number_after
from .value_slots import as_doubles, fit

MOST_FIELDS = 4000
"""Fields of a topic, those inside dicts included."""

_LONGEST_NAME, _NAME_LETTERS = 1024, 256 * 1024
"""The longest key that becomes a field, and the letters that all keys of a topic may have: the descriptor stands in
each segment, with room to grow."""


class Growth:
    """Widens layouts by rows. Values that have no room left stay without a field, and go into the exact text."""

    def __init__(self, layout: Layout) -> None:
        """Begin with a layout."""
        self._room = MOST_FIELDS - layout.size
        self._letters = _NAME_LETTERS - layout.letters

    def widened(self, layout: Layout, fields: Mapping[str, Any], depth: int = 0) -> Layout:
        """Return a layout with a field for each value that can have one; the same object if all have one.

        Args:
            layout: Of the dict.
            fields: Plain values by key, without the time stamp.
            depth: In how many dicts this one lies.
        """
        draft = _Draft(layout)
        for key, value in fields.items():
            self._take(draft, key, value, depth)
        return draft.layout()

    def _take(self, draft: _Draft, key: str, value: Any, depth: int) -> None:
        fitting = fit(value)
        if fitting is None:
            return
        slot = fitting.slot
        member = member_for(draft, key, slot, value if not slot.is_list else fitting.leaves)
        if member is None:
            member = self._new_member(draft.next_number, key, slot, depth)
            if member is None:
                return
            draft.put(member)
        if slot.kind is Kind.ARRAY:
            described = _described(member.array, value)
            if described != member.array:
                draft.put(replace(member, array=described))
        if slot.kind is Kind.DICT:
            inner = member.inner or Layout()
            for dict_ in fitting.leaves if slot.is_list else (value,):
                inner = self.widened(inner, dict_, depth + 1)
            if inner is not member.inner:
                draft.put(replace(member, inner=inner))

    def _new_member(self, number: int, key: str, slot: Slot, depth: int) -> Member | None:
        if self._room <= 0 or len(key) > min(_LONGEST_NAME, self._letters) or has_lone_surrogates(key):
            return None
        if slot.kind is Kind.DICT and depth >= MOST_DEPTH:
            return None
        self._room -= 1
        self._letters -= len(key)
        return Member(number, key, slot, Layout() if slot.kind is Kind.DICT else None)


def _described(described: str, array: Any) -> str:
    """Return the description of arrays, widened by one more."""
    own = ArrayType(array.dtype.name, array.shape)
    before = schema.of_description(described).array if described else None
    return schema.description(own if before is None else before | own)


class Members(Protocol):
    """The fields of a message, by key and type."""

    def member(self, key: str, slot: Slot) -> Member | None:
        """Return the field of a key for values of a type; None if there is none yet."""


class _Draft:
    """A layout that is being widened. It is built once, because rows may have thousands of new fields."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._by_number: dict[int, Member] = {}
        self._by_key: dict[tuple[str, Slot], Member] = {}
        self.next_number = layout.next_number

    def member(self, key: str, slot: Slot) -> Member | None:
        return self._by_key.get((key, slot)) or self._layout.member(key, slot)

    def put(self, member: Member) -> None:
        self._by_number[member.number] = self._by_key[member.key, member.slot] = member
        if member.number == self.next_number:
            self.next_number = number_after(member.number)

    def layout(self) -> Layout:
        return self._layout.with_members(self._by_number) if self._by_number else self._layout


def member_for(members: Members, key: str, slot: Slot, values: Any) -> Member | None:
    """Return the field that holds a value; None if there is none yet.

    Integers go into a field of doubles if their key has one, so that viewers plot one series; the exact text then says
    that they were integers.

    Args:
        members: Of the dict.
        key: Of the value.
        slot: That fits the value.
        values: The value, or the leaves of a list.
    """
    if slot.kind in (Kind.INT, Kind.UINT):
        double = members.member(key, Slot(Kind.DOUBLE, slot.lengths))
        if double is not None and as_doubles(values if slot.is_list else (values,)):
            return double
    return members.member(key, slot)
