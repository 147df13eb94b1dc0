"""Rows of one topic, whatever came before: values of all types under the same keys, by the compiled code too."""

from __future__ import annotations

import enum
import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ml_dash_mcap.codecs.proto.block_forms import ProtobufForms
from ml_dash_mcap.codecs.proto.row_decoder import RowDecoder
from ml_dash_mcap.codecs.protobuf import CODEC
from ml_dash_mcap.errors import FieldError
from ml_dash_mcap.rows.merge import merge
from ml_dash_mcap.rows.plain_row import PlainRow
from tests.codecs.proto.test_descriptors import VALUES, alike
from tests.support.examples import examples

Row = dict[str, Any]


class Text(str):
    """A text that spells itself in another way."""

    __slots__ = ()

    def __str__(self) -> str:
        return "other"

    def encode(self, *args: Any) -> bytes:
        return b"other"


class Mode(enum.Enum):
    IDLE = "idle"
    RUN = 7


class Level(int):
    """An integer of a type of its own."""


PAYLOAD_NAN = struct.unpack("<d", struct.pack("<Q", 0x7FF8_0000_DEAD_BEEF))[0]

ODD = st.sampled_from(
    [
        *(0, 1, True, False, 1.0, -0.0, 0.0, math.nan, math.inf, -math.inf, PAYLOAD_NAN, 5e-324, 2**53, 2**53 + 1),
        *(-(2**53) - 1, 2**63 - 1, 2**63, 2**64 - 1, -(2**63), None, "", "a", b"", b"a", "\u00e9", [], {}, [[]], [{}]),
        *(
            [0.0],
            [0],
            [True],
            [1, 1.5],
            [True, 1],
            [True, 1.0],
            [None],
            [0.5, None],
            ["a", 1],
            [b"a"],
            ["a"],
            ["a", "b"],
        ),
        *([1.5, 2.5], (1.5, 2.5), (1, 2), [[1.0, 2.0]], [[1, 2.0]], [(1.0, 2.0)], ([1.0, 2.0],), [[1.0], [2.0, 3.0]]),
        *([2**63, 1], [2**63, -1], [2**63, 1.5], [2**53 + 1, 0.5], [math.nan, 1], [-0.0, 0], [[True, False]]),
        *(
            {"x": 1},
            {"x": 1.0},
            {"y": 1},
            {"x": None},
            {"x": {"y": 1}},
            {"x": 1, "y": 2},
            {"y": 2, "x": 1},
            {"": {"": 1}},
        ),
        *([{"x": 1}], [{"x": 1.0}, {"x": 2}], [{"x": 1}, {}], [{}, {"y": [1.0]}], [{"x": 1}, 5]),
        *(np.float64(1.5), np.float32(1.1), np.int8(-1), np.uint64(2**64 - 1), np.bool_(True), np.str_("a"), Text("a")),
        *(
            np.zeros(3),
            np.arange(3),
            np.zeros((2, 2), "f4"),
            np.zeros(0),
            np.array(1.5),
            np.array([True]),
            np.zeros((2, 0)),
        ),
        *(
            np.arange(3.0)[::-1],
            np.asfortranarray(np.arange(4.0).reshape(2, 2)),
            np.arange(3, dtype=">i4"),
            np.zeros(5000),
        ),
        *(Mode.IDLE, Mode.RUN, Level(3), [Level(3), 1.5], [np.float64(1.5), 1.0], [Text("a"), "b"], bytearray(b"x")),
    ]
)
ANY = ODD | VALUES
SERIES = st.lists(st.fixed_dictionaries({"a": ANY}, optional={"b": ANY, "a b": ANY}), min_size=1, max_size=8)


def plain(value: Any) -> Any:
    """Return a value as a reader gives it back."""
    if isinstance(value, dict):
        return {key: plain(inner) for key, inner in value.items()}
    return list(map(plain, value)) if isinstance(value, (list, tuple)) else value


def expected(row: Row, time_s: float) -> Row:
    fields: Row = plain(PlainRow("t").row({**row, "_ts": time_s}))
    return fields


@given(rows=SERIES)
@settings(deadline=None, max_examples=examples(400))
@example([{"a": 1}, {"a": 1.5}, {"a": 2}, {"a": True}, {"a": 2**63}, {"a": 2**53 + 1}])
@example([{"a": [1.5, 2.5]}, {"a": [1, 2]}, {"a": [1.5, 2]}, {"a": [1.5]}, {"a": []}, {"a": (1.5, 2.5)}])
@example([{"a": {"x": 1, "y": 2}}, {"a": {"y": 2, "x": 1}}, {"a": {"x": 1}}, {"a": {}}])
@example([{"a": np.zeros(3)}, {"a": np.zeros(3, "f4")}, {"a": np.zeros(3, "i8")}, {"a": [0.0] * 3}])
def test_rows_of_the_same_keys_come_back_whatever_the_types_before_were(rows: list[Row]) -> None:
    codec = CODEC.for_channel("t")
    taken: list[tuple[Row, bytes]] = []
    for time in range(4):  # the second time, code that was compiled for the first may take the row
        for row in rows:
            payload = codec.encode({**row, "_ts": float(time)}, "t")
            taken.append((expected(row, float(time)), payload))
    decode = RowDecoder(codec.layout)
    for row, payload in taken:
        assert alike(decode(payload), row), payload


@given(rows=SERIES)
@settings(deadline=None, max_examples=examples(200))
@example([{"a": 1}, {"a": 1.5}, {"a": None}, {"a": {"x": None}}])
@example([{"a": 1.5}, {"a": 1}])
@example([{"a": {"x": None}}, {"a": 5}, {"b": None}])
@example([{"a": [1, None]}, {"a": [1.0, 2]}, {"a": b""}])
def test_rows_of_one_time_merge_whatever_the_types_of_their_keys_are(rows: list[Row]) -> None:
    codec = CODEC.for_channel("t")
    payloads = [codec.encode({**row, "_ts": 1.5}, "t") for row in rows]
    decode = RowDecoder(codec.layout)
    assert alike(decode(codec.join(payloads)), merge([expected(row, 1.5) for row in rows]))
    half = len(payloads) // 2
    if half:
        parts = [codec.join(payloads[:half]), codec.join(payloads[half:])]
        assert alike(decode(codec.join(parts)), merge([expected(row, 1.5) for row in rows]))


@given(rows=SERIES)
@settings(deadline=None, max_examples=examples(200))
@example([{"a": None}, {"a": 1}])
@example([{"a": 1}, {"a": None}])
@example([{"a": None}, {"a": 1.5, "b": 1}, {"b": 1.5}, {"b": 2}])
def test_rows_whose_forms_have_no_key_in_common_merge_by_their_bytes(rows: list[Row]) -> None:
    codec = CODEC.for_channel("t")
    payloads = [codec.encode({**row, "_ts": 1.5}, "t") for row in rows]
    forms = ProtobufForms()
    forms.add_channel(1, codec)
    decode = RowDecoder(codec.layout)
    keys = [forms.keys_of(1, forms.learn(1, payload)) for payload in payloads]
    for at, first in enumerate(payloads):
        for later, second in enumerate(payloads):
            if keys[at] & keys[later] == {"_ts"}:
                joined = codec.join_disjoint([first, second], codec.cut([first, second]))
                assert alike(decode(joined), merge([expected(rows[at], 1.5), expected(rows[later], 1.5)]))


@pytest.mark.parametrize("value", [{"in": {"\ud800": 1}}, {"in": "\ud800"}, ["\ud800"], [{"in": "\ud800"}], "\ud800"])
def test_text_that_is_no_unicode_is_refused_by_name_and_leaves_no_trace(value: Any) -> None:
    codec = CODEC.for_channel("t")
    for _ in range(3):
        with pytest.raises(
            FieldError, match=r"^append\(\) on topic 't': field 'odd' cannot be stored: [^:]*UTF-8: [^:]*$"
        ):
            codec.encode({"good": 1, "odd": value, "_ts": 1.0}, "t")
    with pytest.raises(FieldError, match="append"):
        codec.encode({"\ud800": 1, "_ts": 1.0}, "t")
    fine = {"good": 1, "odd": "fine", "_ts": 1.0}
    payload = codec.encode(dict(fine), "t")
    assert alike(RowDecoder(codec.layout)(payload), fine)
    read = {"odd": value, "\ud800": [1], "_ts": 1.0}  # as JSON of others may hold
    payload = codec.encode_read(read)
    assert alike(RowDecoder(codec.layout)(payload), read)
    assert codec.schema(None, "t")
