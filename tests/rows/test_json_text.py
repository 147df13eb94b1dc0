"""A row comes back from its bytes as it was, to the last bit, whatever JSON can and cannot say."""

from __future__ import annotations

import json
import math
from typing import Any

import orjson
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ml_dash_mcap.errors import FieldError, IntegerRangeError
from ml_dash_mcap.rows.json_text import exact, restore
from ml_dash_mcap.rows.plain_row import EXACT_KEY, TIME_KEY
from tests.support.examples import examples

names = st.text(max_size=6).filter(lambda name: name not in (EXACT_KEY, TIME_KEY))
scalars = st.one_of(
    st.none(), st.booleans(), st.integers(-(2**63), 2**64 - 1), st.floats(), st.text(max_size=8), st.binary(max_size=8)
)
inner = st.text(max_size=4) | st.sampled_from(["/", "~", "~1", "a/b", "0", "1", "", EXACT_KEY, TIME_KEY])
values = st.recursive(
    scalars, lambda one: st.lists(one, max_size=4) | st.dictionaries(inner, one, max_size=4), max_leaves=12
)
rows = st.builds(lambda row, ts: {**row, TIME_KEY: ts}, st.dictionaries(names, values, max_size=5), st.floats(0, 9e9))


def same(one: Any, other: Any) -> bool:
    """Whether two values are the same to the bit and the type; a NaN is like any other."""
    if type(one) is not type(other):
        return False
    if isinstance(one, dict):
        return list(one) == list(other) and all(same(one[name], other[name]) for name in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, float):
        return (math.isnan(one) and math.isnan(other)) or (
            one == other and math.copysign(1, one) == math.copysign(1, other)
        )
    return bool(one == other)


@given(rows)
@settings(deadline=None, max_examples=examples(250))
@example({"a": math.nan, "b": None, "c": [None, math.inf, {"d/~": -math.inf}], "": b"", "_ts": 0.0})
@example({"~0": {"~1": [b"x"]}, "/": {"": math.nan}, "_ts": 1.0})
@example({"a": {"0": math.nan}, "b": [[math.nan]], "_ts": 1.0})
@example({"x": -0.0, "y": 5e-324, "z": 2**64 - 1, "_ts": 1 / 3})
def test_a_row_comes_back_as_it_was(row: dict[str, Any]) -> None:
    assert same(restore(orjson.loads(exact(row, "topic"))), row)


@given(rows)
@settings(deadline=None)
def test_what_is_written_is_strict_json_with_the_time_stamp_last(row: dict[str, Any]) -> None:
    text = exact(row, "topic")
    parsed = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert list(parsed)[-1] == TIME_KEY
    assert [name for name in parsed if name != EXACT_KEY] == list(row)


junk = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=4),
    lambda one: (
        st.lists(one, max_size=3)
        | st.dictionaries(st.text(max_size=4) | st.sampled_from(["NaN", "bytes", "", "/a", "/a/0"]), one, max_size=3)
    ),
    max_leaves=10,
)


@given(st.dictionaries(st.sampled_from(["a", "b", ""]), junk, max_size=3), junk)
@settings(deadline=None, max_examples=examples(300))
@example({"a": "not base64!"}, {"bytes": {"": ["a"]}})
@example({"a": "\u00e4"}, {"bytes": {"": ["a"]}})
@example({"a": [None]}, {"NaN": {"/a": [-1, 5, "0", None, True, 0.0, [0], {}]}})
@example({"a": None}, {"NaN": {"": [["a"], {"a": 1}]}})
@example({"a": [None]}, {"NaN": {"/a/\u00b2": [0], "/a/\u0661": [0]}})
def test_a_foreign_side_key_never_raises(row: dict[str, Any], notes: Any) -> None:
    restored = restore({**row, EXACT_KEY: notes})
    assert EXACT_KEY not in restored
    assert list(restored) == list(row)


@given(st.integers(max_value=-(2**63) - 1) | st.integers(min_value=2**64))
@example(2**64)
@example(-(2**63) - 1)
@example(10**5000)
def test_an_integer_beyond_64_bits_is_refused_with_its_topic_and_field(number: int) -> None:
    for value in (number, [number], {"deep": [{"er": number}]}):
        with pytest.raises(IntegerRangeError, match=r"'the topic'.*'the field'"):
            exact({"good": 1, "the field": value, "_ts": 1.0}, "the topic")


@pytest.mark.parametrize("depth", [1, 50, 199])
def test_deep_rows_are_kept(depth: int) -> None:
    value: Any = math.nan
    for _ in range(depth):
        value = [value]
    row = {"v": value, "_ts": 1.0}
    assert repr(restore(orjson.loads(exact(row, "t")))) == repr(row)


@pytest.mark.parametrize("depth", [300, 5000])
def test_rows_without_a_bottom_are_refused(depth: int) -> None:
    value: Any = 1
    for _ in range(depth):
        value = [value]
    with pytest.raises(FieldError, match="'v'"):
        exact({"v": value, "_ts": 1.0}, "t")


@pytest.mark.parametrize("text", ["\ud800", "a\udfffb"])
def test_text_that_is_not_unicode_is_refused_with_its_field(text: str) -> None:
    for row in ({"v": text}, {"v": [text]}, {"v": {text: 1}}, {text: 1}):
        with pytest.raises(FieldError):
            exact({"good": 1, **row, "_ts": 1.0}, "t")
