"""Every payload of a topic with a JSON Schema fits it, by the judgement of another validator; other rows are refused."""

from __future__ import annotations

import enum
import json
import math
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ml_dash_mcap.codecs.given.given_json import GivenJsonCodec
from ml_dash_mcap.codecs.given.schema_source import given_schema
from ml_dash_mcap.errors import EncodingError, FieldError, OptionError

ARM: dict[str, Any] = {
    "type": "object",
    "title": "Arm",
    "properties": {
        "q": {"type": "array", "items": {"type": "number"}, "minItems": 2},
        "mode": {"enum": ["idle", "run", None]},
        "tool": {"$ref": "#/$defs/tool"},
        "step": {"type": "integer", "minimum": 0},
    },
    "required": ["q"],
    "additionalProperties": False,
    "$defs": {"tool": {"type": "object", "properties": {"name": {"type": "string"}}, "required": ["name"]}},
}


def codec_of(schema: Any = ARM) -> GivenJsonCodec:
    given = given_schema(schema)
    assert given is not None and isinstance(given.codec, GivenJsonCodec)
    return given.codec


def stored(schema: Any = ARM, **row: Any) -> Any:
    """The payload of a row, as others read it."""
    payload = json.loads(codec_of(schema).encode({**row, "_ts": 1.0}, "t"))
    jsonschema.validate(payload, schema)
    return payload


def refused(schema: Any = ARM, **row: Any) -> str:
    with pytest.raises(FieldError) as caught:
        codec_of(schema).encode({**row, "_ts": 1.0}, "arm")
    return str(caught.value).removeprefix("append() on topic 'arm': ")


class Mode(enum.Enum):
    RUN = "run"


def test_a_row_is_stored_as_it_is_without_a_time_stamp_in_it() -> None:
    assert stored(q=[1, 2.5], mode="run", step=3) == {"q": [1, 2.5], "mode": "run", "step": 3}
    assert stored(q=(1, 2)) == {"q": [1, 2]}
    assert stored(q=np.array([1.0, 2.0]), step=np.int32(3), mode=Mode.RUN) == {
        "q": [1.0, 2.0],
        "step": 3,
        "mode": "run",
    }
    assert stored(q=[0, 0], mode=None, tool={"name": "null"}) == {"q": [0, 0], "mode": None, "tool": {"name": "null"}}


def test_large_arrays_are_lists_as_the_schema_says() -> None:
    assert stored(q=np.arange(100_000.0)) == {"q": list(range(100_000))}


@pytest.mark.parametrize(
    ("row", "text"),
    [
        ({}, '"q" is a required property'),
        ({"q": [1.0, "a"]}, """field 'q[1]': "a" is not of type "number\""""),
        ({"q": [1.0]}, "field 'q': [1.0] has less than 2 items"),
        ({"q": [1, 2], "speed": 1}, "Additional properties are not allowed ('speed' was unexpected)"),
        ({"q": [1, 2], "tool": {}}, "field 'tool': \"name\" is a required property"),
        ({"q": [1, 2], "tool": {"name": 3}}, "field 'tool.name': 3 is not of type \"string\""),
        ({"q": [1, 2], "step": 1.5}, "field 'step': 1.5 is not of type \"integer\""),
        ({"q": [1, 2], "step": -1}, "field 'step': -1 is less than the minimum of 0"),
        ({"q": [1, 2], "mode": "off"}, "field 'mode': \"off\" is not one of"),
        ({"q": [1, 2], "step": None}, "field 'step': null is not of type \"integer\""),
    ],
)
def test_a_row_that_does_not_fit_is_refused_with_the_place_in_it(row: dict[str, Any], text: str) -> None:
    assert refused(**row).startswith(f"the row does not fit the schema: {text}")
    assert not list(jsonschema.Draft202012Validator(ARM).iter_errors({"q": [1, 2]}))
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(row, ARM)


def test_several_faults_of_a_row_are_named_at_once() -> None:
    text = refused(q=[1, 2], step="x", tool=5)
    assert "field 'step': " in text and "field 'tool': " in text


def test_long_values_are_cut_in_the_message() -> None:
    assert len(refused(q=["x" * 10_000, 1])) < 500


def test_values_that_json_does_not_have_are_kept_where_the_schema_lets_them() -> None:
    free = {"type": "object"}
    codec = codec_of(free)
    for row in ({"x": math.nan}, {"x": b"ab"}, {"x": [1.0, -math.inf]}):
        payload = codec.encode({**row, "_ts": 1.0}, "t")
        jsonschema.validate(json.loads(payload), free)
        assert str(codec.decode(payload)) == str(row)
    assert "field 'q[1]': null is not of type \"number\"" in (text := refused(q=[1.0, math.nan]))
    assert "(JSON has no NaN: it is null or base64 text there, and '_exact' tells what it was)" in text
    assert "('_exact' was unexpected) (JSON has no bytes: " in refused(
        {**ARM, "required": []}, mode=None, tool=None, q=b"a"
    )


def test_what_has_no_json_at_all_is_an_error_as_for_other_rows() -> None:
    assert refused(q={1.0, 2.0}).startswith(
        "field 'q' holds a builtins.set, which cannot be stored; pass list(...) of it"
    )


JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**31), 2**31)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(st.sampled_from(["q", "mode", "tool", "step", "x"]), JSON))
def test_two_validators_agree_about_every_row(row: dict[str, Any]) -> None:
    try:
        payload = codec_of().encode({**row, "_ts": 1.0}, "t")
    except FieldError:
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(row, ARM)
    else:
        jsonschema.validate(json.loads(payload), ARM)
        assert json.loads(payload) == row


def test_the_text_of_the_schema_is_what_was_given() -> None:
    given = given_schema(ARM)
    assert given is not None and json.loads(given.data) == ARM and given.name == "Arm"
    assert given == given_schema(dict(ARM)) == given_schema(ARM, "json")


@pytest.mark.parametrize(
    ("schema", "error", "text"),
    [
        ({"type": "array"}, EncodingError, "has the type 'array', but a row is an object"),
        ({"type": ["array", "null"]}, EncodingError, "a row is an object"),
        (
            {"properties": {"q": {"type": "nubmer"}}},
            EncodingError,
            r"cannot be used: properties.q.type: \"nubmer\" is not",
        ),
        ({"$ref": "#/$defs/none"}, EncodingError, "cannot be used: Pointer '/\\$defs/none' does not exist"),
        ({"properties": {"a": {"pattern": "("}}}, EncodingError, "cannot be used"),
        ({"x": {1}}, EncodingError, "cannot be written as JSON"),
        (ARM | {"title": 5}, EncodingError, "cannot be used: title: 5 is not of type"),
    ],
)
def test_what_is_no_schema_of_rows_is_refused(schema: Any, error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        given_schema(schema)


def test_nothing_is_fetched_for_a_schema(tmp_path: Any) -> None:
    (tmp_path / "s.json").write_text("{}")
    for address in ("http://127.0.0.1:9/s.json", (tmp_path / "s.json").as_uri()):
        with pytest.raises(EncodingError, match=r"lies outside of the schema, and is not fetched; put it under \$defs"):
            given_schema({"type": "object", "properties": {"a": {"$ref": address}}})


def test_a_json_schema_and_another_encoding_contradict_each_other() -> None:
    with pytest.raises(OptionError, match="schema='Arm' and encoding='cbor' contradict each other"):
        given_schema(ARM, "cbor")
