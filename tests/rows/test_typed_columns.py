"""The type of a column holds the values of all its blocks, whichever came first."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ml_dash_mcap.rows.arrow_types import of_array, of_type, stored_type, type_of, vector_lengths
from ml_dash_mcap.rows.shape import NOTHING, Shape
from ml_dash_mcap.rows.table import block_of
from ml_dash_mcap.rows.typed_columns import Column, cast_to_file, shape_of, values_of
from ml_dash_mcap.rows.value_shapes import of_values

NUMBERS = st.one_of(st.integers(-(2**63), 2**64 - 1), st.integers(-3, 3), st.floats(allow_nan=False))
VALUES = st.one_of(
    st.none(),
    st.booleans(),
    NUMBERS,
    st.text(max_size=2),
    st.lists(st.floats(-1, 1), min_size=2, max_size=2),
    st.lists(st.integers(-3, 3), max_size=3),
    st.lists(st.lists(NUMBERS, min_size=2, max_size=2), min_size=2, max_size=2),
    st.lists(st.fixed_dictionaries({"a": NUMBERS, "b": st.lists(NUMBERS, max_size=1)}), max_size=2),
)
BLOCKS = st.lists(st.lists(VALUES, min_size=1, max_size=3), min_size=1, max_size=3)


def column(values: list[Any]) -> Column:
    return block_of([{"x": value} for value in values]).columns["x"]


def covering_shape(*blocks: list[Any]) -> Shape:
    shape = NOTHING
    for values in blocks:
        shape |= shape_of(column(values))
    return shape


def canonical(value: Any) -> Any:
    """Numbers as they compare, arrays without their shape."""
    if isinstance(value, list):
        return [canonical(element) for element in value]
    if isinstance(value, dict):
        return {key: canonical(value[key]) for key in sorted(value)}
    return float(value) if type(value) is int and abs(value) <= 2**53 else value


def flat(value: Any) -> list[Any]:
    return [leaf for inner in value for leaf in flat(inner)] if isinstance(value, list) else [value]


@given(BLOCKS)
def test_every_value_comes_back_from_the_type_that_covers_all_blocks(blocks: list[list[Any]]) -> None:
    covering = covering_shape(*blocks)
    for values in blocks:
        array = cast_to_file(column(values), covering)
        assert array.type == stored_type(covering)
        for given_, stored in zip(values, values_of(Column(array, type_of(covering) is None)), strict=True):
            if vector_lengths(covering) and given_ is not None:
                given_ = flat(given_)
            assert repr(canonical(stored)) == repr(canonical(given_))


ARRAYS = st.builds(np.ones, st.sampled_from([2, 3, (2, 2)]), st.sampled_from(["f2", "f4", "f8", "i1", "u1", "u8", "?"]))
ARRAY_BLOCKS = st.lists(st.lists(VALUES, min_size=1, max_size=2) | st.lists(ARRAYS, min_size=1, max_size=2), max_size=4)


@given(ARRAY_BLOCKS)
def test_the_order_of_blocks_makes_no_difference(blocks: list[list[Any]]) -> None:
    forward, backward = covering_shape(*blocks), covering_shape(*blocks[::-1])
    assert forward == backward
    assert stored_type(forward) == stored_type(backward)


@given(ARRAY_BLOCKS)
def test_what_is_covered_already_changes_nothing(blocks: list[list[Any]]) -> None:
    covering = covering_shape(*blocks)
    for values in blocks:
        assert covering | shape_of(column(values)) is covering


@pytest.mark.parametrize(
    ("dtypes", "type_"),
    [
        (["f4", "f4"], pa.float32()),
        (["f4", "f8"], pa.float64()),
        (["f2", "f4"], pa.float64()),
        (["i1", "u1"], pa.int64()),
        (["u1", "f4"], pa.float64()),
        (["u8", "u8"], pa.uint64()),
        (["u8", "i4"], pa.int64()),
    ],
)
def test_arrays_of_several_types_are_numbers_in_whichever_blocks_they_come(dtypes: list[str], type_: Any) -> None:
    covering = covering_shape(*([np.ones(3, dtype)] for dtype in dtypes))
    assert stored_type(covering) == pa.list_(type_, 3)


@given(st.lists(VALUES, min_size=1, max_size=5))
def test_an_array_has_the_type_of_the_values_that_it_was_made_of(values: list[Any]) -> None:
    type_ = type_of(of_values(values))
    if type_ is not None:
        assert type_of(of_array(pa.array(values, type_))) == type_
        assert type_of(of_type(type_)) == type_


@pytest.mark.parametrize(
    ("blocks", "stored", "shape"),
    [
        ([[1], [2.5]], pa.float64(), ()),
        ([[2**53 + 1], [2.5]], pa.string(), ()),
        ([[1], [2**63]], pa.uint64(), ()),
        ([[-1], [2**63]], pa.string(), ()),
        ([[1], ["a"]], pa.string(), ()),
        ([[True], [1]], pa.string(), ()),
        ([[None], [b"a"]], pa.binary(), ()),
        ([[None]], pa.null(), ()),
        ([[[1.0, 2.0]], [[3, 4]]], pa.list_(pa.float64(), 2), (2,)),
        ([[[1.0, 2.0]], [None]], pa.list_(pa.float64()), (2,)),
        ([[[1.0, 2.0]], [[1.0]]], pa.list_(pa.float64()), ()),
        ([[[1.0, 2.0]], [[]]], pa.list_(pa.float64()), ()),
        ([[[[1, 2], [3, 4]]], [[[5.5, 6], [7, 8]]]], pa.list_(pa.float64(), 4), (2, 2)),
        ([[[[1, 2], [3, 4]]], [[[1, 2]]]], pa.list_(pa.list_(pa.int64())), ()),
        ([[["a"], ["b"]]], pa.list_(pa.string()), ()),
    ],
)
def test_values_are_stored_in_the_narrowest_type_that_every_reader_knows(
    blocks: list[list[Any]], stored: pa.DataType, shape: tuple[int, ...]
) -> None:
    covering = covering_shape(*blocks)
    assert (stored_type(covering), vector_lengths(covering)) == (stored, shape)
