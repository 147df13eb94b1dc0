"""A row to JSON bytes and back, without losing a bit.

JSON has no NaN, no infinities, no bytes and no arrays. They are written as `null` and as base64 text, and a side key
of the row says where and what they were:

    {"q": [1.0, null], "img": "AAE=", "_exact": {"NaN": {"/q": [1]}, "bytes": {"": ["img"]}}, "_ts": 1.5}

The side key maps a spelling to the containers that hold such values, each an RFC 6901 pointer with the keys or
indices inside it. Small arrays are lists; large ones are spelled as `packed` says.
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

from ..errors import FieldError, IntegerRangeError
from . import foreign_values, packed

TIME_KEY = "_ts"
"""The row's time stamp in its payload, in seconds; always the last key."""

EXACT_KEY = "_exact"
"""The side key that says which nulls were NaN or infinite and which strings were bytes or arrays."""

_SMALLEST_INT, _LARGEST_INT = -(2**63), 2**64 - 1
_BULK = 64
"""Arrays of more elements than this are formatted by orjson directly instead of through a list."""

_MAX_DEPTH = 200
"""Containers nested deeper than this are refused (orjson's own limit is 254)."""

_NUMBERS = "fiub"
_BITS = (8, 16, 32, 64)
_FRACTIONS = {float}

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
    """Do the same for a value in a row, of which large arrays are packed.

    Raises:
        TypeError: There is no JSON for it, or only with the side key (`exact` then says which field it was).
    """
    type_: Any = value.__class__
    if type_ in _ARRAYS:
        size, dtype = value.size, value.dtype
        if dtype.kind in _NUMBERS:
            if 0 < size <= _BULK:  # nearly all arrays in a control loop
                return value.tolist()
            if size and not packed.is_large(value) and dtype.itemsize <= 8:
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
            if packs and packed.is_large(array):
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
    row = _Encoder(topic, packs).row(fields)
    try:
        return orjson.dumps(row)
    except (TypeError, ValueError) as error:  # what is left: text with lone surrogates
        raise FieldError(f"append() on topic {topic!r}: {_name_culprit(row)}{error}") from error


def exact_as_read(fields: Mapping[str, Any]) -> bytes:
    """Encode a row that was read, which may hold what `exact` refuses: text with lone surrogates."""
    return dumps_any(_Encoder("", packs=True, is_plain=True).row(fields))


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


def has_lone_surrogates(text: str) -> bool:
    """Whether UTF-8 has no bytes for a text."""
    return not text.isascii() and encodable(text) != text


def encodable(text: str) -> str:
    r"""Return a text for formats that are UTF-8, lone surrogates as `\ud800`."""
    return text.encode("utf-8", "backslashreplace").decode()


class _Encoder:
    """Turns the values of one row into those of JSON, and notes what JSON cannot say."""

    def __init__(self, topic: str, packs: bool, *, is_plain: bool = False) -> None:
        """Begin a row.

        Args:
            topic: For the error messages.
            packs: Whether large arrays are packed; otherwise they are lists.
            is_plain: Whether the row becomes what any encoder knows, and not only orjson.
        """
        self.notes: dict[str, dict[str, list[str | int]]] = {}
        """The side key."""
        self._packs = packs
        self._is_plain = is_plain
        self._topic = topic
        self._field: Any = None

    def row(self, fields: Mapping[Any, Any]) -> dict[str, Any]:
        """Return the row's JSON values by field, the side key if it takes one, and its time stamp."""
        row: dict[str, Any] = {}
        keys: dict[str, Any] = {}
        for key, value in fields.items():
            name = self._field = key
            if key.__class__ is not str:
                name = self._name(key, keys)
            elif key == TIME_KEY:
                continue
            row[name] = self._convert(value, "", name, 0)
        if len(row) < len(fields) - (TIME_KEY in fields):
            self._keys(fields)
        if self.notes:
            row[EXACT_KEY] = self.notes
        row[TIME_KEY] = fields.get(TIME_KEY)
        return row

    def _name(self, key: Any, keys: dict[str, Any]) -> str:
        """Return the name of a field whose key is of a type of its own."""
        if not isinstance(key, str):
            raise FieldError(f"{self._where()}: the name of a field is text, not a {type(key).__name__}")
        name = self._key(key, keys)
        if name in (TIME_KEY, EXACT_KEY):
            raise FieldError(
                f"append() on topic {self._topic!r}: the field name {key!r} stands for {name!r}, which is reserved;"
                " rename it"
            )
        return name

    def _keys(self, mapping: Mapping[Any, Any]) -> list[str]:
        """Return the text of each key."""
        if set(map(type, mapping)) <= {str}:
            return list(mapping)
        keys: dict[str, Any] = {}
        return [self._key(key, keys) for key in mapping]

    def _key(self, key: Any, keys: dict[str, Any]) -> str:
        """Return the text of a key of a dict; `keys` are those that the dict has so far, by their text."""
        try:
            text = foreign_values.key_text(key)
        except TypeError as error:
            raise FieldError(f"{self._where()} {error}") from error
        if text in keys:
            both = f"the keys {keys[text]!r} and {key!r}, which are both {text!r} in JSON"
            raise FieldError(f"{self._where()} has {both}; rename one")
        keys[text] = key
        return text

    def _where(self) -> str:
        return f"append() on topic {self._topic!r}: field {self._field!r}"

    def _note(self, spelling: str, parent: str, key: str | int) -> None:
        self.notes.setdefault(spelling, {}).setdefault(parent, []).append(key)

    def _convert(self, value: Any, parent: str, key: str | int, depth: int) -> Any:
        """Return the JSON value of one field or element."""
        if value.__class__ is float:
            return value if value - value == 0.0 else self._fraction(value, parent, key)
        if value is None or value.__class__ is str:
            return value
        if depth > _MAX_DEPTH:
            raise FieldError(f"{self._where()} is nested deeper than {_MAX_DEPTH} levels")
        if isinstance(value, enum.Enum):
            return self._convert(value.value, parent, key, depth + 1)
        if isinstance(value, (bool, str)):
            return value
        if isinstance(value, int):
            return self._integer(value)
        if isinstance(value, float):
            return self._fraction(float(value), parent, key)
        if isinstance(value, (bytes, bytearray)) or (isinstance(value, memoryview) and foreign_values.is_bytes(value)):
            self._note("bytes", parent, key)
            return self._base64(binascii.b2a_base64(bytes(value), newline=False))
        if isinstance(value, (Mapping, list, tuple)):
            return self._container(value, f"{parent}/{_escape(key)}", depth + 1)
        return self._foreign(value, parent, key, depth)

    def _integer(self, value: int) -> int:
        if not _SMALLEST_INT <= value <= _LARGEST_INT:
            raise IntegerRangeError(
                f"{self._where()} has the integer {_shorten(value)}, which 64 bits cannot hold; log it as a float or"
                " as text"
            )
        return int(value)

    def _fraction(self, value: float, parent: str, key: str | int) -> float | None:
        if math.isfinite(value):
            return value
        self._note("NaN" if value != value else "Infinity" if value > 0 else "-Infinity", parent, key)
        return None

    def _container(self, value: Any, pointer: str, depth: int) -> Any:
        if not isinstance(value, Mapping):
            if set(map(type, value)) == _FRACTIONS and all(map(math.isfinite, value)):
                return value
            return [self._convert(inner, pointer, index, depth) for index, inner in enumerate(value)]
        named = zip(self._keys(value), value.values(), strict=True)
        return {name: self._convert(inner, pointer, name, depth) for name, inner in named}

    def _base64(self, text: bytes) -> Any:
        """Return base64 as JSON; orjson copies it as it is."""
        return text.decode() if self._is_plain else orjson.Fragment(b'"%b"' % text)

    def _foreign(self, value: Any, parent: str, key: str | int, depth: int) -> Any:
        try:
            array = foreign_values.large_array_of(value) if self._packs else None
            simpler = foreign_values.simple(value) if array is None else None
        except Exception as error:  # what a foreign object's own methods raise
            kind = f"{type(value).__module__}.{type(value).__qualname__}"
            raise FieldError(
                f"{self._where()} holds a {kind}, which cannot be stored; {foreign_values.advice(value)}"
            ) from error
        if array is None:
            return self._convert(simpler, parent, key, depth + 1)
        text, spelling = packed.pack(array)
        self._note(spelling, parent, key)
        return self._base64(text)


def restore(row: dict[str, Any]) -> dict[str, Any]:
    """Fold a row's side key back into its values, in place.

    Notes that do not fit the row (a foreign file may hold anything) are ignored.
    """
    return _restore(row, _value_of)


def restore_kinds(row: dict[str, Any]) -> dict[str, Any]:
    """Do the same where only the kinds of the values matter: bytes become empty, and arrays their spelling."""
    return _restore(row, lambda spelling, _: b"" if spelling == "bytes" else packed.spelling_of(spelling))


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


def _shorten(value: int) -> str:
    text = hex(value)
    return str(value) if len(text) < 40 else f"{text[:16]}... ({value.bit_length()} bits)"


def _escape(key: str | int) -> str:
    return key.replace("~", "~0").replace("/", "~1") if isinstance(key, str) else str(key)


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
        return packed.unpack(text, spelling)
    try:
        return base64.b64decode(text, validate=True)
    except ValueError:
        return None
