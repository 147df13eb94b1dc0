"""Converts any row into plain values: None, numbers, text, bytes, lists, dicts, and arrays."""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from typing import Any

from ..errors import FieldError, IntegerRangeError
from . import foreign_values

TIME_KEY = "_ts"
"""The row's time stamp in its payload, in seconds; always the last key."""

EXACT_KEY = "_exact"
"""The side key of JSON rows that says which nulls were NaN or infinite and which strings were bytes or arrays."""

SMALLEST_INT, LARGEST_INT = -(2**63), 2**64 - 1

MOST_LEVELS = 253
"""So many lists or dicts may lie in each other in a field. The row is one more, and orjson's limit is 254."""

_FRACTIONS = {float}


class PlainRow:
    """Turns the values of one row into plain ones; an encoding overrides how values become that it cannot hold."""

    def __init__(self, topic: str, packs: bool = True) -> None:
        """Begin a row.

        Args:
            topic: For the error messages.
            packs: Whether large arrays stay arrays; otherwise they are lists.
        """
        self._packs = packs
        self._topic = topic
        self._field: Any = None

    # -- what an encoding says -----------------------------------------------------------------------------------------

    def nonfinite(self, value: float, parent: str, key: str | int) -> Any:
        """Return the replacement of NaN or an infinity.

        Args:
            value: The number.
            parent: Where its container lies in the row, as an RFC 6901 pointer.
            key: Its key or index there.
        """
        return value

    def bytes_(self, value: bytes, parent: str, key: str | int) -> Any:
        """Return the replacement of bytes; the arguments are those of `nonfinite`."""
        return value

    def array(self, value: Any, parent: str, key: str | int) -> Any:
        """Return the replacement of a large numpy array; the arguments are those of `nonfinite`."""
        return value

    def side_key(self) -> Any:
        """Return the value of the row's side key `EXACT_KEY`; if it is empty, the row has no side key."""
        return None

    # -- the row -------------------------------------------------------------------------------------------------------

    def row(self, fields: Mapping[Any, Any]) -> dict[str, Any]:
        """Return the row's plain values by field, the side key if there is one, and the time stamp, last."""
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
        notes = self.side_key()
        if notes:
            row[EXACT_KEY] = notes
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

    def _convert(self, value: Any, parent: str, key: str | int, depth: int) -> Any:
        """Return the plain value of one field or element."""
        if value.__class__ is float:
            # No call for the usual case: of NaN and of infinities the difference is NaN.
            return value if value - value == 0.0 else self._fraction(value, parent, key)
        if value is None or value.__class__ is str:
            return value
        if isinstance(value, enum.Enum):
            return self._convert(value.value, parent, key, depth + 1)
        if isinstance(value, bool):
            return value
        if isinstance(value, str):
            return str.__str__(value)  # not str(value): a subclass may spell itself in another way
        if isinstance(value, int):
            return self._integer(value)
        if isinstance(value, float):
            return self._fraction(float(value), parent, key)
        if isinstance(value, (bytes, bytearray)) or (isinstance(value, memoryview) and foreign_values.is_bytes(value)):
            return self.bytes_(bytes(value), parent, key)
        if depth >= MOST_LEVELS:  # objects that are converted count too: some are converted to themselves without end
            self._refuse_depth(value, depth)
        if isinstance(value, (Mapping, list, tuple)):
            return self._container(value, f"{parent}/{_escape(key)}", depth + 1)
        return self._foreign(value, parent, key, depth)

    def _integer(self, value: int) -> int:
        if not SMALLEST_INT <= value <= LARGEST_INT:
            raise IntegerRangeError(
                f"{self._where()} has the integer {_shorten(value)}, which 64 bits cannot hold; log it as a float or"
                " as text"
            )
        return int(value)

    def _fraction(self, value: float, parent: str, key: str | int) -> Any:
        return value if math.isfinite(value) else self.nonfinite(value, parent, key)

    def _container(self, value: Any, pointer: str, depth: int) -> Any:
        if not isinstance(value, Mapping):
            # Both looks run in C, so that a list of floats is not gone through in Python.
            if set(map(type, value)) == _FRACTIONS and all(map(math.isfinite, value)):
                return value
            # Loops, because before Python 3.12 a comprehension takes one more frame of the stack for each level.
            values = []
            for index, inner in enumerate(value):
                values.append(self._convert(inner, pointer, index, depth))
            return values
        fields = {}
        for name, inner in zip(self._keys(value), value.values(), strict=True):
            fields[name] = self._convert(inner, pointer, name, depth)
        return fields

    def _refuse_depth(self, value: Any, depth: int) -> None:
        """Raise FieldError if a value is a container below too many others, or was converted too often."""
        if depth > MOST_LEVELS or isinstance(value, (Mapping, list, tuple)):
            raise FieldError(f"{self._where()} is nested deeper than {MOST_LEVELS} levels")

    def _foreign(self, value: Any, parent: str, key: str | int, depth: int) -> Any:
        try:
            array = foreign_values.large_array_of(value) if self._packs else None
            simpler = foreign_values.simple(value) if array is None else None
        except Exception as error:  # methods of foreign objects may raise anything
            kind = f"{type(value).__module__}.{type(value).__qualname__}"
            raise FieldError(
                f"{self._where()} holds a {kind}, which cannot be stored; {foreign_values.advice(value)}"
            ) from error
        return self._convert(simpler, parent, key, depth + 1) if array is None else self.array(array, parent, key)


def _shorten(value: int) -> str:
    text = hex(value)
    return str(value) if len(text) < 40 else f"{text[:16]}... ({value.bit_length()} bits)"


def _escape(key: str | int) -> str:
    return key.replace("~", "~0").replace("/", "~1") if isinstance(key, str) else str(key)


def has_lone_surrogates(text: str) -> bool:
    """Whether UTF-8 has no bytes for a text."""
    if text.isascii():
        return False
    try:
        text.encode()
    except UnicodeEncodeError:
        return True
    return False


def encodable(text: str) -> str:
    r"""Return a text for formats that are UTF-8, lone surrogates as `\ud800`."""
    return text.encode("utf-8", "backslashreplace").decode()
