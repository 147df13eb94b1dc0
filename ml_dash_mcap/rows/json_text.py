"""Encodes rows as JSON and decodes them, without losing a bit.

JSON has no NaN, no infinities, no bytes and no arrays. They are written as `null` and as base64 text, and a side key
of the row tells their places and what they were:

    {"q": [1.0, null], "img": "AAE=", "_exact": {"NaN": {"/q": [1]}, "bytes": {"": ["img"]}}, "_ts": 1.5}

The side key maps a spelling to the containers that hold such values, each an RFC 6901 pointer with the keys or
indices inside it. Small arrays are lists; large ones are spelled as `packed_arrays` says.
"""

from __future__ import annotations

import base64
import binascii
import enum
import json
import math
from collections.abc import Callable, Mapping
from typing import Any

import orjson

from ..errors import FieldError
from . import foreign_values, packed_arrays
from .plain_row import EXACT_KEY, PlainRow

_BULK = 64
"""Arrays of more elements than this are formatted by orjson directly instead of through a list."""

_NUMBERS = "fiub"
_BITS = (8, 16, 32, 64)

_NONFINITE = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}

dumps = orjson.dumps


def plain(value: Any) -> Any:
    """Turn a value that orjson does not know into one that it does, arrays of any size into lists.

    For orjson's `default` hook, as is `row_value`.

    Raises:
        TypeError: There is no JSON for it.
    """
    return _plain(value, packs=False)


def row_value(value: Any) -> Any:
    """Convert a value as `plain` does, but pack large arrays. For values of rows.

    Raises:
        TypeError: There is no JSON for it, or only with the side key (`exact` then says which field it was).
    """
    type_: Any = value.__class__
    if type_ in _ARRAYS:
        size, dtype = value.size, value.dtype
        if dtype.kind in _NUMBERS:
            if 0 < size <= _BULK:  # nearly all arrays in a control loop
                return value.tolist()
            if size and not packed_arrays.is_large(value) and dtype.itemsize <= 8:
                return _bulk(value)
    return _plain(value, packs=True)


_ARRAYS: set[type] = set()
"""The types of numpy that `row_value` lists itself; empty until the first array comes, for nothing here loads numpy."""


def _plain(value: Any, *, packs: bool) -> Any:
    if isinstance(value, (bytes, enum.Enum)):
        raise TypeError("only the side key says that it was bytes")
    size = getattr(value, "size", None)
    if not isinstance(size, int) or size > _BULK or not size:
        array = foreign_values.array_of(value)
        if array is not None:
            if packs and packed_arrays.is_large(array):
                raise TypeError("only the side key says which array it was")
            if array.dtype.kind in _NUMBERS and array.dtype.itemsize <= 8 and array.size > _BULK:
                return foreign_values.listed(array) if hasattr(array, "mask") else _bulk(array)
            return foreign_values.checked(value, foreign_values.listed(array))
    if not _ARRAYS and hasattr(value, "tolist"):
        _learn_types()
    return foreign_values.simple(value)


def _learn_types() -> None:
    import numpy as np

    numbers = ("float64", "float32", "float16", "bool_", *(f"{sign}int{bits}" for sign in ("", "u") for bits in _BITS))
    _ARRAYS.update([np.ndarray, *(getattr(np, name) for name in numbers)])


def _bulk(array: Any) -> Any:
    """Return an array of numbers as orjson formats it, which is what it makes of a list of them."""
    import numpy as np

    # As doubles: orjson would spell a float32 with fewer digits than the same number has in a list.
    native = "f8" if array.dtype.kind == "f" else array.dtype.newbyteorder("=")
    return orjson.Fragment(orjson.dumps(np.ascontiguousarray(array, native), option=orjson.OPT_SERIALIZE_NUMPY))


def plain_list(value: Any) -> Any:
    """Like `plain`, but never through an encoded fragment, so that every element can be looked at."""
    return foreign_values.simple(value)


def exact(fields: Mapping[str, Any], topic: str, *, packs: bool = True) -> bytes:
    """Encode a row that the fast path could not: one with bytes, non-finite numbers, odd keys, or a mistake in it.

    Args:
        fields: The row's fields, its time stamp under `_ts` last.
        topic: For the error messages.
        packs: Whether large arrays are packed; otherwise they are lists.

    Raises:
        FieldError: A value has no JSON, or two fields would be one; the message names the topic and the field.
        IntegerRangeError: An integer needs more than 64 bits.
    """
    row = _JsonRow(topic, packs).row(fields)
    try:
        return orjson.dumps(row)
    except (TypeError, ValueError) as error:  # only text with lone surrogates can still be refused
        raise FieldError(f"append() on topic {topic!r}: {_name_culprit(row)}{error}") from error


def exact_as_read(fields: Mapping[str, Any]) -> bytes:
    """Encode a row that was read. It may hold text with lone surrogates, which `exact` refuses."""
    return dumps_any(_JsonRow("", packs=True, is_plain=True).row(fields))


def dumps_any(value: Any) -> bytes:
    r"""Encode what JSON can say, lone surrogates in text, which others' JSON may hold, as `\ud800`."""
    try:
        return orjson.dumps(value)
    except TypeError:
        return json.dumps(value, separators=(",", ":")).encode()


def loads_any(text: str | bytes) -> Any:
    """Decode JSON, with lone surrogates or without."""
    try:
        return orjson.loads(text)
    except orjson.JSONDecodeError:
        return json.loads(text)


class _JsonRow(PlainRow):
    """Makes a row of JSON values, with notes of the values that JSON does not have."""

    def __init__(self, topic: str, packs: bool, *, is_plain: bool = False) -> None:
        """Begin a row.

        Args:
            topic: For the error messages.
            packs: Whether large arrays are packed; otherwise they are lists.
            is_plain: Whether the row holds only values that any encoder knows, not only orjson.
        """
        super().__init__(topic, packs)
        self._notes: dict[str, dict[str, list[str | int]]] = {}
        self._is_plain = is_plain

    def nonfinite(self, value: float, parent: str, key: str | int) -> None:
        """Note the number; it becomes a null."""
        self._note("NaN" if value != value else "Infinity" if value > 0 else "-Infinity", parent, key)

    def bytes_(self, value: bytes, parent: str, key: str | int) -> Any:
        """Note that it is bytes; it becomes base64."""
        self._note("bytes", parent, key)
        return self._base64(binascii.b2a_base64(value, newline=False))

    def array(self, value: Any, parent: str, key: str | int) -> Any:
        """Note the type and shape; the elements become base64."""
        text, spelling = packed_arrays.pack(value)
        self._note(spelling, parent, key)
        return self._base64(text)

    def side_key(self) -> dict[str, dict[str, list[str | int]]]:
        """Return the notes."""
        return self._notes

    def _note(self, spelling: str, parent: str, key: str | int) -> None:
        self._notes.setdefault(spelling, {}).setdefault(parent, []).append(key)

    def _base64(self, text: bytes) -> Any:
        """Return base64 as JSON; orjson copies it as it is."""
        return text.decode() if self._is_plain else orjson.Fragment(b'"%b"' % text)


def restore(row: dict[str, Any]) -> dict[str, Any]:
    """Fold a row's side key back into its values, in place.

    Notes that do not fit the row (a foreign file may hold anything) are ignored.
    """
    return _restore(row, _value_of)


def restore_kinds(row: dict[str, Any]) -> dict[str, Any]:
    """Restore a row of which only the kinds of values matter: bytes become empty, arrays become their spelling."""
    return _restore(row, lambda spelling, _: b"" if spelling == "bytes" else packed_arrays.spelling_of(spelling))


def _restore(row: dict[str, Any], value_of: Callable[[str, str], Any]) -> dict[str, Any]:
    notes = row.pop(EXACT_KEY, None)
    if not isinstance(notes, dict):
        return row
    for spelling, containers in notes.items():
        if not isinstance(containers, dict):
            continue
        for pointer, keys in containers.items():
            container = _resolve(row, pointer)
            for key in keys if isinstance(keys, list) else ():
                _put_back(container, key, spelling, value_of)
    return row


def _name_culprit(row: dict[str, Any]) -> str:
    for name, value in row.items():
        try:
            orjson.dumps({name: value})
        except (TypeError, ValueError):
            return f"field {name!r} cannot be stored: "
    return ""


def _resolve(row: Any, pointer: str) -> Any:
    container = row
    for token in pointer.split("/")[1:]:
        if isinstance(container, list):
            is_index = token.isascii() and token.isdecimal() and int(token) < len(container)
            container = container[int(token)] if is_index else None
        elif isinstance(container, dict):
            container = container.get(token.replace("~1", "/").replace("~0", "~"))
    return container


def _put_back(container: Any, key: Any, spelling: str, value_of: Callable[[str, str], Any]) -> None:
    if isinstance(container, list):
        present = isinstance(key, int) and 0 <= key < len(container)
    else:
        present = isinstance(container, dict) and isinstance(key, str) and key in container
    if not present:
        return
    if spelling in _NONFINITE and container[key] is None:
        container[key] = _NONFINITE[spelling]
    elif isinstance(container[key], str):
        value = value_of(spelling, container[key])
        if value is not None:
            container[key] = value


def _value_of(spelling: str, text: str) -> Any:
    """Return the bytes or the array that a base64 text stands for; None if it stands for neither."""
    if spelling != "bytes":
        return packed_arrays.unpack(text, spelling)
    try:
        return base64.b64decode(text, validate=True)
    except ValueError:
        return None
