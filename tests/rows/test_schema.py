"""A schema stays within what viewers read, and says of the rows what that subset can say."""

from __future__ import annotations

import math
from typing import Any

import orjson
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ml_dash_mcap.rows import schema
from ml_dash_mcap.rows.value_shapes import of_value, of_values
from tests.support.case_ids import stable_repr
from tests.support.examples import examples
from tests.support.row_types import mismatches
from tests.support.viewer_schema import violations

keys = st.sampled_from(["a", "b", "q1", "q2", "", "properties", "type", "items", "$ref", "enum", "\u00e4"])
scalars = st.one_of(
    st.none(), st.booleans(), st.integers(-9, 9), st.floats(), st.text(max_size=3), st.binary(max_size=3)
)
values = st.recursive(
    scalars, lambda one: st.lists(one, max_size=3) | st.dictionaries(keys, one, max_size=3), max_leaves=8
)
rows = st.builds(lambda row: {**row, "_ts": 1.0}, st.dictionaries(keys, values, max_size=4))


def as_json(value: Any) -> Any:
    """A value as it stands in the payload."""
    if isinstance(value, bytes):
        return "AAAA"
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {name: as_json(inner) for name, inner in value.items()}
    return [as_json(inner) for inner in value] if isinstance(value, list) else value


@given(st.lists(rows, max_size=5))
@settings(deadline=None, max_examples=examples(150))
def test_a_schema_is_within_the_viewers_subset_and_covers_its_rows(listed: list[dict[str, Any]]) -> None:
    said = schema.to_json(of_values(listed), "topic")
    assert violations(said) == []
    for row in listed:
        assert list(mismatches(as_json(row), said)) == []


@given(st.lists(rows, max_size=5))
@settings(deadline=None)
def test_what_a_coarse_look_leaves_out_no_schema_tells(listed: list[dict[str, Any]]) -> None:
    coarse, whole = of_values(listed, is_coarse=True), of_values(listed)
    assert schema.to_json(coarse, "t") == schema.to_json(whole, "t")


@given(st.lists(rows, max_size=5))
@settings(deadline=None)
def test_a_schema_describes_a_shape_that_has_this_schema(listed: list[dict[str, Any]]) -> None:
    said = schema.to_json(of_values(listed), "t")
    assert schema.to_json(schema.of_json(said), "t") == said


@given(st.lists(rows, max_size=5), st.randoms())
@settings(deadline=None)
def test_the_order_of_the_rows_does_not_matter(listed: list[dict[str, Any]], chance: Any) -> None:
    shuffled = list(listed)
    chance.shuffle(shuffled)
    assert schema.to_json(of_values(listed), "t") == schema.to_json(of_values(shuffled), "t")


@pytest.mark.parametrize(
    ("seen", "said"),
    [
        ([1, 2], {"type": "integer"}),
        ([1, 0.5], {"type": "number"}),
        ([math.nan], {"type": "number"}),
        ([None, 1], {"type": "integer"}),
        ([True], {"type": "boolean"}),
        (["a"], {"type": "string"}),
        ([b"a"], {"type": "string", "contentEncoding": "base64"}),
        ([[1], [2, 0.5]], {"type": "array", "items": {"type": "number"}, "minItems": 1, "maxItems": 2}),
        ([[], [1]], {"type": "array", "items": {"type": "integer"}, "minItems": 0, "maxItems": 1}),
        ([[None, True]], {"type": "array", "items": {"type": "boolean"}, "minItems": 2, "maxItems": 2}),
        ([{"x": 1}, {"y": "a"}], {"type": "object", "properties": {"x": {"type": "integer"}, "y": {"type": "string"}}}),
        (
            [[{"x": 1}, {"x": 0.5}]],
            {
                "type": "array",
                "items": {"type": "object", "properties": {"x": {"type": "number"}}},
                "minItems": 2,
                "maxItems": 2,
            },
        ),
        ([None], None),
        ([[]], None),
        ([[None]], None),
        ([1, "a"], None),
        ([True, 1], None),
        (["a", b"a"], None),
        ([[1], 1], None),
        ([[[1]]], None),
        ([[b"a"]], None),
        ([[1, "a"]], None),
    ],
    ids=stable_repr,
)
def test_what_the_subset_can_say_is_said_and_the_rest_left_out(seen: list[Any], said: Any) -> None:
    found = schema.to_json(of_values([{"v": value, "_ts": 1.0} for value in seen]), "t")
    expected = {} if said is None else {"v": said}
    assert found["properties"] == {**expected, "_ts": {"type": "number"}}


def test_a_topic_with_very_many_fields_has_a_schema_of_bounded_size() -> None:
    learnt = schema.TopicShape()
    learnt.add(of_value({f"field{number}": number for number in range(10_000)}))
    learnt.add(of_value({f"x{number}": {"y": 1} for number in range(9000)}))
    said = schema.to_json(learnt.shape, "t")
    assert violations(said) == []
    assert len(orjson.dumps(said)) < 1_000_000
    assert said["properties"]["_ts"] == {"type": "number"}
