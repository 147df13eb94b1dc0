"""Many rows of one time that merge at once become, byte for byte, what they become group by group."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ml_dash_mcap.capture.merge_block import merge_same_time
from ml_dash_mcap.codecs import cbor, json, protobuf
from ml_dash_mcap.codecs.codec import UNKNOWN_FORM, Codec
from ml_dash_mcap.mcap.message_records import MESSAGE_HEAD_BYTES, message
from ml_dash_mcap.mcap.row_arrays import Rows
from tests.support.examples import examples

Row = dict[str, Any]
Appended = tuple[int, Row, float]  # channel id, fields, time stamp

CODECS: dict[str, Callable[[], Codec]] = {
    "json": lambda: json.CODEC,
    "cbor": lambda: cbor.CODEC,
    "protobuf": lambda: protobuf.ProtobufCodec("topic"),
}

VALUES = st.one_of(
    st.integers(-3, 300),
    st.floats(),
    st.none(),
    st.text(max_size=4),
    st.sampled_from(['"_ts":', ',"_ts":1.0}', "}{"]),
    st.lists(st.floats(), max_size=4),
    st.dictionaries(st.sampled_from(["_ts", "x"]), st.integers(0, 9), max_size=2),
)
FIELDS = st.dictionaries(st.sampled_from("abcdef"), VALUES, max_size=3)
TIMES = st.sampled_from([0.0, 1.0, math.nextafter(1.0, 2), 1 / 3, 2.5, 1e9 / 3, 5e-324, 1.5e-10])
ROWS = st.lists(st.tuples(st.sampled_from([1, 2, 7]), FIELDS, TIMES), max_size=40)
THIRDS = st.lists(st.sampled_from([{"a": 1.5}, {"b": [1.0, 2.0]}, {"c": "x", "d": None}]), max_size=3)


def laid_out(appended: list[Appended], codecs: dict[int, Codec]) -> Rows:
    records = [
        message(channel, round(time_s * 1e9), codecs[channel].encode({**fields, "_ts": time_s}, "topic"))
        for channel, fields, time_s in appended
    ]
    lengths = np.array([len(record) for record in records], np.int64)
    ends = np.cumsum(lengths)
    return Rows(
        np.frombuffer(bytearray(b"".join(records)), np.uint8),
        ends - lengths,
        ends,
        np.array([channel for channel, _, _ in appended], np.int64),
        np.array([round(time_s * 1e9) for _, _, time_s in appended], np.int64),
    )


def merged_one_by_one(
    rows: Rows, codecs: dict[int, Codec], forms: list[int], keys: list[frozenset[str]]
) -> list[bytes]:
    """Return the records after merging each group by itself."""
    records: dict[int, bytes] = {
        row: rows.data[rows.starts[row] : rows.ends[row]].tobytes() for row in range(len(rows))
    }
    groups: dict[tuple[int, int, float], list[int]] = {}
    for row in range(len(rows)):
        channel, time_ns = int(rows.channels[row]), int(rows.times[row])
        if channel in codecs:
            groups.setdefault((channel, time_ns, codecs[channel].time_of(rows.payload(row))), []).append(row)
    for (channel, time_ns, _), same in groups.items():
        if len(same) > 1:
            codec, payloads = codecs[channel], [rows.payload(row) for row in same]
            names = [name for row in same for name in keys[row] if name != "_ts"]
            are_disjoint = len(names) == len(set(names)) and all(forms[row] != UNKNOWN_FORM for row in same)
            joined = codec.join_disjoint(payloads, codec.cut(payloads)) if are_disjoint else codec.join(payloads)
            for row in same[1:]:
                del records[row]
            records[same[0]] = message(channel, time_ns, joined)
    return [records[row] for row in sorted(records)]


def check(encoding: str, appended: list[Appended], unknown: set[int]) -> None:
    codecs = {1: CODECS[encoding](), 2: CODECS[encoding](), 7: CODECS["json"]()}
    rows = laid_out(appended, codecs)
    merging = {number: codec for number, codec in codecs.items() if number != 2}
    keys = [codecs[channel].keys_of(rows.payload(row)) for row, (channel, _, _) in enumerate(appended)]
    distinct = list(dict.fromkeys(keys))
    forms = [UNKNOWN_FORM if row in unknown else distinct.index(names) for row, names in enumerate(keys)]
    expected = merged_one_by_one(rows, merging, forms, keys)
    notes: list[tuple[int, list[int], bool]] = []
    merged = merge_same_time(
        rows,
        merging,
        np.array(forms, np.int32),
        lambda channel, form: distinct[form],
        lambda *note: notes.append(note),
    )
    assert [merged.data[a:b].tobytes() for a, b in zip(merged.starts, merged.ends, strict=True)] == expected
    assert merged.data.tobytes() == b"".join(expected)
    lengths = [int.from_bytes(record[1:9], "little") + 9 for record in expected]
    assert (merged.ends - merged.starts).tolist() == lengths
    assert merged.channels.tolist() == [int.from_bytes(record[9:11], "little") for record in expected]
    assert merged.times.tolist() == [int.from_bytes(record[15:23], "little") for record in expected]
    assert sum(len(numbers) - 1 for _, numbers, _ in notes) == len(rows) - len(merged)
    for channel, numbers, _ in notes:
        assert {appended[number][0] for number in numbers} == {channel}
        assert len({appended[number][2] for number in numbers}) == 1


@pytest.mark.parametrize("encoding", CODECS)
@settings(deadline=None, max_examples=examples(200))
@given(appended=ROWS, unknown=st.sets(st.integers(0, 39), max_size=3))
@example(appended=[(1, {"a": 1}, 1.0), (1, {"b": 2}, 1.0), (1, {"c": 3}, math.nextafter(1.0, 2))], unknown=set())
@example(appended=[(1, {"a": 1}, 1.0), (1, {"a": 2}, 1.0), (1, {"b": 2}, 2.5), (1, {"c": 2}, 2.5)], unknown=set())
@example(appended=[(1, {}, 1.0), (1, {}, 1.0), (7, {}, 1.0), (1, {}, 1.0)], unknown=set())
@example(appended=[(1, {"a": 1}, 1.0), (7, {"a": 1}, 1.0), (1, {"b": 1}, 1.0), (7, {"b": 1}, 1.0)], unknown=set())
def test_a_block_of_any_rows_merges_as_each_group_does(
    encoding: str, appended: list[Appended], unknown: set[int]
) -> None:
    if appended:
        check(encoding, appended, unknown)


@pytest.mark.parametrize("encoding", CODECS)
@settings(deadline=None, max_examples=examples(60))
@given(ticks=st.lists(st.tuples(THIRDS, st.booleans()), min_size=1, max_size=15))
def test_rows_of_a_loop_merge_as_each_group_does(encoding: str, ticks: list[tuple[list[Row], bool]]) -> None:
    appended = [
        (channel, fields, number / 7)
        for number, (thirds, is_mixed) in enumerate(ticks)
        for fields in thirds
        for channel in ((1, 7) if is_mixed else (1,))
    ]
    if appended:
        check(encoding, appended, set())


def test_more_fields_than_bits_of_a_number_are_told_apart() -> None:
    appended = [(1, {f"f{number}": number}, 1.0) for number in range(200)]
    check("json", [*appended, (1, {"g": 1}, 2.0), (1, {"f199": 0}, 2.0)], set())
    check("json", [*appended, (1, {"f0": 1}, 1.0)], set())
    check("json", [(1, {f"f{number}": number}, number // 2) for number in range(5000)], set())


def test_three_equal_fields_are_not_taken_for_one() -> None:
    """Their bits would add up to that of one field if the sum ran over."""
    check("json", [(1, {f"f{n}": n for n in range(31)}, 1.0), *[(1, {"f31": n}, 1.0) for n in range(3)]], set())


def test_a_time_stamp_that_is_not_where_rows_have_theirs_is_left_to_the_slower_way() -> None:
    odd = b'{"a":1,"_ts":1.0' + b" " * 40 + b"}"
    records = [message(1, 10**9, odd), message(1, 10**9, b'{"b":1,"_ts":1.0}')]
    ends = np.cumsum([len(record) for record in records])
    data = np.frombuffer(bytearray(b"".join(records)), np.uint8)
    starts = ends - [len(record) for record in records]
    assert json.CODEC.cuts(data, starts + MESSAGE_HEAD_BYTES, ends) is None
    rows = Rows(data, starts, ends, np.array([1, 1]), np.array([10**9, 10**9]))
    keys = [frozenset({"a", "_ts"}), frozenset({"b", "_ts"})]
    merged = merge_same_time(rows, {1: json.CODEC}, np.array([0, 1], np.int32), lambda channel, form: keys[form])
    assert merged.payload(0) == b'{"a":1,"b":1,"_ts":1.0' + b" " * 40 + b"}"
