"""What each kind of values becomes in every format: one table of all rules.

Those who render shapes lie in several rooms; here it can be seen that they agree.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import pyarrow as pa
import pytest

from ml_dash_mcap.formats.ros.messages import lossless
from ml_dash_mcap.inspect.field_shapes import of_shape
from ml_dash_mcap.rows import schema
from ml_dash_mcap.rows.arrow_types import stored_type, type_of
from ml_dash_mcap.rows.element_columns import lengths_of
from ml_dash_mcap.rows.value_shapes import of_value, of_values

JSON = pa.string()
NUMBER, INTEGER, TEXT = {"type": "number"}, {"type": "integer"}, {"type": "string"}


def lists(items: Any, shortest: int, longest: int) -> dict[str, Any]:
    return {"type": "array", "items": items, "minItems": shortest, "maxItems": longest}


def dicts(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


class Rendered(NamedTuple):
    """What a field with some values is."""

    schema: Any
    """In the topic's JSON Schema; None where it is left out."""
    arrow: pa.DataType | None
    """In a table; None where it is JSON text."""
    stored: pa.DataType
    """In a Parquet file."""
    ros: tuple[str, tuple[int, ...] | None]
    """Kind and shape of the field of a ROS message."""
    cells: tuple[int, ...] | None
    """How many cells it takes in a CSV file, () for one; None before it has had a value."""


def all_in(schema_: Any, type_: pa.DataType, ros: str, cells: tuple[int, ...] | None = ()) -> Rendered:
    """A field of single values."""
    return Rendered(schema_, type_, type_, (ros, ()), cells)


def as_text(schema_: Any, cells: tuple[int, ...] | None = ()) -> Rendered:
    """A field that only JSON text holds."""
    return Rendered(schema_, None, JSON, ("json", ()), cells)


DOUBLES, INTS = pa.list_(pa.float64()), pa.list_(pa.int64())
PAIR = pa.list_(pa.float64(), 2)
AB = pa.struct([("a", pa.int64()), ("b", pa.float64())])

RULES: list[tuple[list[Any], Rendered]] = [
    # single values
    ([None], all_in(None, pa.null(), "json", None)),
    ([1, -2], all_in(INTEGER, pa.int64(), "int64")),
    ([1, None], all_in(INTEGER, pa.int64(), "int64")),
    ([1, 0.5], all_in(NUMBER, pa.float64(), "float64")),
    ([math.nan, -math.inf], all_in(NUMBER, pa.float64(), "float64")),
    ([2**53 + 1, 0.5], as_text(NUMBER)),
    ([2**63, 1], all_in(INTEGER, pa.uint64(), "uint64")),
    ([2**63, -1], as_text(INTEGER)),
    ([True], all_in({"type": "boolean"}, pa.bool_(), "bool")),
    ([True, 1], as_text(None)),
    (["a", ""], all_in(TEXT, pa.string(), "string")),
    (["a\0"], all_in(TEXT, pa.string(), "json")),
    (["\ud800"], as_text(TEXT)),
    (["a", 1], as_text(None)),
    ([b"a"], all_in({"type": "string", "contentEncoding": "base64"}, pa.binary(), "bytes")),
    (["a", b"a"], as_text(None)),
    # lists
    ([[]], Rendered(None, pa.list_(pa.null()), pa.list_(pa.null()), ("json", ()), None)),
    ([[1.0, 2.0], [3.0, 4.0]], Rendered(lists(NUMBER, 2, 2), PAIR, PAIR, ("float64", (2,)), (2,))),
    ([[1, 2], [0.5, 1]], Rendered(lists(NUMBER, 2, 2), PAIR, PAIR, ("float64", (2,)), (2,))),
    ([[1.0, 2.0], [3.0]], Rendered(lists(NUMBER, 1, 2), DOUBLES, DOUBLES, ("float64", None), (2,))),
    ([[1.0, 2.0], []], Rendered(lists(NUMBER, 0, 2), DOUBLES, DOUBLES, ("float64", None), (2,))),
    ([[1.0, 2.0], None], Rendered(lists(NUMBER, 2, 2), DOUBLES, DOUBLES, ("float64", (2,)), (2,))),
    ([[1.0, None], [2.0, 3.0]], Rendered(lists(NUMBER, 2, 2), PAIR, PAIR, ("json", ()), (2,))),
    ([["a", "b"]], Rendered(lists(TEXT, 2, 2), pa.list_(pa.string()), pa.list_(pa.string()), ("string", None), (2,))),
    ([[b"a"]], Rendered(None, pa.list_(pa.binary()), pa.list_(pa.binary()), ("json", ()), (1,))),
    ([[1, "a"]], as_text(None, (2,))),
    ([1, [1]], as_text(None)),
    # matrices and ragged lists of lists
    (
        [[[1, 2], [3, 4]]],
        Rendered(None, pa.list_(pa.list_(pa.int64(), 2)), pa.list_(pa.int64(), 4), ("int64", (2, 2)), (2, 2)),
    ),
    ([[[1, 2], [3]]], Rendered(None, pa.list_(INTS), pa.list_(INTS), ("json", ()), (2, 2))),
    # dicts, which stand in lists; others have columns of their own
    ([{}], as_text(dicts())),
    ([{"a": 1, "b": 0.5}], Rendered(dicts(a=INTEGER, b=NUMBER), AB, AB, ("message", ()), ())),
    ([{"a": 1}, {"b": 1}], Rendered(dicts(a=INTEGER, b=INTEGER), None, JSON, ("message", ()), ())),
    (
        [[{"a": 1, "b": 0.5}], []],
        Rendered(lists(dicts(a=INTEGER, b=NUMBER), 0, 1), pa.list_(AB), pa.list_(AB), ("message", None), ()),
    ),
    (
        [[{"a": 1}, {"b": 2}]],
        Rendered(lists(dicts(a=INTEGER, b=INTEGER), 2, 2), None, JSON, ("message", None), ()),
    ),
]


def rendered(values: list[Any]) -> Rendered:
    rows = of_values([{"x": value, "_ts": 1.0} for value in values])
    shape = rows.fields["x"]
    (field,) = lossless.design(rows, "topic", set()).fields
    in_schema = schema.to_json(rows, "topic")["properties"].get("x")
    return Rendered(in_schema, type_of(shape), stored_type(shape), (field.kind, field.shape), lengths_of(shape))


@pytest.mark.parametrize(("values", "expected"), RULES, ids=[repr(values) for values, _ in RULES])
def test_what_values_become_in_each_format(values: list[Any], expected: Rendered) -> None:
    assert rendered(values) == expected


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1, "integer"),
        ([0.5, 1], "number[2]"),
        ([True], "boolean[1]"),
        ([], "any[0]"),
        ([1, None], "any[2]"),
        ([1, "a"], "any[2]"),
        ([[1, 2], [3, 4]], "integer[2,2]"),
        ([[1, 2], [3]], "integer[2,]"),
        ([[[1, 2], [3]], [[4]]], "integer[2,]"),
        ({"a": 1}, "object"),
        ([{"a": 1}], "object[1]"),
    ],
)
def test_a_field_at_a_glance_is_a_word_and_lengths(value: Any, text: str) -> None:
    assert str(of_shape(of_value(value))) == text
