"""Converts shapes into Arrow types, and Arrow types and arrays into shapes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from . import shape
from .plain_row import has_lone_surrogates
from .shape import NOTHING, ONLY_NULL, Shape, of_dicts, of_integers, of_lists, scalar

_NUMPY_TYPES = {
    shape.INT8: pa.int8(),
    shape.INT16: pa.int16(),
    shape.INT32: pa.int32(),
    shape.UINT8: pa.uint8(),
    shape.UINT16: pa.uint16(),
    shape.UINT32: pa.uint32(),
    shape.UINT64: pa.uint64(),
    shape.FLOAT16: pa.float16(),
    shape.FLOAT32: pa.float32(),
    shape.FLOAT64: pa.float64(),
}
"""Types that numbers keep if all of them have the same."""

_NUMBER_KINDS = {pa.int64(): shape.INTEGER, **{type_: kind for kind, type_ in _NUMPY_TYPES.items()}}

_SIMPLE_TYPES = {shape.BOOLEAN: pa.bool_(), shape.TEXT: pa.string(), shape.BYTES: pa.binary()}
_SIMPLE_SHAPES = {pa.bool_(): scalar(shape.BOOLEAN), pa.binary(): scalar(shape.BYTES)}

_MOST_LEVELS = 40
"""pyarrow reads 100 levels from a Parquet file. The others are left for the dicts in which a column lies."""


# -- shapes of arrays --------------------------------------------------------------------------------------------------


def of_array(array: pa.Array) -> Shape:
    """Return the shape of the values of an array, [N], without making Python objects of them."""
    present = array.drop_null() if array.null_count else array
    nulls = ONLY_NULL if len(present) < len(array) else NOTHING
    return nulls | _of_present(present) if len(present) else nulls


def of_type(type_: pa.DataType) -> Shape:
    """Return the least shape whose values have a type."""
    if pa.types.is_null(type_):
        return ONLY_NULL
    if is_list(type_):
        is_fixed = pa.types.is_fixed_size_list(type_)
        shortest, longest = (type_.list_size, type_.list_size) if is_fixed else (0, shape.UNBOUNDED)
        return of_lists(of_type(type_.value_type), shortest, longest)
    if pa.types.is_struct(type_):
        fields = [type_.field(at) for at in range(type_.num_fields)]
        return of_dicts({field.name: of_type(field.type) for field in fields})
    if pa.types.is_string(type_):
        return scalar(shape.TEXT)
    return _SIMPLE_SHAPES.get(type_) or scalar(_NUMBER_KINDS.get(type_, shape.OPAQUE))


def _of_present(array: pa.Array) -> Shape:
    type_ = array.type
    if type_ in _NUMBER_KINDS:
        return _of_numbers(array, _NUMBER_KINDS[type_])
    if type_ in _SIMPLE_SHAPES:
        return _SIMPLE_SHAPES[type_]
    if pa.types.is_string(type_):
        return shape.of_texts(array[0].as_py(), has_nul=_has_nul(array))
    if is_list(type_):
        lengths = pc.min_max(pc.list_value_length(array))
        return of_lists(of_array(array.flatten()), lengths["min"].as_py(), lengths["max"].as_py())
    if pa.types.is_struct(type_):
        names = [type_.field(at).name for at in range(type_.num_fields)]
        return of_dicts({name: of_array(child) for name, child in zip(names, array.flatten(), strict=True)})
    return scalar(shape.OPAQUE)


def _of_numbers(array: pa.Array, kind: int) -> Shape:
    if kind & shape.FLOATS:
        return scalar(kind)
    bounds = pc.min_max(array)
    integers = of_integers(bounds["min"].as_py(), bounds["max"].as_py())
    if kind == shape.UINT64 and integers.kinds & shape.UNSIGNED:  # no array of numpy: its values need the type
        return integers
    return scalar(integers.kinds & ~shape.INTEGER | kind)


def _has_nul(array: pa.Array) -> bool:
    _, places, data = array.buffers()
    if data is None:
        return False
    offsets = np.frombuffer(places, np.int32)
    # In UTF-8 only NUL has a byte 0.
    letters = np.frombuffer(data, np.uint8)[offsets[array.offset] : offsets[array.offset + len(array)]]
    return not letters.all()


# -- types of shapes ---------------------------------------------------------------------------------------------------


def type_of(values: Shape, *, is_in_null: bool = False) -> pa.DataType | None:
    """Return the type that holds all values without loss, or None where only JSON text holds them.

    Lists of numbers are of fixed size if all have one length and none is missing: pyarrow before 26 cannot read nulls
    back among lists of fixed size.

    Args:
        values: Their shape.
        is_in_null: Whether the dict that they lie in is missing in some places.
    """
    kinds = values.value_kinds
    if not kinds:
        return pa.null()
    if not kinds & ~shape.NUMBERS:
        return _number_type(values)
    has_nulls = values.has_nulls or is_in_null
    if kinds == shape.LIST and values.items is not None:
        inner = type_of(values.items)
        is_fixed = values.shortest == values.longest and not has_nulls
        return None if inner is None else pa.list_(inner, values.longest if is_fixed and is_number(inner) else -1)
    if kinds == shape.DICT:
        return _struct_type(values, has_nulls)
    return None if values.kinds & shape.HAS_SURROGATE else _SIMPLE_TYPES.get(kinds)


def _number_type(numbers: Shape) -> pa.DataType | None:
    """Return the type of numbers: integers are doubles beside fractions, if a double rounds none of them."""
    kinds = numbers.kinds
    if numbers.value_kinds in _NUMPY_TYPES:
        return _NUMPY_TYPES[numbers.value_kinds]
    if kinds & shape.FLOATS:
        return pa.float64() if numbers.is_exact_as_doubles else None
    if kinds & shape.HUGE or kinds & (shape.NEGATIVE | shape.UNSIGNED) == shape.NEGATIVE | shape.UNSIGNED:
        return None
    return pa.uint64() if kinds & shape.UNSIGNED else pa.int64()


def _struct_type(dicts: Shape, has_nulls: bool) -> pa.DataType | None:
    """Return the type of dicts, None unless all have the same keys, one at least, which Arrow can spell."""
    if dicts.optional or not dicts.fields or any(map(has_lone_surrogates, dicts.fields)):
        return None
    types = {name: type_of(values, is_in_null=has_nulls) for name, values in dicts.fields.items()}
    return None if None in types.values() else pa.struct(list(types.items()))


def stored_type(values: Shape) -> pa.DataType:
    """Return the type that holds values in a file: vectors and matrices as flat lists.

    These are of fixed size if none is missing. All other lists are of variable size, as every reader reads them back
    from inside others.
    """
    type_ = type_of(values)
    if type_ is None:
        return pa.string()
    lengths = vector_lengths(values)
    if not lengths:
        return loose(type_)
    return pa.list_(element_type(values), -1 if values.has_nulls else int(np.prod(lengths)))


def vector_lengths(values: Shape) -> tuple[int, ...]:
    """Return the lengths that all values have, as (7,) or (4, 4); () if they are no vectors or matrices of numbers."""
    lengths: list[int] = []
    level = values
    while level.value_kinds == shape.LIST and level.items is not None:
        if level.shortest != level.longest or not level.longest or (lengths and level.has_nulls):
            return ()
        lengths.append(level.longest)
        level = level.items
    is_numbers = level.value_kinds and not level.value_kinds & ~shape.NUMBERS and type_of(level) is not None
    return tuple(lengths) if is_numbers else ()


def element_type(vectors: Shape) -> pa.DataType | None:
    """Return the type of one number of a vector or a matrix; that of a single value otherwise."""
    lengths = vector_lengths(vectors)
    for _ in lengths:
        assert vectors.items is not None
        vectors = vectors.items
    return type_of(vectors)


def loose(type_: pa.DataType) -> pa.DataType:
    """Return a type with lists of variable size in place of those of fixed size."""
    if is_list(type_):
        return pa.list_(loose(type_.value_type))
    if pa.types.is_struct(type_):
        fields = [type_.field(at) for at in range(type_.num_fields)]
        return pa.struct([pa.field(field.name, loose(field.type)) for field in fields])
    return type_


def is_list(type_: pa.DataType) -> bool:
    """Whether values of a type are lists, of fixed size or not."""
    return bool(pa.types.is_list(type_) or pa.types.is_fixed_size_list(type_))


def is_number(type_: pa.DataType) -> bool:
    """Whether values of a type are integers or fractions."""
    return bool(pa.types.is_integer(type_) or pa.types.is_floating(type_))


def is_shallow(type_: pa.DataType) -> bool:
    """Whether a type is nested so little that Parquet's readers take it; deeper values are JSON text."""
    return _levels(type_) <= _MOST_LEVELS


def _levels(type_: Any) -> int:
    """Return how many levels a type has in a Parquet file: two for a list, one for a dict."""
    inner = max((_levels(type_.field(at).type) for at in range(type_.num_fields)), default=0)
    return inner + (2 if is_list(type_) else 1)
