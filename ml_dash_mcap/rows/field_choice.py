"""The fields that a caller asks for, and rows with only these fields."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from ..errors import UsageError
from .dotted import FIELD_PREFIX, Row
from .plain_row import TIME_KEY


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
                present = target.get(name)
                target[name] = _deep_update(present, inner) if isinstance(present, dict) else inner


def _deep_update(present: Row, update: Row) -> Row:
    merged = dict(present)
    for key, value in update.items():
        before = merged.get(key)
        merged[key] = _deep_update(before, value) if isinstance(before, dict) and isinstance(value, dict) else value
    return merged
