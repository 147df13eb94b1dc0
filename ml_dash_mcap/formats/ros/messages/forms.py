"""What values the fields of rows have, as far as a message for them must know it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ....rows import packed
from ....rows.encode import TIME_KEY, has_lone_surrogates

Row = dict[str, Any]

SAFE_INTEGER = 2**53
"""Integers up to here, and from its negative on, are doubles without rounding."""


class Form:
    """All values that a field, or the elements of a list, have had."""

    __slots__ = (
        "arrays",
        "count",
        "dicts",
        "fields",
        "first_text",
        "has_odd_text",
        "high",
        "items",
        "kinds",
        "longest",
        "low",
        "shortest",
    )

    def __init__(self) -> None:
        self.count = 0
        """How many there were; those that were not there do not count."""
        self.kinds: set[type] = set()
        """Their types: NoneType, bool, int, float, str, bytes, list, dict, numpy.ndarray."""
        self.arrays: set[str] = set()
        """Of the arrays: their types and shapes, as `rows.packed` spells them."""
        self.low = 0
        self.high = 0
        """Bounds of the integers, with 0 among them."""
        self.has_odd_text = False
        """Whether a text has a NUL, which ROS has no place for."""
        self.first_text: str | None = None
        """The first one that was a text."""
        self.dicts = 0
        """How many of them were dicts."""
        self.fields: dict[str, Form] = {}
        """Of the dicts: by key."""
        self.items: Form | None = None
        """Of the lists: all elements."""
        self.shortest: int | None = None
        self.longest = 0
        """Of the lists: their lengths."""

    def field(self, key: str) -> Form:
        """Return the form of one key's values."""
        form = self.fields.get(key)
        if form is None:
            form = self.fields[key] = Form()
        return form

    def elements(self) -> Form:
        """Return the form of the elements of lists."""
        if self.items is None:
            self.items = Form()
        return self.items

    def add(self, value: Any) -> None:
        """Take in a value."""
        kind = type(value)
        self.count += 1
        if isinstance(value, np.ndarray):
            kind = np.ndarray
            self.arrays.add(packed.spelling(value))
        self.kinds.add(kind)
        if kind is int:
            self.bound(value, value)
        elif kind is str:
            self.has_odd_text = self.has_odd_text or "\0" in value or has_lone_surrogates(value)
            if self.first_text is None:
                self.first_text = value
        elif kind is list:
            self.lengths(len(value), len(value))
            for element in value:
                self.elements().add(element)
        elif kind is dict:
            self.dicts += 1
            for key, inner in value.items():
                self.field(key).add(inner)

    def bound(self, low: int, high: int) -> None:
        """Take in the bounds of integers."""
        self.low, self.high = min(self.low, low), max(self.high, high)

    def lengths(self, shortest: int, longest: int) -> None:
        """Take in the lengths of lists."""
        self.shortest = shortest if self.shortest is None else min(self.shortest, shortest)
        self.longest = max(self.longest, longest)

    @property
    def is_safe(self) -> bool:
        """Whether a double holds all integers."""
        return self.low >= -SAFE_INTEGER and self.high <= SAFE_INTEGER


def of_rows(rows: Iterable[Mapping[str, Any]], form: Form | None = None) -> Form:
    """Return the form of rows, without their time stamps, in a form that has taken in others already."""
    form = Form() if form is None else form
    form.kinds.add(dict)
    for row in rows:
        form.count += 1
        form.dicts += 1
        for key, value in row.items():
            if key != TIME_KEY:
                form.field(key).add(value)
    return form
