"""Flattens rows with nested dicts into rows with dotted names."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping
from typing import Any

from .plain_row import TIME_KEY

Row = dict[str, Any]

FIELD_PREFIX = "fields."
"""The prefix of a field whose name is that of the time column."""


def flatten(row: Mapping[str, Any], time_name: str) -> Row:
    """Return a row with dotted names for the fields of nested dicts, and its time first.

    A field that has the name of the time column comes back under `fields.<name>`; a nested field whose dotted name
    is also the literal name of another one, under that name with `#2` behind it. An empty dict stays what it is.

    Args:
        row: Fields as they were given, and `_ts`.
        time_name: The name of the time stamp, such as "timestamp".
    """
    # Most rows have no dict in them, and are copied without a look at each field.
    if time_name == TIME_KEY and dict not in map(type, row.values()):
        return {TIME_KEY: row[TIME_KEY], **row}
    if time_name not in row and dict not in map(type, row.values()):
        flat: Row = {time_name: row[TIME_KEY], **row}
        del flat[TIME_KEY]
        return flat
    flat = {time_name: row[TIME_KEY]}
    for name, value in row.items():
        if isinstance(value, dict) and value:
            _flatten_into(flat, name, value)
        elif name != TIME_KEY:
            _put(flat, FIELD_PREFIX + name if name == time_name else name, value)
    return flat


def _flatten_into(flat: Row, parent: str, inner: Mapping[str, Any]) -> None:
    for key, value in inner.items():
        name = f"{parent}.{key}"
        if isinstance(value, dict) and value:
            _flatten_into(flat, name, value)
        else:
            _put(flat, name, value)


def _put(flat: Row, name: str, value: Any) -> None:
    flat[free_name(name, flat)] = value


def free_name(name: str, taken: Container[str]) -> str:
    """Return a name that is not taken: the name itself, or with `#2`, `#3` and so on behind it."""
    free, number = name, 1
    while free in taken:
        number += 1
        free = f"{name}#{number}"
    return free


def free_names(names: Iterable[str]) -> list[str]:
    """Return names of which none occurs twice, as `flatten` makes them: `#2` stands behind the second of two."""
    free: dict[str, None] = {}
    for name in names:
        free[free_name(name, free)] = None
    return list(free)
