"""A read-only mapping whose values are made when they are asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TypeVar

from ..suggestions import not_found

Value = TypeVar("Value")


class Lookup(Mapping[str, Value]):
    """A read-only mapping; each value is made anew when it is asked for.

    Example:
        >>> lookup = Lookup("topic", ["imu", "robot"], len)
        >>> lookup["robot"]
        5
    """

    def __init__(self, what: str, names: Iterable[str], make: Callable[[str], Value], where: str = "") -> None:
        """Make a mapping.

        Args:
            what: The kind of thing that has a name, for the error messages, such as "topic".
            names: Its keys, in the order in which they are iterated.
            make: Returns the value of a name.
            where: The place that was searched, for the error messages, such as the recording's path.
        """
        self._what = what
        self._names = dict.fromkeys(names)
        self._make = make
        self._where = where

    def __getitem__(self, name: str) -> Value:
        """Make the value of a name.

        Raises:
            NotFoundError: There is no such name; the message names similar ones. Also a KeyError.
        """
        if name not in self._names:
            raise not_found(self._what, name, self._names, self._where)
        return self._make(name)

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __repr__(self) -> str:
        return f"<{self._what}s: {', '.join(self._names) or 'none'}>"
