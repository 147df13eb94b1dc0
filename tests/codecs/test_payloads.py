"""Payloads in one array are those of the messages, with blanks between them, however the messages lie in their chunk."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ml_dash_mcap.codecs import payloads
from ml_dash_mcap.codecs.payloads import BLANKS_BEHIND, Payloads
from ml_dash_mcap.mcap.chunk_messages import Messages
from ml_dash_mcap.mcap.message_records import message
from tests.support.examples import examples

CONTENTS = st.lists(st.tuples(st.booleans(), st.binary(max_size=20)), max_size=12)


def chunk_of(contents: list[tuple[bool, bytes]], order: list[int] | None = None) -> Messages:
    """Messages of channel 1 among those of channel 2, in a chunk."""
    records = [message(1 if is_ours else 2, number, payload) for number, (is_ours, payload) in enumerate(contents)]
    ends = np.cumsum([0, *map(len, records)])
    ours = [number for number, (is_ours, _) in enumerate(contents) if is_ours]
    which = np.array(ours if order is None else [ours[at] for at in order], np.intp)
    times = which.astype(np.uint64)
    numbers = np.zeros(len(which), np.uint32)
    return Messages(1, times, times, numbers, ends[which], ends[which + 1], b"".join(records))


@settings(deadline=None, max_examples=examples(200))
@given(st.lists(CONTENTS, max_size=3))
def test_payloads_of_several_chunks_are_those_of_their_messages(chunks: list[list[tuple[bool, bytes]]]) -> None:
    expected = [payload for chunk in chunks for is_ours, payload in chunk if is_ours]
    parts = [payloads.of_messages(chunk_of(chunk)) for chunk in chunks]
    assert [payload for part in parts for payload in part] == expected
    whole = payloads.joined(parts)
    check(whole, expected)
    which = np.flatnonzero(np.arange(len(expected)) % 3 != 1)
    check(whole.pick(which), [expected[at] for at in which.tolist()])
    check(payloads.of_list(expected), expected)


def check(whole: Payloads, expected: list[bytes]) -> None:
    assert list(whole) == expected
    assert len(whole) == len(expected)
    assert [whole[at] for at in range(len(expected))] == expected
    assert whole[1:] == expected[1:]
    assert whole.size == sum(map(len, expected))
    is_between = np.ones(len(whole.data), np.bool_)
    for start, end in zip(whole.starts, whole.ends, strict=True):
        is_between[start:end] = False
    assert set(whole.data[is_between].tolist()) <= set(b" ")
    assert (whole.starts[1:] > whole.ends[:-1]).all()
    assert not expected or len(whole.data) >= whole.ends[-1] + BLANKS_BEHIND


def test_messages_in_any_order_are_taken_in_that_order() -> None:
    contents = [(True, b"a"), (True, b"bc"), (False, b"x"), (True, b"def")]
    parts = payloads.of_messages(chunk_of(contents, [2, 0, 1]))
    check(payloads.joined([parts]), [b"def", b"a", b"bc"])


@pytest.mark.parametrize("is_most", [True, False])
def test_a_chunk_is_held_only_for_messages_that_are_most_of_it(is_most: bool) -> None:
    contents = [(True, b"a" * 50), (True, b"b" * 50), (False, b"x" * (50 if is_most else 5000))]
    messages = chunk_of(contents)
    part = payloads.of_messages(messages)
    assert np.shares_memory(part.data, np.frombuffer(messages.data, np.uint8)) == is_most
    assert len(part.data) < 1000
