"""The choice of the method that brings each column onto another clock."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from ..errors import AlignmentError, UsageError
from ..suggestions import not_found

PREVIOUS, NEAREST, LINEAR, SLERP = "previous", "nearest", "linear", "slerp"

METHODS = (PREVIOUS, NEAREST, LINEAR, SLERP)

ALL_OTHERS = "*"
"""Names the method of all columns that no other name speaks of."""


@dataclass(frozen=True, slots=True)
class Choice:
    """The method of a column."""

    method: str
    is_explicit: bool = False
    """Whether the column was named, so that values without this method are a mistake."""


class Methods:
    """A caller's choice with `how=`: one method for all columns, or names to methods."""

    def __init__(self, how: str | Mapping[str, str]) -> None:
        """Check a caller's choice.

        Args:
            how: A method, or a mapping from "topic.field", from a dict of fields such as "topic.camera", from "topic"
                or from "*" to methods. The longest name that fits counts; "previous" where none does.

        Raises:
            AlignmentError: There is no such method.
            UsageError: It is neither a text nor a mapping.
        """
        if not isinstance(how, (str, Mapping)):
            raise UsageError(f"how={how!r}: pass a method, or a dict of names to methods")
        self._method_by_name = {ALL_OTHERS: how} if isinstance(how, str) else dict(how)
        for name, method in self._method_by_name.items():
            if method not in METHODS:
                raise AlignmentError(f"how={how!r}: {name!r} is {method!r}; the methods are {', '.join(METHODS)}")

    @property
    def has_names(self) -> bool:
        """Whether it names single topics or columns."""
        return bool(set(self._method_by_name) - {ALL_OTHERS})

    def of(self, topic: str, field: str) -> Choice:
        """Return the method of a column."""
        column = f"{topic}.{field}"
        for name in (column, *_above(topic, field), ALL_OTHERS):
            if name in self._method_by_name:
                return Choice(self._method_by_name[name], name == column)
        return Choice(PREVIOUS)

    def check_names(self, columns: Mapping[str, Iterable[str]]) -> None:
        """Check that each name stands for something.

        Args:
            columns: The fields of each topic.

        Raises:
            NotFoundError: One does not; the message names similar ones. Also a KeyError.
        """
        nameable: dict[str, Any] = {ALL_OTHERS: None}
        for topic, fields in columns.items():
            for field in fields:
                nameable.update(dict.fromkeys((f"{topic}.{field}", *_above(topic, field))))
            nameable[topic] = None
        for name in self._method_by_name:
            if name not in nameable:
                raise not_found("column", name, nameable)


def _above(topic: str, field: str) -> list[str]:
    """Return the names of the containers of a field, the nearest first: dicts of fields, then the topic."""
    parts = field.split(".")
    return [*(f"{topic}.{'.'.join(parts[:depth])}" for depth in range(len(parts) - 1, 0, -1)), topic]
