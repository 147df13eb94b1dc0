"""Rows of one time stamp are one row: later fields win, in whatever groups they are merged, decoded or as bytes."""

from __future__ import annotations

import math
from typing import Any

import orjson
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ml_dash_mcap.codecs import json_merge
from ml_dash_mcap.codecs.json import CODEC
from ml_dash_mcap.rows import merge
from ml_dash_mcap.rows.json_text import exact, restore
from tests.rows.test_json_text import inner, same, scalars
from tests.support.examples import examples

Row = dict[str, Any]

fields = st.sampled_from(["a", "b", "q1", "q2", "a/b", "~", "~1", "", "0"])
values = st.recursive(
    scalars, lambda one: st.lists(one, max_size=3) | st.dictionaries(inner, one, max_size=3), max_leaves=6
)
row = st.dictionaries(fields, values, max_size=4).map(lambda drawn: {**drawn, "_ts": 1.5})
some_rows = st.lists(row, min_size=1, max_size=5)


def sorted_row(one: Row) -> Row:
    return dict(sorted(one.items()))


def decoded(payload: bytes) -> Row:
    return restore(orjson.loads(payload))


@given(some_rows, st.data())
@settings(deadline=None)
def test_merging_is_associative(rows: list[Row], data: st.DataObject) -> None:
    cut = data.draw(st.integers(1, len(rows)))
    parts = [part for part in (rows[:cut], rows[cut:]) if part]
    assert same(merge.merge([merge.merge(part) for part in parts]), merge.merge(rows))


@given(some_rows)
@settings(deadline=None)
def test_the_last_row_that_has_a_field_wins_and_no_row_is_changed(rows: list[Row]) -> None:
    before = repr(rows)
    merged = merge.merge(rows)
    for name in {name for one in rows for name in one}:
        assert same(merged[name], [one[name] for one in rows if name in one][-1])
    assert repr(rows) == before


@given(some_rows)
@settings(deadline=None, max_examples=examples(150))
@example([{"a": math.nan, "_ts": 1.5}, {"a": None, "_ts": 1.5}])
@example([{"a": None, "_ts": 1.5}, {"a": math.nan, "_ts": 1.5}])
@example([{"a": b"x", "_ts": 1.5}, {"a": "eA==", "_ts": 1.5}])
@example([{"": {"": math.nan}, "_ts": 1.5}, {"a/b": {"~": [b"x"]}, "_ts": 1.5}])
@example([{"a": [math.nan, None], "_ts": 1.5}, {"a": [None, math.nan], "b": math.inf, "_ts": 1.5}])
def test_joining_bytes_is_merging_rows(rows: list[Row]) -> None:
    joined = json_merge.join([exact(one, "t") for one in rows])
    assert same(sorted_row(decoded(joined)), sorted_row(merge.merge(rows)))
    assert list(orjson.loads(joined))[-1] == "_ts"


@given(some_rows, st.data())
@settings(deadline=None)
def test_joining_bytes_is_associative(rows: list[Row], data: st.DataObject) -> None:
    payloads = [exact(one, "t") for one in rows]
    cut = data.draw(st.integers(1, len(rows)))
    parts = [json_merge.join(part) for part in (payloads[:cut], payloads[cut:]) if part]
    assert same(sorted_row(decoded(json_merge.join(parts))), sorted_row(decoded(json_merge.join(payloads))))


texts = st.text(max_size=5) | st.sampled_from(['"_ts":', ',"_ts":5}', "}", "{", '\\"_ts\\":1'])
plain_value = st.recursive(
    st.none() | st.integers(-9, 9) | texts,
    lambda one: st.lists(one, max_size=2) | st.dictionaries(texts, one, max_size=2),
    max_leaves=4,
)


@given(st.lists(st.dictionaries(fields, plain_value, max_size=3), min_size=1, max_size=4))
@settings(deadline=None, max_examples=examples(150))
@example([{"a": {"_ts": 5}}, {"b": '"_ts":'}, {}])
def test_rows_without_a_common_field_are_joined_by_cutting_their_bytes(rows: list[Row]) -> None:
    seen: set[str] = set()
    distinct = []
    for one in rows:
        distinct.append({**{name: value for name, value in one.items() if name not in seen}, "_ts": 1 / 3})
        seen |= one.keys()
    payloads = [exact(one, "t") for one in distinct]
    joined = json_merge.join_disjoint(payloads, CODEC.cut(payloads))
    assert orjson.loads(joined) == merge.merge(distinct)
    assert json_merge.time_of(joined) == 1 / 3


@given(st.floats(0, 9e9), st.dictionaries(fields, plain_value, max_size=3))
@settings(deadline=None)
def test_the_time_stamp_is_found_without_decoding(time: float, fields_: Row) -> None:
    assert json_merge.time_of(exact({**fields_, "_ts": time}, "t")) == time
