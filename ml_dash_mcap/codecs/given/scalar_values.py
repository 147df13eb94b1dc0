"""Checks the numbers, texts and bytes that protobuf's fields are given, one at a time and as arrays."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from typing import Any

from google.protobuf.descriptor import EnumDescriptor, FieldDescriptor

from ...rows import foreign_values
from ...suggestions import did_you_mean
from .unfit_values import UnfitValueError, shown, takes

Convert = Callable[[Any], Any]

_LARGEST_FLOAT = (2 - 2**-24) * 2.0**127
"""From here on, doubles are rounded to infinity in 32 bits."""

_BITS = {
    FieldDescriptor.CPPTYPE_INT32: (-(2**31), 2**31 - 1),
    FieldDescriptor.CPPTYPE_INT64: (-(2**63), 2**63 - 1),
    FieldDescriptor.CPPTYPE_UINT32: (0, 2**32 - 1),
    FieldDescriptor.CPPTYPE_UINT64: (0, 2**64 - 1),
}

_FLOATS = {FieldDescriptor.CPPTYPE_DOUBLE, FieldDescriptor.CPPTYPE_FLOAT}


def type_name(field: FieldDescriptor) -> str:
    """Return the type of a field's values as a .proto file has it."""
    inner = field.message_type or field.enum_type
    return _NAMES[field.type] if inner is None else str(inner.full_name)


def converter(field: FieldDescriptor) -> Convert:
    """Return the function that checks one value of a field that is no message, and returns it as protobuf takes it.

    The function raises a `UnfitValueError`.
    """
    kind, name = field.cpp_type, type_name(field)
    if kind in _BITS:
        return _integer(name, *_BITS[kind])
    if kind in _FLOATS:
        return _fraction(name, _LARGEST_FLOAT if kind == FieldDescriptor.CPPTYPE_FLOAT else math.inf)
    if kind == FieldDescriptor.CPPTYPE_ENUM:
        return _enum(field.enum_type)
    if kind == FieldDescriptor.CPPTYPE_BOOL:
        return _bool
    return _bytes if field.type == FieldDescriptor.TYPE_BYTES else _text


def plain_type(field: FieldDescriptor) -> type | None:
    """Return the type of Python whose values protobuf itself checks for a field; None where it does not."""
    kind = field.cpp_type
    if kind in _BITS:
        return int
    if kind == FieldDescriptor.CPPTYPE_STRING:
        return bytes if field.type == FieldDescriptor.TYPE_BYTES else str
    return {FieldDescriptor.CPPTYPE_DOUBLE: float, FieldDescriptor.CPPTYPE_BOOL: bool}.get(kind)


def wire_dtype(field: FieldDescriptor) -> str | None:
    """Return the type of numpy whose bytes a packed field has; None where it has others."""
    return _WIRE_DTYPES.get(_NAMES.get(field.type, ""))


def array_check(field: FieldDescriptor) -> Callable[[Any], bool]:
    """Return the function that tells whether all of an array of numpy, [N], fits a repeated field.

    Where it returns False, the elements are to be checked one at a time.
    """
    kind = field.cpp_type
    if kind in _BITS:
        low, high = _BITS[kind]
        return lambda array: _are_integers(array, low, high)
    if kind in _FLOATS:
        return _are_floats if kind == FieldDescriptor.CPPTYPE_FLOAT else _are_doubles
    return lambda array: array.dtype.kind == "b" and kind == FieldDescriptor.CPPTYPE_BOOL


def plain(value: Any) -> Any:
    """Return what an enum, a number of numpy or an array of no dimensions stands for; other values as they are."""
    if isinstance(value, enum.Enum):
        return value.value
    if getattr(value, "ndim", None) == 0:
        array = foreign_values.array_of(value)
        simpler = value.item() if array is None else array.item()
        return value if type(simpler) is type(value) else simpler
    return value


def _fraction(name: str, end: float) -> Convert:
    def convert(value: Any) -> float:
        number: float = value if value.__class__ is float else _as_float(value, name)
        if number - number == 0.0 and not -end < number < end:
            raise takes(f"a {name}", value)
        return number

    return convert


def _as_float(value: Any, name: str) -> float:
    number = plain(value)
    if isinstance(number, float):
        return float(number)
    if not isinstance(number, int) or isinstance(number, bool):
        raise takes(f"a {name}", value)
    try:
        fraction = float(number)
    except OverflowError as error:
        raise takes(f"a {name}", value) from error
    if fraction != number and name == "double":  # a float rounds most of what it is given
        raise UnfitValueError(f"takes a double, which does not hold {shown(value)} exactly; pass float(...) of it")
    return fraction


def _integer(name: str, low: int, high: int) -> Convert:
    def convert(value: Any) -> int:
        number = value if value.__class__ is int else plain(value)
        if not isinstance(number, int) or isinstance(number, bool) or not low <= number <= high:
            article = "an" if name[0] == "i" else "a"
            raise takes(f"{article} {name}, an integer from {low} to {high}", value)
        return int(number)

    return convert


def _bool(value: Any) -> bool:
    truth = plain(value)
    if not isinstance(truth, bool):
        raise takes("a bool", value)
    return truth


def _text(value: Any) -> str:
    text = plain(value)
    if not isinstance(text, str):
        raise takes("a string", value)
    text = str.__str__(text)
    if not text.isascii():
        try:
            text.encode()
        except UnicodeEncodeError as error:
            raise UnfitValueError(f"takes a string; {shown(value)} is not valid Unicode: {error}") from error
    return text


def _bytes(value: Any) -> bytes:
    """Return bytes; of an array, those of its elements, in the order of C."""
    if isinstance(value, (bytes, bytearray)):
        return bytes(value)
    array = memoryview(value) if isinstance(value, memoryview) else foreign_values.array_of(value)
    if array is None or getattr(getattr(array, "dtype", None), "hasobject", False):
        raise takes("bytes, or an array whose bytes they are", value)
    if is_masked(array):
        raise UnfitValueError("takes bytes; the array has masked elements: pass array.filled(...)")
    return array.tobytes()


def is_masked(array: Any) -> bool:
    """Whether an array has masked elements."""
    mask = getattr(array, "mask", None)
    return mask is not None and bool(mask.any())


def _enum(descriptor: EnumDescriptor) -> Convert:
    numbers = {value.name: value.number for value in descriptor.values}
    valid, is_closed = set(numbers.values()), getattr(descriptor, "is_closed", False)
    what = f"a name or number of {descriptor.full_name}"

    def convert(value: Any) -> int:
        chosen = plain(value)
        if isinstance(chosen, str):
            if chosen not in numbers:
                question = did_you_mean(chosen, numbers) or f"there are {', '.join(numbers)}"
                raise UnfitValueError(f"takes {what}; {chosen!r} is none: {question}")
            number: int = numbers[chosen]
            return number
        if not isinstance(chosen, int) or isinstance(chosen, bool) or not -(2**31) <= chosen < 2**31:
            raise takes(what, value)
        if is_closed and chosen not in valid:
            raise UnfitValueError(f"takes {what}; it has no number {chosen}: there are {', '.join(numbers)}")
        return int(chosen)

    return convert


def _are_integers(array: Any, low: int, high: int) -> bool:
    if array.dtype.kind not in "iu":
        return False
    return not len(array) or (int(array.min()) >= low and int(array.max()) <= high)


def _are_doubles(array: Any) -> bool:
    kind, size = array.dtype.kind, array.dtype.itemsize
    return (kind == "f" and size <= 8) or (kind in "iu" and size <= 4)


def _are_floats(array: Any) -> bool:
    if not _are_doubles(array):
        return False
    if array.dtype.kind == "f" and array.dtype.itemsize <= 4:
        return True
    import numpy as np

    finite = array[np.isfinite(array)]
    return not len(finite) or float(np.abs(finite).max()) < _LARGEST_FLOAT


_NAMES = {
    getattr(FieldDescriptor, f"TYPE_{name.upper()}"): name
    for name in (
        *("double", "float", "int32", "int64", "uint32", "uint64", "sint32", "sint64"),
        *("fixed32", "fixed64", "sfixed32", "sfixed64", "bool", "string", "bytes"),
    )
}

_WIRE_DTYPES = {
    "double": "<f8",
    "float": "<f4",
    "fixed32": "<u4",
    "fixed64": "<u8",
    "sfixed32": "<i4",
    "sfixed64": "<i8",
}
