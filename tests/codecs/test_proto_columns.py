"""Protobuf rows as columns: those of the rows, also where bytes are damaged."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ml_dash_mcap.codecs.codec import Columns
from ml_dash_mcap.codecs.proto import form_search
from ml_dash_mcap.codecs.proto.columns import ProtobufColumnReader
from ml_dash_mcap.codecs.proto.row_decoder import RowDecoder
from ml_dash_mcap.rows import table
from ml_dash_mcap.rows.dotted import flatten
from tests.support.examples import examples
from tests.support.protobuf_rows import MUTATIONS, ROBOT, damage, recorded
from tests.support.row_shapes import tables

Row = dict[str, Any]


@pytest.fixture(autouse=True)
def _every_form_becomes_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(form_search, "LEAST_ROWS", 1)


def check(payloads: list[bytes], decoder: RowDecoder, wanted: list[str] | None = None) -> Columns | None:
    """Compare the columns of rows with those of the same rows as Python objects; returns them."""
    read = ProtobufColumnReader(lambda: decoder, wanted).read(payloads)
    if read is None:
        return None
    kept = np.setdiff1d(np.arange(len(payloads)), read.others)
    expected = table.block_of([flatten(decoder.decode(payloads[at]), "_ts") for at in kept.tolist()]).columns
    if wanted is None:
        assert read.arrays.keys() == expected.keys()
        assert [name for name in read.arrays if name != "_ts"] == [name for name in expected if name != "_ts"]
    for name, array in read.arrays.items():
        array.validate(full=True)
        assert array.type == expected[name].array.type, name
        assert repr(array.to_pylist()) == repr(expected[name].array.to_pylist())
        assert not expected[name].is_text
    return read


def test_rows_of_one_form_become_columns() -> None:
    read = check(*recorded([ROBOT] * 40))
    assert read is not None
    assert not len(read.others)
    assert read.arrays["q"].type == pa.list_(pa.float64(), 3)
    assert read.arrays["pose.frame.seq"].to_pylist() == [7] * 40


def test_texts_and_lists_of_any_length_become_columns() -> None:
    rows = [{**ROBOT, "name": "x" * (n % 150), "q": [1.5] * (n % 5 + 1)} for n in range(40)]
    read = check(*recorded(rows))
    assert read is not None
    assert not len(read.others)
    assert read.arrays["q"].type == pa.list_(pa.float64())


def test_rows_that_grow_and_rows_that_lack_fields_become_columns() -> None:
    rows = [{key: value for at, (key, value) in enumerate(ROBOT.items()) if at <= n % 7} for n in range(40)]
    read = check(*recorded(rows))
    assert read is not None
    assert not len(read.others)
    assert read.arrays["on"].null_count > 0


def test_large_arrays_become_columns() -> None:
    rows = [{"image": np.arange(5000, dtype=np.float32).reshape(50, 100) + n} for n in range(20)]
    read = check(*recorded(rows))
    assert read is not None
    assert not len(read.others)


def test_only_columns_that_are_wanted_are_made() -> None:
    read = check(*recorded([ROBOT] * 40), ["q", "pose.frame"])
    assert read is not None
    assert [*read.arrays] == ["q", "pose.frame.id", "pose.frame.seq", "_ts"]


def test_values_that_no_field_expresses_are_left_to_python_objects() -> None:
    rows = [{"q": 1.5, "goal": None if n % 2 else 2.5} for n in range(40)]
    read = check(*recorded(rows))
    assert read is not None
    assert read.others.tolist() == [*range(1, 40, 2)]


def test_exact_columns_are_those_of_one_form_of_plain_values() -> None:
    payloads, decoder = recorded([{"q": [1.5, 2.5], "n": 1, "d": {"s": "a"}}] * 20)
    reader = ProtobufColumnReader(lambda: decoder, None)
    exact = reader.read_exactly(payloads)
    assert exact is not None
    assert exact["d.s"].to_pylist() == ["a"] * 20
    for odd in ({"q": float("nan")}, {"a.b": 1.5}, {"raw": b"a"}, {"q": None}):
        others, decoder = recorded([odd] * 20)
        assert reader.read_exactly(others) is None


@settings(deadline=None, max_examples=examples(400))
@given(rows=tables(max_size=8), wanted=st.none() | st.lists(st.sampled_from(["q", "a.b", "class", "q.q", "header"])))
@example(rows=[{"n": 2**63}, {"n": 1}, {"n": 2**64 - 1}], wanted=None)
@example(rows=[{"n": 2**63}, {"n": -1}], wanted=None)
@example(rows=[{"n": 1}, {"n": 1.5}, {"n": "a"}], wanted=None)
@example(rows=[{"a.b": 1.0}, {"a": {"b": 2.0}}, {"a": {"b": 2.0}, "a.b": 1.0}], wanted=None)
@example(rows=[{"m": [[[1], [2]], [[3], [4]]]}] * 3, wanted=None)
@example(rows=[{"d": [{"a": 1.5, "b": {"c": [1, 2]}}, {"a": 1.5, "b": {"c": [1, 2]}}]}] * 3, wanted=None)
@example(rows=[{"d": [{"a": ["x", "y"]}, {"a": ["z"]}]}] * 3, wanted=None)
@example(rows=[{"q": [1.5]}, {"q": []}, {"q": [2.5]}, {}], wanted=None)
@example(rows=[{"s": "\u00e9"}, {"s": "ab"}, {"s": ""}], wanted=None)
def test_columns_are_those_of_the_rows(rows: list[Row], wanted: list[str] | None) -> None:
    check(*recorded(rows), wanted)


@settings(deadline=None, max_examples=examples(600))
@given(mutations=MUTATIONS, vary=st.booleans())
def test_damaged_rows_never_become_columns_of_other_values(
    mutations: list[tuple[int, float, int, str]], vary: bool
) -> None:
    rows = [{**ROBOT, "name": "x" * (n % 3 if vary else 3)} for n in range(40)]
    payloads, decoder = recorded(rows)
    damage(payloads, mutations)
    check(payloads, decoder)


@settings(deadline=None, max_examples=examples(300))
@given(rows=tables(max_size=5), mutations=MUTATIONS)
def test_damaged_rows_of_any_form_never_become_columns_of_other_values(
    rows: list[Row], mutations: list[tuple[int, float, int, str]]
) -> None:
    payloads, decoder = recorded(rows)
    damage(payloads, mutations)
    check(payloads, decoder)


def test_hostile_lengths_are_refused() -> None:
    payloads, decoder = recorded([{"s": "ab", "q": [1.5]}, {"s": "abc", "q": [2.5]}] * 10)
    tag = payloads[0][:1]
    for length in (b"\xff\xff\xff\xff\x07", b"\xff\xff\xff\xff\xff\xff\xff\xff\xff\x01", b"\xff" * 12):
        for at in (0, 5, 19):
            hostile = [*payloads]
            hostile[at] = tag + length + payloads[at][2:]
            read = check(hostile, decoder)
            assert read is not None
            assert read.others.tolist() == [at]
