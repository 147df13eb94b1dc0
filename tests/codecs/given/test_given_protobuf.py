"""Rows of a protobuf type are the messages that protobuf itself makes, or an error that names the field."""

from __future__ import annotations

import datetime
import enum
import math
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf import (
    any_pb2,
    descriptor_pb2,
    descriptor_pool,
    message_factory,
    struct_pb2,
    text_format,
    wrappers_pb2,
)
from google.protobuf.message import Message
from hypothesis import given
from hypothesis import strategies as st

from ml_dash_mcap.codecs.given.given_protobuf import GivenProtobufCodec, descriptor_set
from ml_dash_mcap.codecs.given.schema_source import given_schema
from ml_dash_mcap.errors import FieldError, OptionError, UsageError
from tests.support import protobuf_messages
from tests.support.protobuf_messages import message_class, rows

EVERYTHING = message_class()


def codec_of(schema: Any) -> GivenProtobufCodec:
    given = given_schema(schema)
    assert given is not None and isinstance(given.codec, GivenProtobufCodec)
    return given.codec


def made(schema: Any, row: dict[str, Any]) -> Any:
    """The message that a row becomes, as the schema's own class reads it."""
    codec = codec_of(schema)
    payload = codec.encode({**row, "_ts": 1.0}, "t")
    assert codec.decode(payload) is not None
    kind = schema if isinstance(schema, type) else message_factory.GetMessageClass(schema)
    message: Message = kind.FromString(payload)  # type: ignore[attr-defined]
    assert message.ByteSize() == len(payload)
    return message


def refused(schema: Any, row: dict[str, Any]) -> str:
    with pytest.raises(FieldError) as caught:
        codec_of(schema).encode({**row, "_ts": 1.0}, "arm")
    text = str(caught.value)
    assert text.startswith("append() on topic 'arm': ")
    return text.removeprefix("append() on topic 'arm': ")


def compiled(text: str) -> Any:
    """The class of the message `M` of a file that is given as a descriptor's text."""
    file = text_format.Parse(f'name: "m.proto" package: "p" {text}', descriptor_pb2.FileDescriptorProto())
    pool = descriptor_pool.DescriptorPool()
    for name in file.dependency:
        descriptor_pool.Default().FindFileByName(name).CopyToProto(proto := descriptor_pb2.FileDescriptorProto())
        pool.Add(proto)
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("p.M"))


@given(rows())
def test_a_row_is_the_message_that_protobuf_makes_of_its_values(row: dict[str, Any]) -> None:
    assert made(EVERYTHING, row) == protobuf_messages.fill(EVERYTHING(), row)


@given(rows())
def test_a_row_that_was_read_can_be_appended_again(row: dict[str, Any]) -> None:
    codec = codec_of(EVERYTHING)
    payload = codec.encode({**row, "_ts": 1.0}, "t")
    read = codec.decode(payload)
    again = codec.encode({**read, "_ts": 1.0}, "t")
    assert EVERYTHING.FromString(again) == EVERYTHING.FromString(payload)  # type: ignore[attr-defined]


NUMBERS = ["f8", "f4", ">f8", "f2", "i8", "u8", "i4", "u4", ">i4", "i2", "u1", "?"]


@pytest.mark.parametrize("count", [0, 3, 1000])
@pytest.mark.parametrize("dtype", NUMBERS)
@pytest.mark.parametrize("field", ["double", "float", "int64", "uint64", "int32", "fixed32", "sint64", "bool"])
def test_an_array_becomes_what_its_list_becomes_or_is_refused_as_that_is(field: str, dtype: str, count: int) -> None:
    array = (np.arange(count) % 100).astype(dtype)
    name, codec = f"many_{field}", codec_of(EVERYTHING)
    try:
        expected = codec.encode({name: array.tolist(), "_ts": 1.0}, "t")
    except FieldError:
        assert count
        refused(EVERYTHING, {name: array})
        return
    assert codec.encode({name: array, "_ts": 1.0}, "t") == expected
    assert codec.encode({name: array[::-1][::-1], "_ts": 1.0}, "t") == expected


class Gear(enum.IntEnum):
    RUN = 7


class Word(str, enum.Enum):
    RUN = "RUN"


@dataclass
class Inner:
    x: float


@pytest.mark.parametrize(
    ("row", "text"),
    [
        ({"a_double": 3}, "a_double: 3"),
        ({"a_double": np.float32(0.5)}, "a_double: 0.5"),
        ({"a_double": np.array(0.5)}, "a_double: 0.5"),
        ({"a_double": math.nan}, "a_double: nan"),
        ({"a_double": -math.inf}, "a_double: -inf"),
        ({"a_float": math.inf}, "a_float: inf"),
        ({"a_float": 0.1}, "a_float: 0.1"),
        ({"a_float": 2**24 + 1}, "a_float: 16777216"),
        ({"a_float": 3.4028235677973362e38}, "a_float: 3.4028234663852886e38"),
        ({"a_int32": np.int64(-5)}, "a_int32: -5"),
        ({"a_uint64": 2**64 - 1}, "a_uint64: 18446744073709551615"),
        ({"a_bool": np.bool_(True)}, "a_bool: true"),
        ({"a_string": np.str_("é")}, 'a_string: "é"'),
        ({"a_bytes": bytearray(b"ab")}, 'a_bytes: "ab"'),
        ({"a_bytes": memoryview(b"ab")}, 'a_bytes: "ab"'),
        ({"a_bytes": np.array([[97, 98], [99, 100]], np.uint8).T}, 'a_bytes: "acbd"'),
        ({"a_bytes": np.array([0x6261], "<u2")}, 'a_bytes: "ab"'),
        ({"class": "RUN"}, "class: RUN"),
        ({"class": 7}, "class: RUN"),
        ({"class": Gear.RUN}, "class: RUN"),
        ({"class": Word.RUN}, "class: RUN"),
        ({"class": 5}, "class: 5"),
        ({"modes": ["IDLE", 7, np.int8(7)]}, "modes: [IDLE, RUN, RUN]"),
        ({"from": Inner(2.5)}, "from { x: 2.5 }"),
        ({"from": {}}, "from { }"),
        ({"from": None, "perhaps": None, "number": None}, ""),
        ({"number": None, "word": "x"}, 'word: "x"'),
        ({"many_double": (1, 2.5)}, "many_double: [1, 2.5]"),
        ({"many_string": np.array(["a", "b"])}, 'many_string: ["a", "b"]'),
        ({"inners": (Inner(1.0), {"x": 2})}, "inners { x: 1 } inners { x: 2 }"),
        ({"counts": {"a": 1}}, 'counts { key: "a" value: 1 }'),
        ({"by_number": {-3: {"x": 1.0}}}, "by_number { key: -3 value { x: 1 } }"),
        ({"by_number": {"-3": {"x": 1.0}}}, "by_number { key: -3 value { x: 1 } }"),
        ({"by_truth": {True: "RUN"}}, "by_truth { key: true value: RUN }"),
    ],
)
def test_values_of_python_and_numpy_are_taken(row: dict[str, Any], text: str) -> None:
    assert str(made(EVERYTHING, row)) == str(text_format.Parse(text, EVERYTHING()))


def test_messages_are_taken_as_values_of_their_fields() -> None:
    inner = EVERYTHING(children=[{"a_string": "leaf"}])
    assert made(EVERYTHING, {"children": [inner]}).children[0] == inner
    elsewhere = message_class()  # the same type, made a second time
    assert made(EVERYTHING, {"children": [elsewhere(a_int32=3)]}).children[0].a_int32 == 3
    assert refused(EVERYTHING, {"from": Log()}) == (
        "field 'from' takes a message of type test.Everything.Inner; this one is a foxglove.Log"
    )


MISFITS: list[tuple[dict[str, Any], str]] = [
    ({"a_double": "1.5"}, "field 'a_double' takes a double; '1.5' does not fit"),
    ({"a_double": True}, "field 'a_double' takes a double; True does not fit"),
    ({"a_double": [1.0]}, "field 'a_double' takes a double; [1.0] does not fit"),
    ({"a_double": 2**53 + 1}, "field 'a_double' takes a double, which does not hold 9007199254740993 exactly"),
    ({"a_double": 10**400}, "field 'a_double' takes a double; 1000"),
    ({"a_double": None}, "field 'a_double' takes a double and has no null; leave it out"),
    ({"a_float": 3.5e38}, "field 'a_float' takes a float; 3.5e+38 does not fit"),
    ({"a_int32": 2**31}, "field 'a_int32' takes an int32, an integer from -2147483648 to 2147483647; 2147483648"),
    ({"a_int32": 1.0}, "field 'a_int32' takes an int32, an integer from"),
    ({"a_uint64": -1}, "field 'a_uint64' takes a uint64, an integer from 0 to 18446744073709551615; -1 does not fit"),
    ({"a_sint64": 2**63}, "field 'a_sint64' takes a sint64"),
    ({"a_bool": 1}, "field 'a_bool' takes a bool; 1 does not fit"),
    ({"a_string": b"x"}, "field 'a_string' takes a string; b'x' does not fit"),
    ({"a_string": "\ud800"}, "field 'a_string' takes a string; '\\ud800' is not valid Unicode"),
    ({"a_bytes": "x"}, "field 'a_bytes' takes bytes, or an array whose bytes they are; 'x' does not fit"),
    ({"a_bytes": np.array([None])}, "field 'a_bytes' takes bytes"),
    ({"a_bytes": np.ma.masked_array([1, 2], [0, 1])}, "field 'a_bytes' takes bytes; the array has masked elements"),
    ({"class": "RUNN"}, "field 'class' takes a name or number of test.Mode; 'RUNN' is none: did you mean 'RUN'?"),
    ({"class": "x"}, "field 'class' takes a name or number of test.Mode; 'x' is none: there are IDLE, RUN"),
    ({"class": True}, "field 'class' takes a name or number of test.Mode; True does not fit"),
    ({"class": 2**31}, "field 'class' takes a name or number of test.Mode; 2147483648 does not fit"),
    ({"modes": ["RUN", "no"]}, "field 'modes[1]' takes a name or number of test.Mode"),
    ({"many_double": 1.0}, "field 'many_double' takes a list of double values, not 1.0"),
    ({"many_double": None}, "field 'many_double' takes a list of double values; None does not fit"),
    ({"many_double": "12"}, "field 'many_double' takes a list of double values; '12' does not fit"),
    ({"many_double": [1.0, None]}, "field 'many_double[1]' takes a double; None does not fit"),
    (
        {"many_double": {1.0}},
        "field 'many_double' takes a list of double values, not {1.0} (set); pass list(...) of it",
    ),
    (
        {"many_double": deque([1.0])},
        "field 'many_double' takes a list of double values, not deque([1.0]) (deque); pass",
    ),
    ({"many_double": np.eye(2)}, "field 'many_double' takes a list of double values; the array has the shape (2, 2)"),
    ({"many_double": np.array([1 + 2j])}, "field 'many_double[0]' takes a double"),
    ({"many_double": np.array([0, 2**53 + 1])}, "field 'many_double[1]' takes a double, which does not hold"),
    ({"many_double": np.ma.masked_array([1.0, 2.0], [0, 1])}, "field 'many_double' takes a list of double values; the"),
    ({"many_float": np.array([1.0, 1e39])}, "field 'many_float[1]' takes a float; 1e+39 does not fit"),
    ({"many_int32": np.array([1, 2**40])}, "field 'many_int32[1]' takes an int32"),
    ({"many_uint32": np.array([1, -2])}, "field 'many_uint32[1]' takes a uint32"),
    ({"many_int32": np.array([1.0])}, "field 'many_int32[0]' takes an int32"),
    ({"many_string": "abc"}, "field 'many_string' takes a list of string values; 'abc' does not fit"),
    ({"from": 3}, "field 'from' takes a dict of the fields of test.Everything.Inner; 3 does not fit"),
    ({"from": {"x": "a"}}, "field 'from.x' takes a double; 'a' does not fit"),
    ({"from": {"y": 1}}, "field 'from.y' is not a field of test.Everything.Inner; there are 'x'"),
    ({"from": {3: 1}}, "field 'from.3' is not a field of test.Everything.Inner"),
    ({"inners": {"x": 1.0}}, "field 'inners' takes a list of test.Everything.Inner messages; {'x': 1.0} does not fit"),
    ({"inners": [{}, {"x": "a"}]}, "field 'inners[1].x' takes a double; 'a' does not fit"),
    ({"inners": [None]}, "field 'inners[0]' takes a dict of the fields of test.Everything.Inner; None does not fit"),
    ({"counts": [("a", 1)]}, "field 'counts' takes a dict of string to int64; [('a', 1)] does not fit"),
    ({"counts": {1: 1}}, "field 'counts.1' takes a string; 1 does not fit"),
    ({"counts": {"a": "b"}}, "field 'counts.a' takes an int64"),
    ({"by_number": {"x": {}}}, "field 'by_number.x' takes an int32"),
    ({"by_number": {1: {"x": []}}}, "field 'by_number.1.x' takes a double; [] does not fit"),
    ({"by_truth": {"yes": 0}}, "field 'by_truth.yes' takes a bool"),
    ({"number": 1.0, "word": "x"}, "field 'number' and 'word' of test.Everything exclude each other; pass one of them"),
    ({"a_duble": 1.0}, "field 'a_duble' is not a field of test.Everything; did you mean 'a_double'"),
    ({"stamp": "now"}, "field 'stamp' takes a time: seconds since 1970, a datetime with its zone, or a dict"),
    ({"stamp": datetime.datetime(2024, 1, 1)}, "field 'stamp' takes a time; datetime.datetime(2024, 1, 1, 0, 0)"),
    (
        {"stamp": 1.7e18},
        "field 'stamp' takes a time of the years 1 to 9999; 1.7e+18 s since 1970 is none; it looks like n",
    ),
    ({"stamp": math.nan}, "field 'stamp' takes a finite number of seconds; nan does not fit"),
    ({"stamp": np.datetime64("NaT")}, "field 'stamp' takes a time; NaT is none"),
    ({"stamp": np.datetime64("9000-01-01", "s")}, "field 'stamp' takes a time; "),
    ({"stamp": {"seconds": 1.5}}, "field 'stamp.seconds' takes an int64"),
    ({"stamp": {"sec": 1}}, "field 'stamp.sec' is not a field of google.protobuf.Timestamp; did you mean 'seconds'?"),
    ({"took": 1e12}, "field 'took' takes a span of at most 10,000 years"),
    (
        {"took": [1]},
        "field 'took' takes a span: seconds, a timedelta, or a dict of seconds and nanos; [1] does not fit",
    ),
]


@pytest.mark.parametrize(("row", "text"), MISFITS, ids=[str(number) for number in range(len(MISFITS))])
def test_a_value_that_does_not_fit_is_named_with_its_field(row: dict[str, Any], text: str) -> None:
    assert refused(EVERYTHING, row).startswith(text)


def test_a_row_that_was_refused_leaves_nothing_behind() -> None:
    refused(EVERYTHING, {"a_int32": 3, "many_double": [1.0, "x"]})
    assert made(EVERYTHING, {"a_bool": True}) == EVERYTHING(a_bool=True)


UTC = datetime.timezone.utc
ZONE = datetime.timezone(datetime.timedelta(hours=2))


@pytest.mark.parametrize(
    ("value", "pair"),
    [
        (0, (0, 0)),
        (1.5, (1, 500_000_000)),
        (-0.25, (-1, 750_000_000)),
        (1_700_000_000.123456, (1_700_000_000, 123_456_001)),  # the double next to it
        (np.float64(2.5), (2, 500_000_000)),
        (2**60, None),
        (datetime.datetime(2024, 1, 1, 2, 0, 0, 123456, ZONE), (1_704_067_200, 123_456_000)),
        (datetime.datetime(1, 1, 1, tzinfo=UTC), (-62_135_596_800, 0)),
        (datetime.datetime(9999, 12, 31, 23, 59, 59, 999_999, UTC), (253_402_300_799, 999_999_000)),
        (np.datetime64("2024-01-01T00:00:00.123456789"), (1_704_067_200, 123_456_789)),
        (np.datetime64("2024-01-01"), (1_704_067_200, 0)),
        ({"seconds": 5, "nanos": 6}, (5, 6)),
    ],
)
def test_a_time_is_given_in_seconds_or_as_a_datetime(value: Any, pair: tuple[int, int] | None) -> None:
    if pair is None:
        assert "years 1 to 9999" in refused(EVERYTHING, {"stamp": value})
    else:
        stamp = made(EVERYTHING, {"stamp": value}).stamp
        assert (stamp.seconds, stamp.nanos) == pair


@given(st.datetimes(timezones=st.just(UTC)))
def test_a_datetime_is_the_time_that_protobuf_takes_it_for(when: datetime.datetime) -> None:
    assert made(EVERYTHING, {"stamp": when}).stamp.ToDatetime(UTC) == when


@given(st.timedeltas(datetime.timedelta(days=-3_650_000), datetime.timedelta(days=3_650_000)))
def test_a_timedelta_is_the_span_that_protobuf_takes_it_for(span: datetime.timedelta) -> None:
    assert made(EVERYTHING, {"took": span}).took.ToTimedelta() == span


def test_a_span_has_one_sign() -> None:
    took = made(EVERYTHING, {"took": -1.5}).took
    assert (took.seconds, took.nanos) == (-1, -500_000_000)
    took = made(EVERYTHING, {"took": np.timedelta64(-1500, "ms")}).took
    assert (took.seconds, took.nanos) == (-1, -500_000_000)


def test_times_of_pandas_keep_their_nanoseconds() -> None:
    pd = pytest.importorskip("pandas")
    stamp = made(EVERYTHING, {"stamp": pd.Timestamp("2024-01-01T00:00:00.123456789", tz="UTC")}).stamp
    assert stamp.nanos == 123_456_789
    assert made(EVERYTHING, {"took": pd.Timedelta(1_500_000_001, "ns")}).took.nanos == 500_000_001


WELL_KNOWN = """
syntax: "proto3" dependency: "google/protobuf/struct.proto" dependency: "google/protobuf/wrappers.proto"
dependency: "google/protobuf/any.proto"
message_type { name: "M"
  field { name: "data" number: 1 type: TYPE_MESSAGE type_name: ".google.protobuf.Struct" label: LABEL_OPTIONAL }
  field { name: "value" number: 2 type: TYPE_MESSAGE type_name: ".google.protobuf.Value" label: LABEL_OPTIONAL }
  field { name: "limit" number: 3 type: TYPE_MESSAGE type_name: ".google.protobuf.Int32Value" label: LABEL_OPTIONAL }
  field { name: "what" number: 4 type: TYPE_MESSAGE type_name: ".google.protobuf.Any" label: LABEL_OPTIONAL } }
"""


def test_structs_wrapped_numbers_and_any_are_given_as_their_content() -> None:
    assert struct_pb2 and any_pb2 and wrappers_pb2  # their files are in the default pool
    kind = compiled(WELL_KNOWN)
    message = made(kind, {"data": {"a": [1, None, "x", {"b": np.float32(0.5)}]}, "value": None, "limit": 0})
    assert text_format.MessageToString(message.data.fields["a"].list_value.values[3].struct_value.fields["b"]) == (
        "number_value: 0.5\n"
    )
    assert message.HasField("value") and message.value.HasField("null_value")
    assert message.HasField("limit") and message.limit.value == 0
    assert not made(kind, {"limit": None}).HasField("limit")
    packed = made(kind, {"what": PoseInFrame(frame_id="a")}).what
    assert packed.type_url.endswith("/foxglove.PoseInFrame") and b"a" in packed.value
    assert refused(kind, {"data": {"a": b"x"}}).startswith("field 'data' takes what JSON can say; {'a': b'x'}")
    assert refused(kind, {"limit": 2**31}).startswith("field 'limit' takes an int32")


PROTO2 = """
enum_type { name: "Mode" value { name: "ON" number: 1 } }
message_type { name: "M" field { name: "id" number: 1 type: TYPE_INT32 label: LABEL_REQUIRED }
  field { name: "mode" number: 2 type: TYPE_ENUM type_name: ".p.Mode" label: LABEL_OPTIONAL } }
"""


def test_a_message_without_a_required_field_is_refused() -> None:
    kind = compiled(PROTO2)
    assert made(kind, {"id": 0}).id == 0
    assert refused(kind, {"mode": "ON"}) == "the p.M cannot be stored: it lacks the required id"
    assert "has no number 2: there are ON" in refused(kind, {"id": 1, "mode": 2})
    with pytest.raises(
        FieldError, match=r"append_message\(\) on topic 't': the p.M cannot be .* lacks the required id"
    ):
        codec_of(kind).encode_message(kind(), "t")


def test_messages_lie_in_each_other_as_deep_as_readers_take_them() -> None:
    row: dict[str, Any] = {"a_int32": 7}
    for _ in range(99):
        row = {"children": [row]}
    assert made(EVERYTHING, row).ByteSize() > 99
    assert "lies in more than 100 other messages" in refused(EVERYTHING, {"children": [row]})
    endless: dict[str, Any] = {}
    endless["children"] = [endless]
    assert "lies in more than 100 other messages" in refused(EVERYTHING, endless)


def test_a_message_of_the_schema_is_stored_as_protobuf_serialises_it() -> None:
    pose = PoseInFrame(frame_id="base")
    assert codec_of(PoseInFrame).encode_message(pose, "t") == pose.SerializeToString()
    same = message_class()(a_int32=5)
    assert codec_of(EVERYTHING).encode_message(same, "t") == same.SerializeToString()


def test_what_is_no_message_of_the_schema_is_refused() -> None:
    codec = codec_of(PoseInFrame)
    for value, text in [
        (Log(), "the message is a foxglove.Log, but the topic's schema is foxglove.PoseInFrame"),
        (PoseInFrame, r"takes a message, not its class: pass PoseInFrame\(\.\.\.\)"),
        (None, "takes a protobuf message, not None"),
        ({"frame_id": "a"}, r"not a dict: write append\(\*\*row\)"),
        (b"", "not its bytes"),
    ]:
        with pytest.raises(UsageError, match=text):
            codec.encode_message(value, "t")
    head = 'syntax: "proto3" message_type { name: "M" field { name: "x" number: 1 label: LABEL_OPTIONAL type: '
    first, second = compiled(head + "TYPE_INT32 } }"), compiled(head + "TYPE_DOUBLE } }")
    with pytest.raises(UsageError, match=r"is a p.M by another definition than the topic's schema"):
        codec_of(first).encode_message(second(), "t")


def test_the_schema_holds_all_imports_each_before_the_file_that_needs_it() -> None:
    described = descriptor_pb2.FileDescriptorSet.FromString(descriptor_set(SceneUpdate.DESCRIPTOR))
    names = [file.name for file in described.file]
    assert names[-1] == "foxglove/SceneUpdate.proto" and len(names) == len(set(names)) > 10
    pool = descriptor_pool.DescriptorPool()
    for file in described.file:
        pool.Add(file)  # refuses a file whose imports are not there yet
    assert pool.FindMessageTypeByName("foxglove.SceneUpdate").full_name == "foxglove.SceneUpdate"


def test_a_schema_is_given_as_a_class_a_descriptor_or_a_name() -> None:
    given = given_schema(PoseInFrame)
    assert given is not None and given.name == "foxglove.PoseInFrame"
    assert given == given_schema(PoseInFrame.DESCRIPTOR) == given_schema(type(PoseInFrame()))
    assert given == given_schema("foxglove.PoseInFrame") == given_schema(PoseInFrame, "protobuf")
    assert given_schema(None) is None


def test_every_schema_of_foxglove_has_its_name() -> None:
    with pytest.raises(OptionError, match="no schema has that name"):
        given_schema("foxglove")
    from ml_dash_mcap.codecs.given import foxglove_schemas

    names = foxglove_schemas.names()
    assert {"foxglove.RawImage", "foxglove.FrameTransforms", "foxglove.JointStates"} <= {*names} and len(names) > 40
    for name in names:
        given = given_schema(name)
        assert given is not None and given.name == name


def test_what_is_no_schema_is_refused_with_what_to_pass() -> None:
    with pytest.raises(OptionError, match=r"schema='foxglove.PoseInFram': .*did you mean 'foxglove.PoseInFrame'"):
        given_schema("foxglove.PoseInFram")
    with pytest.raises(OptionError, match="contradict each other: rows of that schema are 'protobuf'"):
        given_schema(PoseInFrame, "json")
    with pytest.raises(UsageError, match="schema=3 is of type int; pass a class of protobuf messages"):
        given_schema(3)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="pass a class of protobuf messages, such as PoseInFrame"):
        given_schema(PoseInFrame())  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="is of type type"):
        given_schema(Message)
