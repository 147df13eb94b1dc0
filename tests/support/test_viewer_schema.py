"""The judge of schemas knows what the viewers read, and a row is held against its schema."""

from __future__ import annotations

import pytest

from tests.support.row_types import mismatches
from tests.support.viewer_schema import violations

Shape = dict[str, object]

SCALARS: list[Shape] = [{"type": "boolean"}, {"type": "number"}, {"type": "integer"}, {"type": "string"}]
TIME: Shape = {
    "type": "object",
    "title": "time",
    "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
}
CHOICE: Shape = {
    "title": "kind",
    "oneOf": [{"title": "A", "const": 0, "description": "first"}, {"title": "B", "const": 1}],
}
NOTES: Shape = {
    "$schema": "x",
    "$id": "x",
    "title": "x",
    "description": "x",
    "$comment": "x",
    "required": ["x"],
    "additionalProperties": True,
    "patternProperties": {},
    "format": "x",
    "minimum": 0,
    "maximum": 1,
    "minItems": 0,
    "maxItems": 1,
}


def of(field: object) -> Shape:
    return {"type": "object", "properties": {"x": field}}


@pytest.mark.parametrize(
    "field",
    [
        *SCALARS,
        *({"type": "array", "items": item} for item in SCALARS),
        {"type": "array", "items": of({"type": "number"})},
        {"type": "array", "items": of({"type": "string", "contentEncoding": "base64"})},
        {"type": "string", "contentEncoding": "base64"},
        {"type": "string", "enum": ["a", "b"]},
        of({"type": "number"}),
        of(of({"type": "number"})),
        {"type": "number"} | NOTES,
        TIME,
        CHOICE,
    ],
)
def test_a_field_that_the_viewers_read_is_accepted(field: Shape) -> None:
    assert violations(of(field)) == []


@pytest.mark.parametrize(
    "schema", [{"type": "object"}, {"type": "object", "properties": {}}, {"type": "object"} | NOTES]
)
def test_a_root_that_the_viewers_read_is_accepted(schema: Shape) -> None:
    assert violations(schema) == []


@pytest.mark.parametrize(
    "schema",
    [
        {},
        True,
        [],
        {"type": "array", "items": {"type": "number"}},
        {"properties": {}},
        {"type": ["object"]},
        {"$ref": "#"},
        None,
    ],
)
def test_a_root_that_is_no_object_loses_the_topic(schema: object) -> None:
    [violation] = violations(schema)
    assert violation.startswith("$ ")


@pytest.mark.parametrize(
    "field",
    [
        {"type": ["number", "null"]},
        {"type": "null"},
        {},
        True,
        {"anyOf": [{"type": "number"}]},
        {"allOf": [{"type": "number"}]},
        {"oneOf": [{"type": "number"}, {"type": "string"}]},
        {"oneOf": [{"title": "A", "const": "a"}]},
        {"oneOf": [{"title": "A", "const": True}]},
        {"oneOf": [{"const": 1}]},
        {"oneOf": []},
        {"enum": ["a"]},
        {"$ref": "#/definitions/x"},
        {"type": "number", "$ref": "#"},
        {"type": "array"},
        {"type": "array", "items": {}},
        {"type": "array", "items": True},
        {"type": "array", "items": [{"type": "number"}]},
        {"type": "array", "items": {"type": "array", "items": {"type": "number"}}},
        {"type": "array", "items": {"type": "string", "contentEncoding": "base64"}},
        {"type": "array", "items": {"type": ["number", "null"]}},
        {"type": "array", "items": {"type": "object"}},
        {"type": "array", "prefixItems": [], "items": {"type": "number"}},
        {"type": "string", "contentEncoding": "base16"},
        {"type": "string", "enum": "a"},
        {"properties": {"x": {"type": "number"}}},
        {"type": "object"},
        {"type": "object", "properties": []},
        {"type": "number", "pattern": "untried"},
    ],
)
def test_a_field_that_the_viewers_do_not_read_loses_the_topic_at_any_depth(field: object) -> None:
    for schema, path in [
        (of(field), "$.x"),
        (of(of(field)), "$.x.x"),
        (of({"type": "array", "items": of(field)}), "$.x[].x"),
    ]:
        found = violations(schema)
        assert found
        assert all(violation.startswith(path) for violation in found)


@pytest.mark.parametrize(
    ("value", "field"),
    [
        (None, {"type": "number"}),
        (1, {"type": "number"}),
        (1.5, {"type": "number"}),
        (2**60, {"type": "integer"}),
        (True, {"type": "boolean"}),
        ("a", {"type": "string"}),
        ("a", {"type": "string", "enum": ["a"]}),
        ("YQ==", {"type": "string", "contentEncoding": "base64"}),
        ([], {"type": "array", "items": {"type": "number"}}),
        ([1, None, 2.5], {"type": "array", "items": {"type": "number"}}),
        ([{"x": 1}, {}], {"type": "array", "items": of({"type": "integer"})}),
        ({"sec": 1, "nsec": 2}, TIME),
        (1, CHOICE),
    ],
)
def test_a_value_that_its_schema_promises_matches(value: object, field: Shape) -> None:
    assert list(mismatches({"x": value, "beside": object()}, of(field))) == []


@pytest.mark.parametrize(
    ("value", "field", "path"),
    [
        ("1", {"type": "number"}, "$.x"),
        (True, {"type": "number"}, "$.x"),
        (1.0, {"type": "integer"}, "$.x"),
        (False, {"type": "integer"}, "$.x"),
        (0, {"type": "boolean"}, "$.x"),
        (1, {"type": "string"}, "$.x"),
        ("c", {"type": "string", "enum": ["a"]}, "$.x"),
        ("a", {"type": "string", "contentEncoding": "base64"}, "$.x"),
        (1, {"type": "array", "items": {"type": "number"}}, "$.x"),
        ([1, 0.5], {"type": "array", "items": {"type": "integer"}}, "$.x[1]"),
        ([[1]], {"type": "array", "items": {"type": "number"}}, "$.x[0]"),
        ([{"x": 0.5}], {"type": "array", "items": of({"type": "integer"})}, "$.x[0].x"),
        ([1], of({"type": "number"}), "$.x"),
        ({"sec": 0.5, "nsec": 2}, TIME, "$.x.sec"),
        ("A", CHOICE, "$.x"),
    ],
)
def test_a_value_that_contradicts_its_schema_is_found_at_its_path(value: object, field: Shape, path: str) -> None:
    [mismatch] = mismatches({"x": value}, of(field))
    assert mismatch.startswith(f"{path} is ")
