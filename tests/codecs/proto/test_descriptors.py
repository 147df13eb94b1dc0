"""The descriptors of rows: every reader of protobuf takes them, its values are where they say, and hostile ones are told."""

from __future__ import annotations

import keyword
import struct
import time
from typing import Any

import numpy as np
import orjson
import pytest
from google.protobuf import descriptor_pb2
from google.protobuf.unknown_fields import UnknownFieldSet
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.records import Schema
from mcap_protobuf.decoder import DecoderFactory

from ml_dash_mcap.capture.topic_names import check_topic
from ml_dash_mcap.codecs.proto import descriptor
from ml_dash_mcap.codecs.proto.layout import ROW, Layout
from ml_dash_mcap.codecs.protobuf import CODEC, ProtobufCodec
from tests.rows.test_json_text import same
from tests.support.examples import examples
from tests.support.proto_rows import OPTION, message_class, option

Row = dict[str, Any]

WORDS = [
    *("Array", "array", "_exact", "_ts", "ts", "exact", "Exact", "_array", "type", "data", "Field", "field", ""),
    *("q", "Q", "_q", "q_", "__q", "q__", "_q_", "q_1", "q1", "_1", "1", "q_float", "q_int", "q_floats", "q_floats_2"),
    *(
        "eePose",
        "ee_pose",
        "EePose",
        "EEPose",
        "a.b",
        "a/b",
        "a b",
        "a-b",
        "a_b",
        "\u00e9",
        "\u00ea",
        "\u4e2d",
        "\U0001f600",
    ),
    *("message", "option", "oneof", "repeated", "package", "int", "double", "virtual", "namespace", "operator", "func"),
    *("DESCRIPTOR", "descriptor", "Clear", "SerializeToString", "Message", "self", "x" * 300, "y" * 1024, "y" * 1025),
    *keyword.kwlist[:8],
]
KEYS = st.sampled_from(WORDS) | st.text(max_size=4)
SCALARS = st.one_of(
    st.floats(), st.integers(-(2**63), 2**64 - 1), st.booleans(), st.text(max_size=3), st.binary(max_size=3), st.none()
)
LISTS = st.one_of(
    st.lists(st.floats(), max_size=3),
    st.lists(st.integers(-(2**63), 2**64 - 1), max_size=3),
    st.lists(st.booleans(), max_size=3),
    st.lists(st.text(max_size=3), max_size=3),
    st.sampled_from([[[1.0, 2.0]], [[1, 2], [3, 4]], [[[True]]], [[1.5, 2]], [1, "a"], [[1.0], []], np.zeros(5000)]),
)
VALUES = st.recursive(
    SCALARS | LISTS,
    lambda one: st.dictionaries(KEYS, one, max_size=4) | st.lists(st.dictionaries(KEYS, one, max_size=3), max_size=3),
    max_leaves=8,
)
NAMES = KEYS.filter(lambda key: key not in ("_ts", "_exact"))  # which append refuses
ROWS = st.lists(st.dictionaries(NAMES, VALUES, max_size=5), min_size=1, max_size=4)
ANY_TOPIC = st.text(max_size=8) | st.sampled_from(
    ["a", "robot/arm", "Array", "/", "//x/", "9", "9/8", "class", "_/_", "x" * 999]
)


def is_topic(name: str) -> bool:
    try:
        check_topic(name)
    except ValueError:
        return False
    return True


TOPICS = ANY_TOPIC.filter(is_topic)


def encoded(codec: Any, row: Row) -> bytes:
    payload: bytes = codec.encode({**row, "_ts": 1.5}, codec.topic)
    return payload


# -- what google's library reads ---------------------------------------------------------------------------------------


@given(
    topic=TOPICS, rows=ROWS, length=st.integers(2, 300) | st.sampled_from([129, 130, 131, 132, 16_386, 16_390, 70_000])
)
@settings(deadline=None, max_examples=examples(200))
@example("a", [{"Array": np.zeros(5000), "array": {"array": np.zeros(5000)}}], 2)
@example("a", [{"q": 1, "_q": 2, "Q": 3, "q_float": 4}, {"q": 1.5, "_q": {"q": 1}}], 2)
@example("a", [{"Array": 1.5, "x": np.zeros(5000)}, {"Array": {"Array": [{"Array": 1}]}}], 2)
@example("a", [{"_exact": {"_exact": 1}, "_ts_": 1, "exact": 2.0}], 2)
@example("a", [{"p": {"x": 1}, "P": {"x": 2}, "p_": {"x": 3}}], 2)
def test_every_descriptor_is_sound_and_says_the_layout_at_any_length(topic: str, rows: list[Row], length: int) -> None:
    codec = CODEC.for_channel(topic)
    assert isinstance(codec, ProtobufCodec)
    for row in rows:
        encoded(codec, row)
    schema, name = codec.schema(None, topic), codec.schema_name(topic)
    padded = codec.padded(schema, len(schema) - 2 + length)
    assert len(padded) == len(schema) - 2 + length
    for either in (schema, padded):
        message_class(either, name).FromString(encoded(codec, rows[0]))
        layout = descriptor.decode(either, name)
        assert (layout, layout and layout.opaque) == (codec.layout, codec.layout.opaque)
    again = CODEC.for_channel(topic, padded)
    assert again.schema(None, topic) == schema  # by which a recovery tells that it may go on with it


@given(rows=ROWS)
@settings(deadline=None, max_examples=examples(200))
@example([{"a": {"b": [{"c": {"d": 5}}, {}, {"c": {}}]}, "": ""}])
@example([{"n": 2**64 - 1, "m": [2**63, 0], "i": [-(2**63), -1]}, {"i": [2**64 - 1, 1.5]}])
def test_google_finds_the_values_where_the_descriptor_says(rows: list[Row]) -> None:
    codec = CODEC.for_channel("t")
    payloads = [encoded(codec, row) for row in rows]
    parse = message_class(codec.schema(None, "t"), codec.schema_name("t"))
    for row, payload in zip(rows, payloads, strict=True):
        message = parse.FromString(payload)
        assert message._ts == 1.5
        assert not UnknownFieldSet(message)
        check_dict(message, row, set(orjson.loads(message._exact or "{}")), "")


def check_dict(message: Any, row: Row, exact: set[str], path: str) -> None:
    """Check that each field that is set holds the value of its key, and that each other value is in the exact text."""
    shown = set()
    for field, value in message.ListFields():
        if not path and field.name in ("_ts", "_exact"):
            continue
        key = option(field).get("key", field.name)
        shown.add(key)
        check_value(field, value, row[key], exact, f"{path}/{escaped(key)}")
    for key in row.keys() - shown:
        place = f"{path}/{escaped(key)}"
        # an empty list of numbers is a field without elements, which google does not show
        assert place in exact or row[key] == [], place


def check_value(field: Any, value: Any, expected: Any, exact: set[str], place: str) -> None:
    if isinstance(expected, np.ndarray):
        assert (value.type, value.data) == (f"float64[{len(expected)}]", expected.tobytes())
    elif isinstance(expected, dict):
        check_dict(value, expected, exact, place)
    elif isinstance(expected, list) and field.message_type is not None:
        for at, (inner, row) in enumerate(zip(value, expected, strict=True)):
            check_dict(inner, row, exact, f"{place}/{at}")
    elif isinstance(expected, list):
        lengths = option(field).get("lengths", [])
        leaves = expected
        for _ in lengths:
            leaves = [leaf for inner in leaves for leaf in inner]
        assert list(map(bits, value)) == list(map(bits, map(type(value[0]), leaves)))
        assert place in exact or all(
            type(leaf) is type(shown) or any(one.startswith(f"{place}/") for one in exact)
            for leaf, shown in zip(leaves, value, strict=True)
        )
    else:
        assert bits(value) == bits(type(value)(expected))
        assert type(value) is type(expected) or place in exact


def bits(value: Any) -> Any:
    return struct.pack("<d", value) if isinstance(value, float) else (type(value), value)


def escaped(key: str) -> str:
    return key.replace("~", "~0").replace("/", "~1")


@given(rows=ROWS)
@settings(deadline=None, max_examples=examples(60))
def test_mcap_protobuf_support_decodes_every_row(rows: list[Row]) -> None:
    codec = CODEC.for_channel("t")
    payloads = [encoded(codec, row) for row in rows]
    schema = Schema(id=1, name=codec.schema_name("t"), encoding="protobuf", data=codec.schema(None, "t"))
    decode = DecoderFactory().decoder_for("protobuf", schema)
    assert decode is not None
    assert [decode(payload)._ts for payload in payloads] == [1.5] * len(rows)


# -- growth ------------------------------------------------------------------------------------------------------------


@given(rows=st.lists(st.dictionaries(NAMES, VALUES, max_size=4), min_size=1, max_size=8))
@settings(deadline=None, max_examples=examples(200))
def test_a_row_is_read_the_same_under_every_later_layout(rows: list[Row]) -> None:
    codec = CODEC.for_channel("t")
    decoders, payloads = [], []
    for row in rows:
        payloads.append(encoded(codec, row))
        layout = descriptor.decode(codec.schema(None, "t"), codec.schema_name("t"))
        assert layout is not None
        decoders.append(row_decoder(layout))
    for at, (row, payload) in enumerate(zip(rows, payloads, strict=True)):
        for decode in decoders[at:]:
            assert alike(decode(payload), {**row, "_ts": 1.5})


def row_decoder(layout: Layout) -> Any:
    from ml_dash_mcap.codecs.proto.row_decoder import RowDecoder

    return RowDecoder(layout)


def alike(one: Any, other: Any) -> bool:
    """Whether values are the same to the bit and the type, whatever the order of keys."""
    if isinstance(other, np.ndarray):
        return one.dtype == other.dtype and one.tobytes() == other.tobytes()
    if isinstance(other, dict):
        return type(one) is dict and one.keys() == other.keys() and all(alike(one[key], other[key]) for key in other)
    if isinstance(other, list):
        return type(one) is list and len(one) == len(other) and all(map(alike, one, other))
    return same(one, other)


def test_five_thousand_fields_at_once_take_a_moment_and_come_back() -> None:
    codec = CODEC.for_channel("t")
    row = {f"field_{number}": number / 7 for number in range(5000)}
    start = time.process_time()
    payload = encoded(codec, row)
    assert time.process_time() - start < 2
    assert codec.layout.size == 4000
    assert alike(row_decoder(codec.layout)(payload), {**row, "_ts": 1.5})
    message_class(codec.schema(None, "t"), codec.schema_name("t"))


def test_ever_new_keys_come_back_and_the_layout_stays_within_limits() -> None:
    codec = CODEC.for_channel("t")
    rows = [{"by_id": {f"id{number}": number}, f"none{number}": None} for number in range(1000)]
    payloads = [encoded(codec, row) for row in rows]
    decode = row_decoder(codec.layout)
    assert all(alike(decode(payload), {**row, "_ts": 1.5}) for payload, row in zip(payloads, rows, strict=True))
    assert codec.layout.size == 201
    assert len(codec.layout.opaque) == 100
    late = encoded(codec, {"by_id": {"id0": 5}})
    assert alike(decode(late), {"by_id": {"id0": 5}, "_ts": 1.5})


def test_dicts_two_hundred_and_fifty_deep_come_back() -> None:
    value: Any = 1.5
    for _ in range(250):
        value = {"in": value}
    codec = CODEC.for_channel("t")
    payload = encoded(codec, {"deep": value})
    assert alike(row_decoder(codec.layout)(payload), {"deep": value, "_ts": 1.5})
    message_class(codec.schema(None, "t"), codec.schema_name("t")).FromString(payload)


# -- descriptors from outside that say they are ours -------------------------------------------------------------------


def ours() -> descriptor_pb2.FileDescriptorSet:
    codec = CODEC.for_channel("t")
    encoded(codec, {"a": 1.5, "b": {"c": [1, 2]}, "m": [[1.0, 2.0]], "e": {"x": 1}, "n": None})
    files = descriptor_pb2.FileDescriptorSet.FromString(codec.schema(None, "t"))
    assert descriptor.decode(files.SerializeToString(), "ml_dash.T") is not None
    return files


def set_option(options: Any, text: bytes) -> None:
    head = (OPTION << 3 | 2).to_bytes(3, "little")
    options.ParseFromString(varint(int.from_bytes(head, "little")) + varint(len(text)) + text)


def varint(value: int) -> bytes:
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def put_number(message: Any, at: int, number: int) -> None:
    message.field[at].number = number


HOSTILE: dict[str, Any] = {
    "numbers twice": lambda row: put_number(row, 3, row.field[2].number),
    "numbers in no order": lambda row: put_number(row, 2, 99),
    "no time stamp": lambda row: row.field.__delitem__(0),
    "a time stamp of another type": lambda row: setattr(row.field[0], "type", 9),
    "a list of time stamps": lambda row: setattr(row.field[0], "label", 3),
    "no exact text": lambda row: row.field.__delitem__(1),
    "an exact text of another type": lambda row: setattr(row.field[1], "type", 12),
    "a key and type twice": lambda row: set_option(row.field[5].options, b'{"key":"b"}'),
    "an inner message for two fields": lambda row: setattr(row.field[5], "type_name", row.field[3].type_name),
    "an inner message that is not there": lambda row: setattr(row.field[3], "type_name", ".ml_dash.T.Z"),
    "an inner message that lies elsewhere": lambda row: setattr(row.field[3], "type_name", ".other.B"),
    "itself inside": lambda row: setattr(row.field[3], "type_name", ".ml_dash.T"),
    "an odd type": lambda row: setattr(row.field[2], "type", 5),
    "a group": lambda row: setattr(row.field[2], "type", 10),
    "required": lambda row: setattr(row.field[2], "label", 2),
    "a list of arrays": lambda row: row.field.add(name="z", number=9, type=11, label=3, type_name=".ml_dash.T.Array"),
    "lengths of no list": lambda row: set_option(row.field[2].options, b'{"lengths":[2]}'),
    "lengths that are none": lambda row: set_option(row.field[4].options, b'{"lengths":[0]}'),
    "lengths without end": lambda row: set_option(row.field[4].options, b'{"lengths":[9223372036854775807]}'),
    "lengths of another kind": lambda row: set_option(row.field[4].options, b'{"lengths":{"a":1}}'),
    "a key of another kind": lambda row: set_option(row.field[4].options, b'{"key":5}'),
    "an option that is no JSON": lambda row: set_option(row.field[4].options, b"\xff"),
    "opaque values of another kind": lambda row: set_option(row.field[1].options, b'{"opaque":[5]}'),
    "a group among the options": lambda row: row.field[2].options.ParseFromString(b"\xa3\xa0\x19\xa4\xa0\x19"),
}


@pytest.mark.parametrize("change", HOSTILE.values(), ids=HOSTILE.keys())
def test_a_descriptor_that_breaks_our_rules_is_not_taken_for_ours(change: Any) -> None:
    files = ours()
    change(files.file[0].message_type[0])
    assert descriptor.decode(files.SerializeToString(), "ml_dash.T") is None


@given(data=st.data())
@settings(deadline=None, max_examples=examples(400))
def test_a_damaged_descriptor_is_read_or_not_but_nothing_breaks(data: st.DataObject) -> None:
    content = bytearray(ours().SerializeToString())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        match data.draw(st.sampled_from(["flip", "cut", "insert"])):
            case "flip":
                content[at] ^= 1 << data.draw(st.integers(0, 7))
            case "cut":
                del content[at : at + data.draw(st.integers(1, 9))]
            case "insert":
                content[at:at] = data.draw(st.binary(max_size=9))
        if not content:
            return
    layout = descriptor.decode(bytes(content), "ml_dash.T")
    assert layout is None or layout.is_row


def test_a_hundred_thousand_messages_and_fields_are_read_in_a_moment() -> None:
    files = ours()
    row = files.file[0].message_type[0]
    for number in range(100_000):
        row.field.add(name=f"f{number}", number=20_000 + number, type=1, label=1)
        row.nested_type.add(name=f"M{number}")
    data, start = files.SerializeToString(), time.process_time()
    layout = descriptor.decode(data, "ml_dash.T")
    assert time.process_time() - start < 10
    assert layout is not None
    assert layout.size > 100_000


def test_messages_deeper_in_each_other_than_ours_are_not_taken_for_ours() -> None:
    files = ours()
    inner = files.file[0].message_type[0]
    path = ".ml_dash.T"
    for _ in range(60):
        path += ".N"
        inner.field.add(name="n", number=15_000, type=11, label=1, type_name=path)
        inner = inner.nested_type.add(name="N")
    assert descriptor.decode(files.SerializeToString(), "ml_dash.T") is None


def test_a_layout_without_fields_is_that_of_the_first_row() -> None:
    schema = CODEC.for_channel("t").schema(None, "t")
    assert descriptor.decode(schema, "ml_dash.T") == ROW
    assert descriptor.decode(schema, "ml_dash.Other") is None
