"""A row to JSON bytes and back, without losing a bit.

JSON has no NaN, no infinities and no bytes. They are written as `null` and as base64 text, and a side key of the
row says where and what they were:

    {"q": [1.0, null], "img": "AAE=", "_exact": {"NaN": {"/q": [1]}, "bytes": {"": ["img"]}}, "_ts": 1.5}

The side key maps a spelling to the containers that hold such values, each an RFC 6901 pointer with the keys or
indices inside it.
"""

from __future__ import annotations

import base64
import contextlib
import datetime
import enum
import json
import math
import os
import uuid
from collections.abc import Mapping
from dataclasses import fields as dataclass_fields
from dataclasses import is_dataclass
from typing import Any

import orjson

from ..errors import FieldError, IntegerRangeError
from . import frame_columns

TIME_KEY = "_ts"
"""The row's time stamp in its payload, in seconds; always the last key."""

EXACT_KEY = "_exact"
"""The side key that says which nulls were NaN or infinite and which strings were bytes."""

_SMALLEST_INT, _LARGEST_INT = -(2**63), 2**64 - 1
_BULK = 64
"""Arrays of more elements than this are formatted by orjson directly instead of through a list."""

_MAX_DEPTH = 200
"""Containers nested deeper than this are refused (orjson's own limit is 254)."""

_NONFINITE = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}

dumps = orjson.dumps


def plain(value: Any) -> Any:
    """Turn a value that orjson does not know into one that it does; orjson's `default` hook.

    Raises:
        TypeError: There is no JSON for it (`exact` then says which field it was).
    """
    tolist = getattr(value, "tolist", None)
    if tolist is not None and not isinstance(value, memoryview):
        if _is_big_float_array(value):
            return orjson.Fragment(orjson.dumps(_as_float64(value), option=orjson.OPT_SERIALIZE_NUMPY))
        return _listed(value)
    if isinstance(value, float):
        return float(value)
    if isinstance(value, tuple):
        return list(value)
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, Mapping):
        return dict(value)
    if frame_columns.library_of(value) == "polars":
        return _listed(value)
    if hasattr(value, "__array__"):
        import numpy as np

        return _checked_list(value, np.asarray(value).tolist())
    if frame_columns.is_missing(value):
        return None
    raise TypeError(f"Type is not JSON serializable: {type(value).__name__}")


def _listed(value: Any) -> Any:
    """Return an array, or whatever else has `tolist`, as Python's own values."""
    if getattr(getattr(value, "dtype", None), "kind", "O") in "fiub":
        return _checked_list(value, value.tolist())
    if frame_columns.library_of(value) is not None:
        plain_value = frame_columns.plain(value)
        return plain_value if isinstance(plain_value, list) else _checked_list(value, plain_value.tolist())
    if getattr(getattr(value, "dtype", None), "kind", None) in ("M", "m"):
        return _with_none(value.astype(str).tolist())
    return _checked_list(value, value.tolist())


def _with_none(texts: Any) -> Any:
    """Return numpy's times and spans as text, with None for what is none."""
    if isinstance(texts, list):
        return list(map(_with_none, texts))
    return None if texts == "NaT" else texts


def _is_big_float_array(value: Any) -> bool:
    dtype, size = getattr(value, "dtype", None), getattr(value, "size", None)
    if not isinstance(size, int) or size <= _BULK or dtype is None:
        return False
    return getattr(dtype, "kind", None) == "f" and dtype.itemsize <= 8


def _as_float64(value: Any) -> Any:
    import numpy as np

    return np.ascontiguousarray(value, dtype=np.float64)


def _checked_list(value: Any, listed: Any) -> Any:
    if type(listed) is type(value):
        raise TypeError(f"Type is not JSON serializable: {type(value).__name__}")
    return listed


def exact(fields: Mapping[str, Any], topic: str) -> bytes:
    """Encode a row that the fast path could not: one with bytes, non-finite numbers, odd keys, or a mistake in it.

    Args:
        fields: The row's fields, its time stamp under `_ts` last.
        topic: For the error messages.

    Raises:
        FieldError: A value has no JSON; the message names the topic and the field.
        IntegerRangeError: An integer needs more than 64 bits.
    """
    row = _with_notes(fields, topic)
    try:
        return orjson.dumps(row)
    except (TypeError, ValueError) as error:  # what is left: text with lone surrogates
        raise FieldError(f"append() on topic {topic!r}: {_name_culprit(row)}{error}") from error


def exact_as_read(fields: Mapping[str, Any]) -> bytes:
    """Encode a row that was read, which may hold what `exact` refuses: text with lone surrogates."""
    return dumps_any(_with_notes(fields, ""))


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


def _with_notes(fields: Mapping[str, Any], topic: str) -> dict[str, Any]:
    """Return a row with the side key before its time stamp, if it takes one."""
    notes: dict[str, dict[str, list[str | int]]] = {}
    row: dict[str, Any] = {}
    time = None
    for name, value in fields.items():
        if name == TIME_KEY:
            time = value
            continue
        row[name] = _convert(value, "", name, notes, (topic, name), 0)
    if notes:
        row[EXACT_KEY] = notes
    row[TIME_KEY] = time
    return row


def restore(row: dict[str, Any]) -> dict[str, Any]:
    """Fold a row's side key back into its values, in place.

    Notes that do not fit the row (a foreign file may hold anything) are ignored.
    """
    notes = row.pop(EXACT_KEY, None)
    if not isinstance(notes, dict):
        return row
    for spelling, containers in notes.items():
        if not isinstance(containers, dict):
            continue
        for pointer, keys in containers.items():
            container = _resolve(row, pointer)
            for key in keys if isinstance(keys, list) else ():
                _put_back(container, key, spelling)
    return row


def _convert(value: Any, parent: str, key: str | int, notes: Any, where: tuple[str, str], depth: int) -> Any:
    """Return the JSON value of one field or element, noting what JSON cannot say."""
    if value is None or isinstance(value, (bool, str)):
        return value.value if isinstance(value, enum.Enum) else value
    if isinstance(value, enum.Enum):
        return _convert(value.value, parent, key, notes, where, depth)
    if isinstance(value, int):
        if not _SMALLEST_INT <= value <= _LARGEST_INT:
            raise IntegerRangeError(
                f"append() on topic {where[0]!r}: field {where[1]!r} has the integer {_shorten(value)}, which 64 bits"
                " cannot hold; log it as a float or as text"
            )
        return int(value)
    if isinstance(value, float):
        if math.isfinite(value):
            return float(value)
        spelling = "NaN" if value != value else "Infinity" if value > 0 else "-Infinity"
        notes.setdefault(spelling, {}).setdefault(parent, []).append(key)
        return None
    if isinstance(value, (bytes, bytearray, memoryview)):
        notes.setdefault("bytes", {}).setdefault(parent, []).append(key)
        return base64.b64encode(value).decode("ascii")
    if depth > _MAX_DEPTH:
        raise FieldError(
            f"append() on topic {where[0]!r}: field {where[1]!r} is nested deeper than {_MAX_DEPTH} levels"
        )
    if isinstance(value, (Mapping, list, tuple)):
        return _convert_container(value, f"{parent}/{_escape(key)}", notes, where, depth + 1)
    return _convert(_simpler(value, where), parent, key, notes, where, depth + 1)


def _convert_container(value: Any, pointer: str, notes: Any, where: tuple[str, str], depth: int) -> Any:
    if isinstance(value, Mapping):
        named = [(_key_text(key, where), inner) for key, inner in value.items()]
        return {name: _convert(inner, pointer, name, notes, where, depth) for name, inner in named}
    return [_convert(inner, pointer, index, notes, where, depth) for index, inner in enumerate(value)]


def _simpler(value: Any, where: tuple[str, str]) -> Any:
    """Return what an object stands for, as values that `_convert` knows."""
    if frame_columns.library_of(value) == "pandas" and not hasattr(value, "tolist"):
        return _of_pandas(value)
    if is_dataclass(value) and not isinstance(value, type):
        names = [field.name for field in dataclass_fields(value) if not field.name.startswith("_")]
        return {name: getattr(value, name) for name in names}
    if isinstance(value, (datetime.datetime, datetime.date, datetime.time)):
        return value.isoformat()
    if isinstance(value, uuid.UUID):
        return str(value)
    try:
        return plain_list(value)
    except Exception as error:  # what a foreign object's own methods raise
        raise FieldError(
            f"append() on topic {where[0]!r}: field {where[1]!r} holds a {type(value).__module__}."
            f"{type(value).__qualname__}, which cannot be stored; pass numbers, text, bytes, lists, dicts or arrays"
        ) from error


def _of_pandas(value: Any) -> Any:
    """Return what a single value of pandas stands for: times and spans are text as ISO 8601 has them."""
    if frame_columns.is_missing(value):
        return None
    if hasattr(value, "columns"):
        return frame_columns.plain(value)
    return value.isoformat() if hasattr(value, "isoformat") else str(value)


def plain_list(value: Any) -> Any:
    """Like `plain`, but never through an encoded fragment, so that every element can be looked at."""
    return _listed(value) if hasattr(value, "tolist") else plain(value)


def _key_text(key: Any, where: tuple[str, str]) -> str:
    """Spell a nested dict's key as `json.dumps` would."""
    if isinstance(key, str):
        return str(key)
    if key is None or isinstance(key, bool):
        return {None: "null", True: "true", False: "false"}[key]
    if isinstance(key, (int, float)):
        return repr(key)
    raise FieldError(
        f"append() on topic {where[0]!r}: field {where[1]!r} has a dict with the key {key!r}; keys must be text"
    )


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


def _put_back(container: Any, key: Any, spelling: str) -> None:
    if isinstance(container, list):
        present = isinstance(key, int) and 0 <= key < len(container)
    else:
        present = isinstance(container, dict) and isinstance(key, str) and key in container
    if not present:
        return
    if spelling in _NONFINITE and container[key] is None:
        container[key] = _NONFINITE[spelling]
    elif spelling == "bytes" and isinstance(container[key], str):
        with contextlib.suppress(ValueError):
            container[key] = base64.b64decode(container[key], validate=True)
