"""Converts Arrow columns of any type into columns of values that a row can hold.

Text, bytes, booleans, numbers, lists and structs stay what they are. What JSON has no type for keeps all that it says:

- decimals are text, with all their digits;
- instants, dates and times of day are text as ISO 8601 has it, with their zone's offset and all digits of their unit;
- durations are integers in their unit;
- dictionaries are what they stand for; maps are lists of `{"key", "value"}`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

_OFFSET = r"([+\-]\d\d)(\d\d)$"


def plain(array: pa.Array) -> pa.Array:
    """Return the same values in a type that rows have.

    Raises:
        TypeError: There is none; the message names the type.
    """
    if isinstance(array, pa.ExtensionArray):
        return plain(array.storage)
    type_ = array.type
    if pa.types.is_dictionary(type_):
        return plain(array.dictionary_decode())
    if pa.types.is_run_end_encoded(type_):
        return plain(pc.run_end_decode(array))
    if pa.types.is_map(type_):
        return _of_map(array)
    if _is_list(type_):
        return _of_list(array)
    if pa.types.is_struct(type_):
        return _of_struct(array)
    if pa.types.is_interval(type_):
        return _of_intervals(array)
    return _of_single(array, type_)


def meaning(type_: pa.DataType) -> str | None:
    """Return what a column's type says beyond its values; None for the types that a recording gives back."""
    same = (pa.bool_(), pa.int64(), pa.float64(), pa.string(), pa.binary(), pa.null())
    if type_ in same or (pa.types.is_list(type_) and type_.value_type in same):
        return None
    return str(type_)


def _of_single(array: pa.Array, type_: pa.DataType) -> pa.Array:
    if pa.types.is_null(type_) or pa.types.is_boolean(type_) or pa.types.is_integer(type_) or type_ == pa.float64():
        return array
    if pa.types.is_float16(type_):  # pyarrow before 17 does not cast it
        values = np.array(array.to_numpy(zero_copy_only=False), np.float64)
        return pa.array(values, mask=array.is_null().to_numpy(zero_copy_only=False))
    if pa.types.is_floating(type_):
        return array.cast(pa.float64())
    name = str(type_)
    # The name covers all variants, also `binary_view` and `large_binary`, which old versions of pyarrow lack a test
    # for.
    if "binary" in name:
        return array.cast(pa.binary())
    if "string" in name or pa.types.is_decimal(type_) or pa.types.is_date(type_) or pa.types.is_time(type_):
        return array.cast(pa.string())
    if pa.types.is_timestamp(type_):
        return _iso(array)
    if pa.types.is_duration(type_):
        return array.cast(pa.int64())
    raise TypeError(f"nothing in a row holds values of the type {type_}")


def _iso(array: pa.Array) -> pa.Array:
    # Arrow's cast keeps all digits of the unit, which Python's datetime would cut to microseconds.
    texts = pc.replace_substring(array.cast(pa.string()), " ", "T", max_replacements=1)
    if array.type.tz is None:
        return texts
    offset = pc.replace_substring_regex(texts, "Z$", "+00:00")
    return pc.replace_substring_regex(offset, _OFFSET, r"\1:\2")


def _is_list(type_: pa.DataType) -> bool:
    return str(type_).startswith(("list", "large_list", "fixed_size_list"))


def _of_list(array: pa.Array) -> pa.Array:
    has_gaps = array.null_count > 0
    if pa.types.is_fixed_size_list(array.type) and not has_gaps:
        return pa.FixedSizeListArray.from_arrays(plain(array.flatten()), array.type.list_size)
    lengths = pc.list_value_length(array)
    # List views have no offsets in one order; they are rare, and go through Python.
    if not (pa.types.is_list(array.type) or pa.types.is_large_list(array.type) or _is_fixed(array.type)):
        return pa.array(array.to_pylist(), pa.list_(plain(pa.array([], array.type.value_type)).type))
    counts = (pc.fill_null(lengths, 0) if has_gaps else lengths).to_numpy(zero_copy_only=False)
    offsets = pa.array(np.concatenate(([0], np.cumsum(counts))).astype(np.int32))
    return pa.ListArray.from_arrays(offsets, plain(array.flatten()), mask=pc.is_null(array) if has_gaps else None)


def _is_fixed(type_: pa.DataType) -> bool:
    return bool(pa.types.is_fixed_size_list(type_))


def _of_map(array: pa.Array) -> pa.Array:
    type_ = array.type
    entries = pa.list_(pa.struct([("key", type_.key_type), ("value", type_.item_type)]))
    pairs = [None if entries is None else [{"key": k, "value": v} for k, v in entries] for entries in array.to_pylist()]
    return plain(pa.array(pairs, entries))


def _of_struct(array: pa.Array) -> pa.Array:
    count = array.type.num_fields
    if not count:
        return array
    children: list[Any] = [plain(array.field(at)) for at in range(count)]
    names = [array.type.field(at).name for at in range(count)]
    return pa.StructArray.from_arrays(children, names, mask=pc.is_null(array) if array.null_count else None)


def _of_intervals(array: pa.Array) -> pa.Array:
    names = ("months", "days", "nanoseconds")
    return pa.array(
        [None if values is None else dict(zip(names, values, strict=True)) for values in array.to_pylist()],
        pa.struct([(name, pa.int64()) for name in names]),
    )
