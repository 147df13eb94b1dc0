"""Rows of one time stamp are one row: later fields win, in whatever groups they are merged."""

from __future__ import annotations

from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from ml_dash_mcap.rows import merge
from tests.rows.test_json_text import inner, same, scalars

Row = dict[str, Any]

fields = st.sampled_from(["a", "b", "q1", "q2", "a/b", "~", "~1", "", "0"])
values = st.recursive(
    scalars, lambda one: st.lists(one, max_size=3) | st.dictionaries(inner, one, max_size=3), max_leaves=6
)
row = st.dictionaries(fields, values, max_size=4).map(lambda drawn: {**drawn, "_ts": 1.5})
some_rows = st.lists(row, min_size=1, max_size=5)


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
