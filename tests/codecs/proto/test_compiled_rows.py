"""Compiled code encodes a row as the slow way does, or not at all."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from ml_dash_mcap.codecs.proto.compiled_rows import compile_row
from ml_dash_mcap.codecs.proto.growth import Growth
from ml_dash_mcap.codecs.proto.layout import ROW, Layout
from ml_dash_mcap.codecs.proto.row_encoder import RowEncoder
from ml_dash_mcap.codecs.proto.row_source import NotCompilableError
from ml_dash_mcap.rows.plain_row import PlainRow
from tests.support.examples import examples

Row = dict[str, Any]

numbers = st.floats() | st.integers(-(2**63), 2**64 - 1) | st.integers(-3, 3) | st.booleans()
numpy_values = st.builds(
    lambda dtype, count: np.arange(count).astype(dtype),
    st.sampled_from(["f8", "f4", "f2", "i8", "i4", "u1", "u4", "u8", "bool", ">f8", ">i2"]),
    st.integers(0, 4),
) | st.builds(
    lambda value, of: of(value), st.integers(0, 100), st.sampled_from([np.float64, np.float32, np.int32, np.bool_])
)
texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=4)
leaves = numbers | texts | st.binary(max_size=4) | st.none() | numpy_values
lists = (
    st.lists(st.floats(), max_size=3)
    | st.lists(st.integers(-5, 5), max_size=3)
    | st.lists(st.booleans(), max_size=3)
    | st.lists(texts, max_size=3)
    | st.lists(numbers, max_size=3)
    | st.lists(st.lists(st.floats(), min_size=2, max_size=2), max_size=3)
    | st.lists(st.lists(numbers, max_size=2), max_size=2)
    | st.lists(numbers, max_size=3).map(tuple)
)
dicts = st.dictionaries(st.sampled_from(["x", "y", "z"]), leaves | lists, max_size=3)
values = leaves | lists | dicts | st.lists(dicts, max_size=2)
rows = st.dictionaries(st.sampled_from(["a", "b", "type", "%d", "len"]), values, min_size=1, max_size=3)


def slow(layout: Layout, row: Row) -> bytes:
    return RowEncoder().encode(layout, PlainRow("topic").row(row))


def wide(*given_rows: Row) -> Layout:
    layout = ROW
    for row in given_rows:
        plain = {key: value for key, value in PlainRow("topic").row(row).items() if key != "_ts"}
        layout = Growth(layout).widened(layout, plain)
    return layout


@given(seen=rows, others=st.lists(rows, max_size=2), time_s=st.floats(0, 1e9), is_flexible=st.booleans())
@settings(deadline=None, max_examples=examples(600))
def test_rows_are_encoded_as_the_slow_way_does_or_not_at_all(
    seen: Row, others: list[Row], time_s: float, is_flexible: bool
) -> None:
    candidates = [{**row, "_ts": time_s} for row in (seen, *others)]
    candidates += [{**dict(zip(seen, other.values(), strict=False)), "_ts": 1.0} for other in others]
    layout = wide(*candidates)
    try:
        encode = compile_row(layout, candidates[0], is_flexible=is_flexible)
    except NotCompilableError:
        assume(False)
    assert encode(candidates[0]) == slow(layout, candidates[0])
    for row in candidates:
        if tuple(row) == tuple(candidates[0]):
            assert encode(row) in (None, slow(layout, row))


@pytest.mark.parametrize(
    ("seen", "unlike"),
    [
        ({"q": [0.5, 0.5]}, {"q": [0.5, 1]}),
        ({"q": [0.5, 0.5]}, {"q": [0.5, True]}),
        ({"q": [0.5, 0.5]}, {"q": [0.5, np.float64(1)]}),
        ({"q": [0.5, 0.5]}, {"q": [0.5]}),
        ({"q": [0.5, 0.5]}, {"q": (0.5, 0.5)}),
        ({"q": [0.5, 0.5]}, {"q": np.array([0.5, 0.5])}),
        ({"q": np.array([0.5, 0.5])}, {"q": np.array([0.5, 0.5], "f4")}),
        ({"q": np.array([0.5, 0.5])}, {"q": np.array([[0.5, 0.5]])}),
        ({"q": np.array([0.5, 0.5])}, {"q": np.ma.array([0.5, 0.5], mask=[True, False])}),
        ({"m": [[0.5], [0.5]]}, {"m": [[0.5], (0.5,)]}),
        ({"m": [[0.5], [0.5]]}, {"m": [[0.5, 0.5], []]}),
        ({"n": 1}, {"n": True}),
        ({"n": 1}, {"n": 2**63}),
        ({"n": 1}, {"n": 1.0}),
        ({"s": "a"}, {"s": b"a"}),
        ({"s": "a"}, {"s": np.str_("a")}),
        ({"s": ["a"]}, {"s": ["a", 1]}),
        ({"d": {"x": 0.5}}, {"d": {"y": 0.5}}),
        ({"d": {"x": 0.5, "y": 0.5}}, {"d": {"y": 0.5, "x": 0.5}}),
        ({"d": {"x": 0.5}}, {"d": None}),
        ({"x": None}, {"x": 0.5}),
        ({"b": True}, {"b": 1}),
    ],
)
def test_a_row_of_another_kind_is_left_to_the_slow_way(seen: Row, unlike: Row) -> None:
    first, second = {**seen, "_ts": 1.0}, {**unlike, "_ts": 2.0}
    encode = compile_row(wide(first, second), first)
    assert encode(second) is None


def test_changing_text_lists_of_any_length_and_counters_stay_compiled() -> None:
    first = {"mode": "idle", "step": 1, "names": ["a"], "gripper": 0, "image": np.zeros((300, 300), "u1"), "_ts": 1.0}
    second = {"mode": "m\u00f6ve" * 100, "step": -5, "names": ["b", "c"], "gripper": 3}
    second |= {"image": np.ones((290, 300), "u1"), "_ts": 2.0}
    layout = wide({"gripper": 0.5, "_ts": 0.0}, first, second)
    encode = compile_row(layout, first)
    assert encode(second) == slow(layout, second)


def test_lists_and_arrays_of_any_length_can_be_compiled_together() -> None:
    first = {"points": np.zeros((2, 3)), "q": [0.5], "_ts": 1.0}
    second = {"points": np.ones((5, 3)), "q": [0.5, 1.5], "_ts": 2.0}
    layout = wide(first, second)
    assert compile_row(layout, first)(second) is None
    assert compile_row(layout, first, is_flexible=True)(second) == slow(layout, second)


def test_integers_among_doubles_at_the_same_places_are_compiled() -> None:
    first = {"quat": [0.5, 0, 0, 1.0], "m": [[1, 0.5], [0.5, 2]], "zero": [0, 0, 0], "_ts": 1.0}
    second = {"quat": [0.1, 7, -2, 0.3], "m": [[5, 1.5], [2.5, 6]], "zero": [1, 2, 3], "_ts": 2.0}
    layout = wide({"zero": [0.5], "_ts": 0.0}, first, second)
    encode = compile_row(layout, first)
    assert encode(second) == slow(layout, second)
    assert encode({**second, "quat": [0, 0.5, 0.5, 0.5]}) is None
