"""CBOR (RFC 8949): rows as maps, in which numbers have their full width, and bytes and arrays are what they are.

A large array of numpy is a typed array (RFC 8746: tags 40 and 64 to 86); an array of booleans or with a mask, for which
there is no such tag, is an object (tag 27) named `ml_dash.array`.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from typing import Any

import cbor2
import numpy as np

from ..rows import foreign_values, packed_arrays
from ..rows.plain_row import LARGEST_INT, MOST_LEVELS, SMALLEST_INT
from .encoded_channel import Row
from .row_codec import RowCodec

_TIME_MARK = b"\x63_ts\xfb"
_TIME_BYTES = len(_TIME_MARK) + 8

_ATOMS = {float, str, bool, bytes, type(None)}
_FRACTIONS = {float}
_MOST_DEPTH = MOST_LEVELS + 4
"""The row, lists and dicts in it, and an array in the innermost: two tags and a list."""

_ROW_MAJOR, _OBJECT, _ARRAY_NAME = 40, 27, "ml_dash.array"
_TYPED = {64: "|u1", 72: "|i1", 80: ">f2", 84: "<f2"} | {
    64 + {"u": 0, "i": 8, "f": 15}[kind] + 4 * (order == "<") + width: f"{order}{kind}{2**width}"
    for kind, widths in (("u", (1, 2, 3)), ("i", (1, 2, 3)), ("f", (2, 3)))
    for width in widths
    for order in "><"
}
"""Tags of RFC 8746, and what numpy calls their types."""
_TAG_OF = {dtype: tag for tag, dtype in _TYPED.items()}

_VALUE_TAGS = (0, 1, 4, 5, 28, 30, 35, 36, 37, 52, 54, 100, 256, 258, 260, 261, 1004, 43000, 55799)
"""Tags for which the package has classes that a row has no place for: the value behind the tag stays."""
_REFERENCE_TAGS = (25, 29)
"""Tags that stand for a part of the message elsewhere, with which a short message can be an endless value."""


def _dumps(row: Mapping[str, Any]) -> bytes:
    return cbor2.dumps(row, default=_encode_array)


def _encode_array(encoder: cbor2.CBOREncoder, value: Any) -> None:
    """Encode an array of numpy that is no list."""
    tag = None if np.ma.is_masked(value) else _TAG_OF.get(value.dtype.str)
    content = bytes(packed_arrays.content(value))
    if tag is None:
        encoder.encode(cbor2.CBORTag(_OBJECT, [_ARRAY_NAME, packed_arrays.spelling(value), content]))
    else:
        typed = cbor2.CBORTag(tag, content)
        encoder.encode(typed if value.ndim == 1 else cbor2.CBORTag(_ROW_MAJOR, [list(value.shape), typed]))


def decode(payload: bytes) -> Row:
    """Decode a payload; whatever is no map becomes the field `value`, and an empty payload a row without fields.

    Raises:
        ValueError: It is no CBOR, or something follows it.
    """
    if not payload:
        return {}
    stream = io.BytesIO(payload)
    try:
        if payload[-_TIME_BYTES:-8] == _TIME_MARK:  # the end of a row of ours; to ask where a message ends costs time
            value = cbor2.loads(payload, **_DECODING)
        else:
            value = cbor2.CBORDecoder(stream, **_DECODING).decode()
            if stream.tell() != len(payload):
                raise ValueError(f"{len(payload) - stream.tell()} bytes follow its end")
    except (cbor2.CBORError, EOFError, OverflowError) as error:
        raise ValueError(f"{error}") from error
    if type(value) is not dict:
        return {"value": _plain(value)}
    if {*map(type, value)} != {str}:
        return {_key(key): _plain(inner) for key, inner in value.items()}
    for key, inner in value.items():
        if inner.__class__ not in _ATOMS:
            value[key] = _plain(inner)
    return value


def _plain(value: Any) -> Any:
    """Return a value as rows have it."""
    kind = type(value)
    if kind in _ATOMS:
        return value
    if isinstance(value, np.ndarray):
        return value if packed_arrays.is_large(value) else value.tolist()
    if kind is int:
        return value if SMALLEST_INT <= value <= LARGEST_INT else _as_double(value)
    if kind in (list, tuple):
        return value if kind is list and set(map(type, value)) <= _ATOMS else [_plain(inner) for inner in value]
    if isinstance(value, Mapping):
        return {_key(key): _plain(inner) for key, inner in value.items()}
    return _plain(value.value) if isinstance(value, (cbor2.CBORSimpleValue, cbor2.CBORTag)) else None


def _as_double(value: int) -> float:
    """Return an integer that needs more than 64 bits as JSON's readers do."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def _key(key: Any) -> str:
    try:
        return foreign_values.key_text(key)
    except TypeError:
        return key.decode(errors="backslashreplace") if isinstance(key, bytes) else str(key)


def _array(tag: cbor2.CBORTag, immutable: bool) -> Any:
    """Return the array or the value behind a tag."""
    value, array = tag.value, None
    if tag.tag in _TYPED and type(value) is bytes:
        dtype = np.dtype(_TYPED[tag.tag])
        if len(value) % dtype.itemsize == 0:
            array = np.frombuffer(bytearray(value), dtype)
    elif tag.tag == _OBJECT and isinstance(value, (list, tuple)) and len(value) == 3 and value[0] == _ARRAY_NAME:
        if isinstance(value[1], str) and isinstance(value[2], bytes):
            array = packed_arrays.of_content(bytearray(value[2]), value[1])
    elif tag.tag == _ROW_MAJOR and isinstance(value, (list, tuple)) and len(value) == 2:
        array = _shaped(*value)
    return value if array is None else array


def _shaped(lengths: Any, flat: Any) -> Any:
    try:
        return np.asarray(flat).reshape(lengths) if isinstance(flat, np.ndarray) else None
    except (TypeError, ValueError):
        return None


def _refuse(value: Any, immutable: bool) -> Any:
    raise ValueError("it refers to parts of itself, which is not decoded")


_DECODING: dict[str, Any] = {
    "tag_hook": _array,
    "max_depth": _MOST_DEPTH,
    "semantic_decoders": {tag: lambda value, immutable: value for tag in _VALUE_TAGS}
    | dict.fromkeys(_REFERENCE_TAGS, _refuse),
}


class CborCodec(RowCodec):
    """Rows as maps of CBOR."""

    message_encoding = "cbor"
    encode_row = staticmethod(_dumps)
    decode = staticmethod(decode)

    def dumps(self, fields: dict[str, Any], default: Any) -> bytes:
        """Encode a row; one with anything but plain values and lists of fractions is looked at value by value."""
        for value in fields.values():
            kind = value.__class__
            if kind in _ATOMS or (kind is int and SMALLEST_INT <= value <= LARGEST_INT):
                continue
            if kind is not list or not set(map(type, value)) <= _FRACTIONS:
                return super().dumps(fields, default)
        return cbor2.dumps(fields)

    def cut(self, payloads: Sequence[bytes]) -> list[int]:
        """Return where each row's time stamp begins, with its key."""
        if not all(payload[-_TIME_BYTES:-8] == _TIME_MARK for payload in payloads):
            raise ValueError("a row does not end with its time stamp")
        return [len(payload) - _TIME_BYTES for payload in payloads]


CODEC = CborCodec()
