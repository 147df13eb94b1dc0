"""Checks columns of any kind, and takes single rows out of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ..errors import FieldError
from ..rows.plain_row import EXACT_KEY, TIME_KEY

_ABSENT: Any = object()
"""Stands for a value that a row does not have."""

_LIKE_NUMBERS = {float, int, bool}


def checked(name: str, column: Any, count: int, topic: str, within: str = "") -> Any:
    """Check a column and return it: lists of plain numbers as arrays, dicts as dicts of checked columns.

    Args:
        name: The name of the field, dotted for columns in dicts.
        column: One value a row. Columns of other libraries were converted to arrays or lists before.
        count: Of the rows.
        topic: For the error messages.
        within: A phrase for the error messages that names the dict in which the column lies.

    Raises:
        FieldError: It is no column, or has another length.
    """
    if isinstance(column, Mapping):
        return _checked_dict(name, column, count, topic, within or f" of the dict {name!r}")
    what = f"append_columns() on topic {topic!r}: column {name!r}{within}"
    is_sequence = hasattr(column, "__len__") and hasattr(column, "__getitem__") and getattr(column, "ndim", 1) > 0
    if not is_sequence or isinstance(column, (str, bytes, bytearray)):
        raise FieldError(
            f"{what} is {_kind(column)}; it must be an array, a sequence with one value a row, or a dict of such"
        )
    if len(column) != count:
        raise FieldError(f"{what} has {len(column)} rows, but _ts has {count}")
    if isinstance(column, np.ndarray):
        return column
    # Exact types: a subclass of int, such as an enum, has its own way to be stored.
    kinds = set(map(type, column))
    if len(kinds) == 1 and kinds <= _LIKE_NUMBERS:
        array = np.array(column)
        # numpy makes floats of integers that fit no 64-bit type together, which would round them.
        return column if array.dtype.kind not in "fiub" or (kinds == {int} and array.dtype.kind == "f") else array
    return column


def _checked_dict(name: str, columns: Mapping[Any, Any], count: int, topic: str, within: str) -> dict[str, Any]:
    if not columns:
        raise FieldError(f"append_columns() on topic {topic!r}: column {name!r} is a dict without columns")
    for key in columns:
        if not isinstance(key, str) or key in (TIME_KEY, EXACT_KEY):
            raise FieldError(f"append_columns() on topic {topic!r}: {name!r} has the key {key!r}, which is no name")
        _check_unicode(key, topic)
    return {str.__str__(key): checked(f"{name}.{key}", column, count, topic, within) for key, column in columns.items()}


def _check_unicode(name: str, topic: str) -> None:
    try:
        name.encode()
    except UnicodeEncodeError as error:
        raise FieldError(f"append_columns() on topic {topic!r}: the name {name!r} is not valid Unicode") from error


def _kind(column: Any) -> str:
    if getattr(column, "ndim", None) == 0:
        return f"a single value, {column!r}"
    return f"of type {type(column).__name__}"


def leaves(columns: Mapping[str, Any]) -> Iterator[Any]:
    """Yield all columns, also those in dicts."""
    for column in columns.values():
        if isinstance(column, dict):
            yield from leaves(column)
        else:
            yield column


def fields(columns: Mapping[str, Any], row: int) -> dict[str, Any]:
    """Return the fields of one row of checked columns, without the fields whose whole value is masked."""
    values = {name: _value(column, row) for name, column in columns.items()}
    return {name: value for name, value in values.items() if value is not _ABSENT}


def _value(column: Any, row: int) -> Any:
    """Return the value of a row; `_ABSENT` if the whole value is masked, or if it is a dict that would be empty."""
    if isinstance(column, dict):
        return fields(column, row) or _ABSENT
    if isinstance(column, np.ma.MaskedArray) and _is_masked(np.ma.getmaskarray(column)[row]):
        return _ABSENT
    return column[row]


def _is_masked(mask: Any) -> bool:
    """Whether the mask of a row covers the whole value, and the value is not empty."""
    if mask.dtype.names:
        return all(_is_masked(mask[name]) for name in mask.dtype.names)
    return bool(mask.size) and bool(mask.all())
