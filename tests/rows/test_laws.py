"""Laws of rows: what is encoded comes back, merging is associative and last-wins, schemas cover what they can say."""

from __future__ import annotations

import json
import math
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ml_dash_mcap import Recorder, clock
from ml_dash_mcap.codecs.json_bones import Bones
from ml_dash_mcap.codecs.json_guess import guess
from ml_dash_mcap.codecs.json_skeleton import Skeletons
from ml_dash_mcap.rows.json_text import exact, restore
from ml_dash_mcap.rows.schema import to_json
from ml_dash_mcap.rows.value_shapes import of_values
from tests.support import disk
from tests.support.examples import examples
from tests.support.viewer_schema import violations

TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**63), 2**64 - 1),
    st.floats(),
    TEXT,
    st.binary(max_size=8),
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(TEXT, inner, max_size=4)),
    max_leaves=8,
)
NAMES = st.sampled_from(["q", "q1", "q2", "pose", "a/b", "ab", "x-1", 'say "hi"', "é", "joint[0]", "joint[1]", "~"])
FIELDS = st.dictionaries(st.one_of(NAMES, TEXT), VALUES, max_size=5).filter(
    lambda row: not {"_ts", "_exact"} & set(row)
)


def encode(fields: dict[str, Any], time_s: float = 1.5) -> bytes:
    return exact({**fields, "_ts": time_s}, "topic")


def decode(payload: bytes) -> dict[str, Any]:
    return restore(orjson.loads(payload))


def same(left: Any, right: Any) -> bool:
    """Equal to the last bit: types, NaN and the sign of zero included."""
    return repr(left) == repr(right)


def test_rows_of_one_nanosecond_and_two_times_are_told_apart(tmp_path: Path) -> None:
    after = math.nextafter(1.0, 2)
    with Recorder(tmp_path) as recorder:
        recorder.topic("a").append(a=1, _ts=1.0).append(a=2, _ts=after).append(a=3, b=4, _ts=1.0)
    assert [json.loads(payload) for _, payload in disk.payloads(tmp_path)] == [
        {"a": 3, "b": 4, "_ts": 1.0},
        {"a": 2, "_ts": after},
    ]


def block_of(payloads: list[bytes]) -> Bones:
    """Lay rows out as a block does, each behind 31 bytes that are none of its text."""
    data, starts, ends = b"", [], []
    for number, payload in enumerate(payloads):
        data += bytes([34, 92, 58, 5, number % 256] * 6 + [7])
        starts.append(len(data))
        data += payload
        ends.append(len(data))
    return Bones(np.frombuffer(data, np.uint8), np.array(starts), np.array(ends), 31)


@settings(max_examples=examples(150))
@given(st.lists(st.lists(FIELDS, min_size=1, max_size=6), min_size=1, max_size=4))
def test_the_shape_learned_from_skeletons_is_the_shape_of_all_rows(blocks: list[list[dict[str, Any]]]) -> None:
    skeletons, every = Skeletons(), []
    for rows in blocks:
        payloads = [encode(row) for row in rows]
        bones = block_of(payloads)
        guessed = guess(bones, np.ones(len(rows), np.int64), {1: skeletons})
        forms = skeletons.classify(bones, np.arange(len(rows))) if guessed is None else guessed
        for row, form in zip(rows, forms.tolist(), strict=True):
            every.append({**row, "_ts": 1.5})
            assert skeletons.forms[form].keys - {"_exact"} == {*row, "_ts"}
    assert to_json(skeletons.shape, "t") == to_json(of_values(every), "t")


@given(st.lists(FIELDS, min_size=1, max_size=6))
def test_a_schema_stays_within_what_viewers_know(rows: list[dict[str, Any]]) -> None:
    assert violations(to_json(of_values([{**row, "_ts": 1.5} for row in rows]), "topic")) == []


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ([1, 2], {"type": "integer"}),
        ([1, 0.5], {"type": "number"}),
        ([116, 1e16], {"type": "number"}),
        ([1.0, None], {"type": "number"}),
        ([True, False], {"type": "boolean"}),
        (["x7", "y"], {"type": "string"}),
        ([b"x"], {"type": "string", "contentEncoding": "base64"}),
        ([[1.0], [2.0, 3.0]], {"type": "array", "items": {"type": "number"}, "minItems": 1, "maxItems": 2}),
        ([[], [1]], {"type": "array", "items": {"type": "integer"}, "minItems": 0, "maxItems": 1}),
        ([{"p": 1}], {"type": "object", "properties": {"p": {"type": "integer"}}}),
        ([1, "x"], None),
        ([[[1.0]]], None),
        ([None], None),
        ([[]], None),
        ([[b"x"]], None),
    ],
)
def test_a_field_is_said_in_the_subset_or_left_out(values: list[Any], said: dict[str, Any] | None) -> None:
    payloads = [encode({"f": value}) for value in values]
    skeletons = Skeletons()
    skeletons.classify(block_of(payloads), np.arange(len(payloads)))
    assert to_json(skeletons.shape, "t")["properties"].get("f") == said


@given(st.floats(0, clock.END_S, exclude_max=True))
def test_a_time_is_rounded_to_the_nearest_nanosecond(seconds: float) -> None:
    assert abs(clock.to_nanoseconds(seconds) - Fraction(seconds) * 10**9) <= Fraction(1, 2) + Fraction(1, 10**6)
