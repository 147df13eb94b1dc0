"""The shape of values is a lattice: what order and which blocks values come in makes no difference."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ml_dash_mcap.rows import shape
from ml_dash_mcap.rows.shape import NOTHING, Shape, join
from ml_dash_mcap.rows.value_shapes import of_value, of_values
from tests.support.examples import examples

INTEGERS = st.integers(-(2**65), 2**65) | st.sampled_from(
    [0, -1, 2**53, 2**53 + 1, -(2**53), -(2**53) - 1, 2**63 - 1, 2**63, -(2**63), -(2**63) - 1, 2**64 - 1, 2**64]
)
ARRAYS = st.builds(
    np.zeros, st.lists(st.integers(0, 2), max_size=2).map(tuple), st.sampled_from(["f4", ">f4", "f8", "u1", "?"])
)
MASKED = st.just(np.ma.MaskedArray([1.0, 2.0], [True, False]))
SCALARS = st.none() | st.booleans() | INTEGERS | st.floats() | st.binary(max_size=2)
TEXTS = st.text(max_size=2) | st.sampled_from(["\0", "\ud800", "\U0001f600"])
VALUES: st.SearchStrategy[Any] = st.recursive(
    SCALARS | TEXTS | ARRAYS | MASKED,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from("abc"), inner, max_size=3),
    max_leaves=8,
)
"""All that a row may hold."""

SHAPES = st.lists(VALUES, max_size=3).map(of_values)


def covers(first: Shape, second: Shape) -> bool:
    return first | second == first


@settings(max_examples=examples(200), deadline=None)
@given(SHAPES, SHAPES, SHAPES)
def test_a_join_is_associative(first: Shape, second: Shape, third: Shape) -> None:
    assert (first | second) | third == first | (second | third)


@settings(max_examples=examples(200), deadline=None)
@given(SHAPES, SHAPES)
def test_a_join_is_commutative(first: Shape, second: Shape) -> None:
    assert first | second == second | first


@settings(max_examples=examples(200), deadline=None)
@given(SHAPES, SHAPES)
def test_a_join_is_idempotent_and_returns_the_shape_that_covers_the_other(first: Shape, second: Shape) -> None:
    both = first | second
    assert both | first is both
    assert both | second is both
    assert first | first is first


@settings(max_examples=examples(200), deadline=None)
@given(SHAPES, SHAPES, SHAPES)
def test_a_join_is_the_least_shape_that_covers_both(first: Shape, second: Shape, third: Shape) -> None:
    upper = first | second | third
    assert covers(upper, first | second)


@given(SHAPES)
def test_nothing_is_covered_by_every_shape(some: Shape) -> None:
    assert NOTHING | some == some
    assert some | NOTHING is some


@settings(max_examples=examples(300), deadline=None)
@given(st.lists(VALUES, max_size=5), st.integers(0, 5))
def test_the_shape_of_values_is_the_join_of_the_shapes_of_their_parts(values: list[Any], cut: int) -> None:
    whole = of_values(values)
    assert of_values(values[:cut]) | of_values(values[cut:]) == whole
    each = NOTHING
    for value in values:
        each |= of_value(value)
    assert each == whole


@given(st.lists(st.dictionaries(st.sampled_from("abc"), VALUES), min_size=1, max_size=4))
def test_fields_stand_in_the_order_in_which_they_first_appear(rows: list[dict[str, Any]]) -> None:
    seen = dict.fromkeys(key for row in rows for key in row)
    assert list(of_values(rows).fields) == list(seen)


@given(st.lists(st.dictionaries(st.text(max_size=2), st.dictionaries(st.text(max_size=2), SCALARS)), max_size=4))
def test_what_there_is_no_room_for_is_left_out_and_the_rest_is_the_same(rows: list[dict[str, Any]]) -> None:
    room = 3

    def admit(name: str) -> bool:
        nonlocal room
        room -= 1
        return room >= 0

    bounded = NOTHING
    for row in rows:
        bounded = join(bounded, of_value(row), admit)
    fields = [inner for outer in bounded.fields.values() for inner in (outer, *outer.fields.values())]
    assert len(fields) <= 3
    assert bounded.fields.keys() <= of_values(rows).fields.keys()


@pytest.mark.parametrize(
    ("values", "kinds"),
    [
        ([None], shape.NULL),
        ([True], shape.BOOLEAN),
        ([0, 2**53], shape.INTEGER),
        ([-(2**53)], shape.INTEGER | shape.NEGATIVE),
        ([2**53 + 1], shape.INTEGER | shape.INEXACT),
        ([2**63], shape.INTEGER | shape.INEXACT | shape.UNSIGNED),
        ([2**64], shape.INTEGER | shape.INEXACT | shape.UNSIGNED | shape.HUGE),
        ([-(2**63) - 1], shape.INTEGER | shape.INEXACT | shape.NEGATIVE | shape.HUGE),
        ([1, 0.5], shape.INTEGER | shape.FLOAT64),
        ([math.nan, -math.inf], shape.FLOAT64),
        (["a"], shape.TEXT),
        (["a\0"], shape.TEXT | shape.HAS_NUL),
        (["\ud83d", "\ude00"], shape.TEXT | shape.HAS_SURROGATE),
        ([b""], shape.BYTES),
        ([[]], shape.LIST),
        ([{}], shape.DICT | shape.EMPTY_DICT),
        ([{"a": 1}], shape.DICT),
        ([np.zeros(3)], shape.ARRAY),
        ([1j], shape.OPAQUE),
    ],
    ids=repr,
)
def test_kinds_of_values(values: list[Any], kinds: int) -> None:
    assert of_values(values).kinds == kinds


def test_lists_of_one_length_are_told_from_ragged_ones() -> None:
    matrices = of_values([[[1, 2], [3, 4]], [[5, 6], [7, 8]]])
    ragged = of_values([[[1, 2]], [[3], []]])
    assert matrices.items is not None
    assert ragged.items is not None
    assert (matrices.shortest, matrices.longest, matrices.items.shortest, matrices.items.longest) == (2, 2, 2, 2)
    assert (ragged.shortest, ragged.longest, ragged.items.shortest, ragged.items.longest) == (1, 2, 0, 2)


def test_a_key_that_is_missing_is_told_from_one_that_is_none() -> None:
    missing, none = of_values([{"a": 1}, {"a": 1, "b": 2}]), of_values([{"a": 1, "b": None}, {"a": 1, "b": 2}])
    assert (missing.optional, missing.fields["b"].has_nulls) == ({"b"}, False)
    assert (none.optional, none.fields["b"].has_nulls) == (frozenset(), True)


def test_arrays_keep_the_lengths_that_all_of_them_have() -> None:
    points = of_values([np.zeros((5, 3), "f4"), np.zeros((4, 3), "f4")])
    assert points.array == shape.ArrayType("float32", (None, 3))
    assert (points | of_value(np.zeros((4, 3)))).array == shape.ArrayType(None, (None, 3))
    assert (points | of_value(np.zeros(3, "f4"))).array == shape.ArrayType("float32", None)
