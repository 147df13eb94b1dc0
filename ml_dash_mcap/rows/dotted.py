"""Rows with nested dicts as rows with dotted columns, and the choice of columns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from ..errors import UsageError
from .encode import TIME_KEY

Row = dict[str, Any]

FIELD_PREFIX = "fields."
"""What a field is prefixed with whose name the row's own time already has."""


def check_columns(columns: Iterable[str] | None) -> list[str] | None:
    """Return the columns asked for; None for all, which an empty list means too.

    Raises:
        UsageError: They are not a list of names.
    """
    if columns is None:
        return None
    if isinstance(columns, (str, bytes)):
        raise UsageError(f"columns={columns!r}: pass a list of names, such as columns=[{columns!r}]")
    names = list(columns)
    for name in names:
        if not isinstance(name, str):
            raise UsageError(f"columns={names!r}: {name!r} is not a name")
    return names or None


def is_wanted(name: str, columns: Iterable[str] | None) -> bool:
    """Whether a dotted name is one of those asked for or lies inside one; None asks for all."""
    return columns is None or any(name == column or name.startswith(column + ".") for column in columns)


def flatten(row: Mapping[str, Any], time_name: str) -> Row:
    """Return a row with dotted names for what lies in nested dicts, and its time first.

    A field that has the name of the time column comes back under `fields.<name>`; a nested field whose dotted name
    is also the literal name of another one, under that name with `#2` behind it. An empty dict stays what it is.

    Args:
        row: Fields as they were given, and `_ts`.
        time_name: What to call the time stamp, such as "timestamp".
    """
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
    free, number = name, 1
    while free in flat:
        number += 1
        free = f"{name}#{number}"
    flat[free] = value


def free_names(names: Iterable[str]) -> list[str]:
    """Return names of which none occurs twice, as `flatten` makes them: `#2` stands behind the second of two."""
    free: dict[str, None] = {}
    for name in names:
        candidate, number = name, 1
        while candidate in free:
            number += 1
            candidate = f"{name}#{number}"
        free[candidate] = None
    return list(free)


def project(row: Mapping[str, Any], columns: Iterable[str]) -> Row:
    """Return a row with some of its fields, still nested, and `_ts`.

    Args:
        row: Fields as they were given, and `_ts`.
        columns: Names; a dotted one reaches into nested dicts, and one of a nested dict takes all of it. Names that
            the row does not have are left out.
    """
    chosen: Row = {}
    for column in columns:
        if column in row:
            chosen[column] = row[column]
        elif "." in column:
            _copy_path(row, chosen, column)
        if column.startswith(FIELD_PREFIX) and column not in chosen:
            _copy_path(row, chosen, column.removeprefix(FIELD_PREFIX))
    chosen.pop(TIME_KEY, None)
    chosen[TIME_KEY] = row[TIME_KEY]
    return chosen


def _copy_path(source: Mapping[str, Any], target: Row, path: str) -> None:
    if path in source:
        target[path] = source[path]
        return
    for name, value in source.items():
        if isinstance(value, dict) and path.startswith(name + "."):
            inner: Row = {}
            _copy_path(value, inner, path[len(name) + 1 :])
            if inner:
                have = target.get(name)
                target[name] = _deep_update(have, inner) if isinstance(have, dict) else inner


def _deep_update(have: Row, more: Row) -> Row:
    merged = dict(have)
    for key, value in more.items():
        old = merged.get(key)
        merged[key] = _deep_update(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
    return merged
