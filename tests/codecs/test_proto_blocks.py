"""Protobuf rows decoded many at once: the same as one by one, also where bytes are damaged."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ml_dash_mcap.codecs.payloads import Payloads
from ml_dash_mcap.codecs.proto import form_search, row_decoder
from ml_dash_mcap.codecs.proto.row_decoder import RowDecoder
from ml_dash_mcap.mcap.message_records import MESSAGE_HEAD_BYTES
from tests.support.examples import examples
from tests.support.protobuf_rows import MUTATIONS, ROBOT, damage, recorded
from tests.support.row_shapes import tables

Row = dict[str, Any]


@pytest.fixture(autouse=True)
def _every_form_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(form_search, "LEAST_ROWS", 1)
    monkeypatch.setattr(row_decoder, "LEAST_ROWS", 1)


def in_a_chunk(payloads: list[bytes]) -> Payloads:
    """Lay rows out as they lie in a chunk, each behind the head of its message."""
    head = b"\x05" * MESSAGE_HEAD_BYTES
    ends = np.cumsum([len(payload) + len(head) for payload in payloads])
    starts = ends - [len(payload) for payload in payloads]
    return Payloads(np.frombuffer(head + head.join(payloads), np.uint8), starts, ends, has_heads=True)


def check(payloads: list[bytes], decoder: RowDecoder) -> int:
    """Compare rows that are decoded together with the same rows one by one; returns how many these are."""
    count = compare(payloads, payloads, decoder)
    assert compare(payloads, in_a_chunk(payloads), decoder) == count
    return count


def compare(payloads: list[bytes], laid_out: Sequence[bytes], decoder: RowDecoder) -> int:
    count = 0
    block = decoder.block(laid_out)
    assert block is not None
    expected_start = 0
    for start, end, decode in block.runs(~np.isnan(block.times)):
        assert start == expected_start < end
        expected_start = end
        if decode is None:
            continue
        try:
            rows = decode(start, end)
        except ValueError:  # the rows are decoded one by one then, and one of them fails
            with pytest.raises(ValueError, match=r"."):
                _ = [decoder.decode(payload) for payload in payloads[start:end]]
            continue
        expected = [decoder.decode(payload) for payload in payloads[start:end]]
        assert repr(rows) == repr(expected)
        assert repr(block.times[start:end].tolist()) == repr([row["_ts"] for row in expected])
        count += end - start
    assert expected_start == len(payloads)
    return count


def test_rows_of_one_form_are_decoded_together() -> None:
    assert check(*recorded([ROBOT] * 40)) == 40


def test_rows_whose_texts_and_lists_differ_in_length_are_decoded_together() -> None:
    rows = [{**ROBOT, "name": "x" * (n % 150), "q": [1.5] * (n % 40 + 1)} for n in range(40)]
    assert check(*recorded(rows)) == 40


def test_rows_of_several_forms_in_turn_are_decoded_together() -> None:
    rows = [{key: value for at, (key, value) in enumerate(ROBOT.items()) if at <= n % 7} for n in range(40)]
    assert check(*recorded(rows)) == 40


def test_large_arrays_are_decoded_together() -> None:
    rows = [{"image": np.arange(5000, dtype=np.float32).reshape(50, 100) + n} for n in range(20)]
    assert check(*recorded(rows)) == 20


def test_few_rows_are_decoded_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(row_decoder, "LEAST_ROWS", 16)
    payloads, decoder = recorded([ROBOT] * 15)
    assert decoder.block(payloads) is None


def test_a_decoder_remembers_the_forms_of_blocks_before() -> None:
    payloads, decoder = recorded([ROBOT] * 40)
    others = [b"", b"\x09"]
    for rows, count in ((payloads, 40), (payloads[:1], 1), (others, 0), ([*payloads, *others], 40)):
        assert check(rows, decoder) == count


@settings(deadline=None, max_examples=examples(300))
@given(rows=tables(max_size=8))
@example(rows=[{"m": [[[1], [2]], [[3], [4]]]}] * 3)
@example(rows=[{"d": [{"a": 1.5, "b": {"c": [1, 2]}}, {"a": 1.5, "b": {"c": [1, 2]}}]}] * 3)
@example(rows=[{"q": [1.5]}, {"q": []}, {"q": [2.5]}, {}])
@example(rows=[{"f": [[True, False], [False, True]]}] * 3)
@example(rows=[{"'": {'"': "\\"}}] * 3)
def test_rows_are_those_that_are_decoded_one_by_one(rows: list[Row]) -> None:
    check(*recorded(rows))


@settings(deadline=None, max_examples=examples(600))
@given(mutations=MUTATIONS, vary=st.booleans())
def test_damaged_rows_never_become_other_rows(mutations: list[tuple[int, float, int, str]], vary: bool) -> None:
    payloads, decoder = recorded([{**ROBOT, "name": "x" * (n % 3 if vary else 3)} for n in range(40)])
    check(payloads, decoder)
    damage(payloads, mutations)
    check(payloads, decoder)


@settings(deadline=None, max_examples=examples(300))
@given(rows=tables(max_size=5), mutations=MUTATIONS)
def test_damaged_rows_of_any_form_never_become_other_rows(
    rows: list[Row], mutations: list[tuple[int, float, int, str]]
) -> None:
    payloads, decoder = recorded(rows)
    damage(payloads, mutations)
    check(payloads, decoder)
