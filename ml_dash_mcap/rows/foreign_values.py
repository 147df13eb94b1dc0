"""Converts objects of Python and of other libraries into values that JSON has, or into numpy arrays.

No library is imported for that: if there is one of its objects, the library is loaded already.
"""

from __future__ import annotations

import array as arrays
import datetime
import enum
import os
import uuid
from collections.abc import Mapping
from dataclasses import fields as dataclass_fields
from dataclasses import is_dataclass
from typing import TYPE_CHECKING, Any

from . import from_data_frames, packed_arrays

if TYPE_CHECKING:
    import numpy.typing as npt


def simple(value: Any) -> Any:
    """Return the plain value of an object, one level deep: None, a number, text, bytes, a list or a dict.

    Raises:
        TypeError: There is nothing in JSON that it stands for.
    """
    if isinstance(value, enum.Enum):
        return value.value
    array = array_of(value)
    if array is not None:
        return checked(value, listed(array))
    if is_dataclass(value) and not isinstance(value, type):
        names = [field.name for field in dataclass_fields(value) if not field.name.startswith("_")]
        return {name: getattr(value, name) for name in names}
    if isinstance(value, (datetime.datetime, datetime.date, datetime.time)):
        return None if from_data_frames.is_missing(value) else value.isoformat()
    if isinstance(value, uuid.UUID):
        return str(value)
    if isinstance(value, float):
        return float(value)
    if isinstance(value, tuple):
        return list(value)
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, Mapping):
        return dict(value)
    if from_data_frames.library_of(value) is not None:
        return checked(value, from_data_frames.plain_value(value))
    if hasattr(value, "tolist") and not isinstance(value, (memoryview, type)):
        return checked(value, value.tolist())
    raise TypeError(f"Type is not JSON serializable: {type(value).__name__}")


def array_of(value: Any) -> npt.NDArray[Any] | None:
    """Return the array that an object is or holds; None if it is something else.

    Arrays are those of numpy, `array.array` of numbers, memoryviews of anything but bytes in a row, columns of pandas,
    polars and pyarrow that are numbers, and whatever has `__array__`, such as tensors.
    """
    if from_data_frames.library_of(value) is not None:
        import numpy as np

        column = from_data_frames.plain(value)
        is_array = column is not value and hasattr(column, "dtype")
        return np.asarray(column) if is_array else None
    if isinstance(value, memoryview):
        if is_bytes(value):
            return None
    elif isinstance(value, arrays.array):
        # Arrays of letters.
        if value.typecode in "uw":
            return None
    elif isinstance(value, type) or not hasattr(value, "__array__"):
        return None
    import numpy as np

    if isinstance(value, np.generic) and not (value.dtype.kind in "mM" or value.dtype.names):
        return None
    try:
        array: npt.NDArray[Any] = np.asanyarray(value)
        return array
    except Exception:  # a tensor elsewhere than in memory, or with a gradient, still has `tolist`
        if hasattr(value, "tolist"):
            return None
        raise


def large_array_of(value: Any) -> npt.NDArray[Any] | None:
    """Return the array that an object is or holds if it is to be packed, see `packed.is_large`."""
    if _count(value) <= packed_arrays.MOST_LISTED:
        return None
    array = array_of(value)
    return array if array is not None and packed_arrays.is_large(array) else None


def _count(value: Any) -> int:
    """Return about how many elements an object has: at least one for each, many where only it could say."""
    size = getattr(value, "size", None)
    if isinstance(size, int) and size:
        return size
    if isinstance(value, memoryview):
        return value.nbytes
    try:
        return len(value) if not hasattr(value, "shape") else packed_arrays.MOST_LISTED + 1
    except TypeError:
        return packed_arrays.MOST_LISTED + 1 if hasattr(value, "__array__") else 1


def is_bytes(view: memoryview) -> bool:
    """Whether a memoryview is one of bytes in a row, and not of numbers or of an image."""
    return view.ndim == 1 and view.format in ("B", "c")


def listed(array: npt.NDArray[Any]) -> Any:
    """Return an array as lists: its times as text, its records as dicts, masked elements as None."""
    kind = array.dtype.kind
    if kind in "mM":
        return _times(array)
    if kind == "V" and array.dtype.names:
        return _records(array)
    return array.tolist()


def _times(array: npt.NDArray[Any]) -> Any:
    """Return numpy's times in ISO 8601, spans as text with their unit, and None for NaT and masked elements."""
    import numpy as np

    values = np.ma.getdata(array)
    # As objects, because an array of texts would hold "None" in the place of None.
    texts = np.array(values.astype(str), object)
    texts[np.isnat(values) | np.ma.getmaskarray(array)] = None
    return texts.tolist()


def _records(array: npt.NDArray[Any]) -> Any:
    """Return a structured array as dicts, in lists as deep as it has dimensions."""
    flat = array.reshape(-1)
    names = array.dtype.names or ()
    columns = [_cells(flat[name]) for name in names]
    cells: list[Any] = [dict(zip(names, cells, strict=True)) for cells in zip(*columns, strict=True)]
    for length in reversed(array.shape[1:]):
        count = len(cells) // length if length else 0
        cells = [cells[at * length : (at + 1) * length] for at in range(count)]
    return cells if array.ndim else cells[0]


def _cells(column: npt.NDArray[Any]) -> list[Any]:
    """Return one value a record, arrays as they are."""
    return list(column) if column.ndim > 1 else list(listed(column))


def key_text(key: Any) -> str:
    """Spell a dict's key as `json.dumps` would; an enum's as its value, numpy's numbers as Python's.

    Raises:
        TypeError: It is neither text nor a number, a boolean or None.
    """
    if isinstance(key, str):
        # Not str(key): a subclass, such as an enum of texts, may spell itself in another way. So may numbers, below.
        return str.__str__(key)
    if isinstance(key, enum.Enum) and not isinstance(key, (int, float)):
        return key_text(key.value)
    if hasattr(key, "dtype") and not isinstance(key, float) and getattr(key, "ndim", 1) == 0:
        key = key.tolist()
    if key is None or isinstance(key, bool):
        return {None: "null", True: "true", False: "false"}[key]
    if isinstance(key, int):
        return int.__repr__(key)
    if isinstance(key, float):
        return _float_text(key)
    raise TypeError(f"a dict has the key {key!r}; keys must be text")


def _float_text(key: float) -> str:
    text = float.__repr__(key)
    return {"nan": "NaN", "inf": "Infinity", "-inf": "-Infinity"}.get(text, text)


def advice(value: Any) -> str:
    """Return advice: what to pass instead of an object that cannot be stored."""
    name = type(value).__name__
    for names, instead in _INSTEAD.items():
        if name in names:
            return instead
    return "pass numbers, text, bytes, lists, dicts or arrays"


_INSTEAD = {
    ("set", "frozenset", "deque", "range", "generator", "dict_keys", "dict_values", "dict_items", "map", "zip"): (
        "pass list(...) of it"
    ),
    ("Decimal", "Fraction", "mpf"): "pass float(...) of it, or str(...) to keep each digit",
    ("complex", "complex64", "complex128", "clongdouble"): "pass its real and imaginary part: [z.real, z.imag]",
    ("longdouble", "float128"): "pass float(...) of it, or an array's astype(float)",
    ("timedelta",): "pass its total_seconds()",
    ("type", "function", "builtin_function_or_method", "method"): "pass its __name__",
}
"""Names of types to what to pass in their place."""


def checked(value: Any, simpler: Any) -> Any:
    """Return the plain value of an object, checked.

    Raises:
        TypeError: The plain value is of the object's own type again.
    """
    if type(simpler) is type(value):
        raise TypeError(f"Type is not JSON serializable: {type(value).__name__}")
    return simpler
