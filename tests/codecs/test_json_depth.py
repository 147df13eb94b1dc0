"""How deep JSON is nested, told for one payload and for many."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from ml_dash_mcap.codecs.json_depth import are_within, is_within

payloads = st.recursive(
    st.sampled_from(["1", '"[{"', '"\\"["', "null"]),
    lambda inner: (
        st.lists(inner, max_size=3).map(lambda parts: "[" + ",".join(parts) + "]")
        | inner.map(lambda part: '{"a":' + part + "}")
    ),
    max_leaves=12,
).map(str.encode)


@given(st.lists(payloads, max_size=6), st.integers(0, 6))
def test_many_are_within_a_depth_if_each_of_them_is(found: list[bytes], most: int) -> None:
    assert are_within(found, most) == all(is_within(one, most) for one in found)
