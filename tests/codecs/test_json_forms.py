"""Rows that go on as before, in any turn, are recognised by their bytes, and no others are taken for them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ml_dash_mcap.codecs import json, json_forms
from ml_dash_mcap.codecs.codec import UNKNOWN_FORM
from ml_dash_mcap.codecs.json_forms import JsonForms
from ml_dash_mcap.codecs.json_skeleton import Skeletons
from ml_dash_mcap.mcap.message_records import message
from ml_dash_mcap.mcap.row_arrays import Rows
from ml_dash_mcap.rows.schema import to_json
from ml_dash_mcap.rows.value_shapes import of_values
from tests.support.examples import examples

Row = dict[str, Any]
Appended = tuple[int, Row]  # channel id, fields

NUMBERS = st.sampled_from([0, 7, -3, 116, 2**40, 0.5, -0.25, 1e-7, 1e16, 1.5e300])
FLOATS = st.floats(-1e6, 1e6)
KINDS = st.sampled_from(
    [
        {"pos": FLOATS},
        {"vel": FLOATS},
        {"q1": FLOATS, "q2": FLOATS},
        {"q1": FLOATS, "q3": FLOATS},
        {"1e5": NUMBERS, "-": FLOATS},
        {"e": st.lists(FLOATS, min_size=2, max_size=2), "n": st.integers(0, 300)},
        {"mode": st.sampled_from(["idle", "grasp", "5", '":1,"q1":']), "q": NUMBERS},
        {"list": st.lists(st.sampled_from(["a1", ":b", "e5"]), max_size=3)},
        {"arm_1": FLOATS, "arm_2": st.none() | FLOATS},
    ]
)
TURNS = st.lists(KINDS, min_size=1, max_size=4)


@st.composite
def in_turn(draw: Any) -> list[Appended]:
    """Draw rows of one or two topics whose kinds come in turn, but for some that come in between or are missing."""
    turns = {channel: draw(TURNS) for channel in draw(st.sampled_from([(1,), (1, 2)]))}
    appended = []
    for number in range(draw(st.integers(1, 60))):
        for channel, turn in turns.items():
            kind = turn[number % len(turn)]
            if draw(st.integers(0, 30)) == 0:
                kind = draw(KINDS)
            if draw(st.integers(0, 30)):
                appended.append((channel, {name: draw(value) for name, value in kind.items()}))
    return appended


def laid_out(appended: list[Appended]) -> Rows:
    payloads = [
        json.CODEC.encode({**fields, "_ts": number / 3}, "topic") for number, (_, fields) in enumerate(appended)
    ]
    records = [message(channel, 0, payload) for (channel, _), payload in zip(appended, payloads, strict=True)]
    lengths = np.array([len(record) for record in records], np.int64)
    ends = np.cumsum(lengths)
    data = np.frombuffer(bytearray(b"".join(records)), np.uint8)
    channels = np.array([channel for channel, _ in appended], np.int64)
    return Rows(data, ends - lengths, ends, channels, np.zeros(len(records), np.int64))


def check(appended: list[Appended]) -> None:
    forms = JsonForms()
    forms.begin_block()
    rows = laid_out(appended)
    for (channel, fields), form in zip(appended, forms.of_rows(rows).tolist(), strict=True):
        assert form == UNKNOWN_FORM or forms.keys_of(channel, form) - {"_exact"} == {*fields, "_ts"}
    for channel in {channel for channel, _ in appended}:
        expected = of_values([{**fields, "_ts": 0.5} for number, fields in appended if number == channel])
        assert to_json(forms.shape_of(channel), "t") == to_json(expected, "t")  # type: ignore[arg-type]


@pytest.mark.parametrize("slice_bytes", [300, 1500, 10**6])
@settings(deadline=None, max_examples=examples(60))
@given(appended=in_turn())
@example(appended=[(1, {"q1": 0.5}), (1, {"q2": 0.5})] * 30 + [(1, {"q1": 0.5}), (1, {"q1": 0.5})])
@example(appended=[(1, {"n": 5})] * 30 + [(1, {"n": 1e16})] + [(1, {"n": 5})] * 30)
@example(appended=[(1, {"s": ["a", 5, ":b"]})] * 20 + [(1, {"s": ["a", 0.5, ":b"]})] * 3)
@example(appended=[(1, {"q1a": 1.5})] * 20 + [(1, {"qa1": 1.5})] * 20)
@example(appended=[(1, {"a": 1.5}), (2, {"a": 1})] * 40)
def test_rows_in_turn_have_the_forms_and_the_shape_that_a_look_at_each_gives(
    slice_bytes: int, appended: list[Appended]
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(json_forms, "_SLICE_BYTES", slice_bytes)
        if appended:
            check(appended)


def test_rows_that_come_in_turn_are_recognised_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    thirds: list[Row] = [{"pos": [0.5, 1.5]}, {"vel": [0.5, 1.5]}, {"q1": 2.5, "mode": "idle"}]
    forms = JsonForms()
    first = [(1, thirds[number % 3]) for number in range(60)] + [(2, {"n": 5})] * 10
    assert UNKNOWN_FORM not in forms.of_rows(laid_out(first))
    monkeypatch.setattr(Skeletons, "classify", None)
    again = [(1, thirds[number % 3]) for number in range(600)]
    mixed = [row for third in again for row in (third, (2, {"n": 123}))]
    keys = [
        forms.keys_of(channel, form) for (channel, _), form in zip(mixed, forms.of_rows(laid_out(mixed)), strict=True)
    ]
    assert keys == [frozenset({*fields, "_ts"}) for _, fields in mixed]


def test_many_topics_that_go_on_as_before_are_recognised_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    rows: list[Appended] = [(channel, {f"q{channel}": channel / 7}) for channel in range(1, 101)]
    forms = JsonForms()
    assert UNKNOWN_FORM not in forms.of_rows(laid_out(rows))
    monkeypatch.setattr(Skeletons, "classify", None)
    assert UNKNOWN_FORM not in forms.of_rows(laid_out(rows * 3))
