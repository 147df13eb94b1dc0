"""Widens a layout by the fields that a row needs, within limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from .layout import Kind, Layout, Member, Slot
from .value_slots import as_doubles, fit

MOST_FIELDS = 4000
"""Fields of a topic, those inside dicts included."""

MOST_DEPTH = 32
"""So many dicts may lie in each other as messages. Decoders of protobuf refuse more than 100."""

_LONGEST_NAME, _NAME_LETTERS = 1024, 256 * 1024
"""The longest key that becomes a field, and the letters that all keys of a topic may have: the descriptor stands in
each segment, with room to grow."""


class Growth:
    """Widens layouts by rows. Values that have no room left stay without a field, and go into the exact text."""

    def __init__(self, layout: Layout) -> None:
        """Begin with a layout."""
        self._room = MOST_FIELDS - layout.size
        self._letters = _NAME_LETTERS - _letters(layout)

    def widened(self, layout: Layout, fields: Mapping[str, Any], depth: int = 0) -> Layout:
        """Return a layout with a field for each value that can have one; the same object if all have one.

        Args:
            layout: Of the dict.
            fields: Plain values by key, without the time stamp.
            depth: In how many dicts this one lies.
        """
        for key, value in fields.items():
            layout = self._with_value(layout, key, value, depth)
        return layout

    def _with_value(self, layout: Layout, key: str, value: Any, depth: int) -> Layout:
        found = fit(value)
        if found is None:
            return layout
        slot = found.slot
        member = member_for(layout, key, slot, value if not slot.is_list else found.leaves)
        if member is None:
            member = self._new_member(layout, key, slot, depth)
            if member is None:
                return layout
            layout = layout.with_member(member)
        if slot.kind is not Kind.DICT:
            return layout
        inner = member.inner or Layout()
        for dict_ in found.leaves if slot.is_list else (value,):
            inner = self.widened(inner, dict_, depth + 1)
        return layout if inner is member.inner else layout.with_member(replace(member, inner=inner))

    def _new_member(self, layout: Layout, key: str, slot: Slot, depth: int) -> Member | None:
        if self._room <= 0 or len(key) > min(_LONGEST_NAME, self._letters):
            return None
        if slot.kind is Kind.DICT and depth >= MOST_DEPTH:
            return None
        self._room -= 1
        self._letters -= len(key)
        return Member(layout.next_number, key, slot, Layout() if slot.kind is Kind.DICT else None)


def member_for(layout: Layout, key: str, slot: Slot, values: Any) -> Member | None:
    """Return the field that holds a value; None if there is none yet.

    Integers go into a field of doubles if their key has one, so that viewers plot one series; the exact text then says
    that they were integers.

    Args:
        layout: Of the dict.
        key: Of the value.
        slot: That fits the value.
        values: The value, or the leaves of a list.
    """
    if slot.kind in (Kind.INT, Kind.UINT):
        double = layout.member(key, Slot(Kind.DOUBLE, slot.lengths))
        if double is not None and as_doubles(values if slot.is_list else (values,)):
            return double
    return layout.member(key, slot)


def _letters(layout: Layout) -> int:
    inside: Sequence[int] = [_letters(member.inner) for member in layout.members if member.inner is not None]
    return sum(len(member.key) for member in layout.members) + sum(inside)
