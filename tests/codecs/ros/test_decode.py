"""What rosbags writes decodes to the rows that went in, in both wire formats and byte orders, whatever the definition."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from ml_dash_mcap.codecs.ros.message_decoder import decoder
from ml_dash_mcap.errors import EncodingError
from tests.support import ros_messages
from tests.support.examples import examples

FEW = settings(max_examples=examples(40), deadline=None)


@st.composite
def cases(draw: st.DrawFn, least: int = 0) -> tuple[ros_messages.Messages, list[dict[str, Any]]]:
    messages = draw(ros_messages.messages(least))
    return messages, draw(st.lists(ros_messages.rows(messages), min_size=1, max_size=3))


@FEW
@given(case=cases())
def test_cdr_of_either_byte_order_decodes_to_the_row_that_was_written(case) -> None:
    messages, rows = case
    store = ros_messages.typestore(messages)
    decode = decoder("pkg/msg/Outer", "ros2msg", ros_messages.text(messages))
    for row in rows:
        message = ros_messages.instance(store, messages, row)
        for little_endian in (True, False):
            payload = bytes(store.serialize_cdr(message, "pkg/msg/Outer", little_endian=little_endian))
            assert repr(decode(payload)) == repr(row)
            assert repr(decode(payload + b"\0" * 3)) == repr(row), "CDR may be padded to a multiple of 4"


@FEW
@given(case=cases(least=1))
def test_ros_1_decodes_to_the_row_that_was_written(case) -> None:
    messages, rows = case
    store = ros_messages.typestore(messages)
    decode = decoder("pkg/Outer", "ros1msg", ros_messages.text(messages), is_ros1=True)
    for row in rows:
        message = ros_messages.instance(store, messages, row)
        assert repr(decode(bytes(store.serialize_ros1(message, "pkg/msg/Outer")))) == repr(row)


@FEW
@given(case=cases(), data=st.data())
def test_bytes_that_are_no_such_message_are_a_value_error(case, data) -> None:
    messages, rows = case
    store = ros_messages.typestore(messages)
    decode = decoder("pkg/msg/Outer", "ros2msg", ros_messages.text(messages))
    payload = bytes(store.serialize_cdr(ros_messages.instance(store, messages, rows[0]), "pkg/msg/Outer"))
    cut = data.draw(st.integers(0, len(payload) - 1))
    at = data.draw(st.integers(0, len(payload) - 1))
    with pytest.raises(ValueError, match=r"bytes|starts|text|codec|buffer|offset"):
        decode(payload[:cut])
    with pytest.raises(ValueError, match="bytes long"):
        decode(payload + bytes(4))
    try:
        decode(payload[:at] + bytes([payload[at] ^ 0xFF]) + payload[at + 1 :])
    except ValueError:
        pass


STANDARD = get_typestore(Stores.ROS2_JAZZY)


def standard(name: str, *, ros_version: int = 2) -> Any:
    text, _ = STANDARD.generate_msgdef(name, ros_version=ros_version)
    return decoder(name, "ros2msg" if ros_version == 2 else "ros1msg", text, is_ros1=ros_version == 1)


def test_every_standard_message_of_ros_2_has_a_decoder_that_takes_a_message_of_zeros() -> None:
    for name in STANDARD.types:
        payload = zeros(name)
        row = standard(name)(payload)
        assert list(row) == [field for field, _ in STANDARD.fielddefs[name][1] if not field.startswith("structure_")]


def zeros(name: str) -> bytes:
    return bytes(STANDARD.serialize_cdr(zero(("named", name)), name))


def zero(described: Any) -> Any:
    """The value that ROS gives a field that nobody has set."""
    kind, what = described
    if kind == "named" or kind == 2:
        fields = STANDARD.fielddefs[what][1]
        return STANDARD.types[what](*[zero(one) for _, one in fields])
    if kind == 1:
        return "" if what[0] == "string" else False if what[0] == "bool" else 0
    inner, length = what
    length = length if kind == 3 else 0
    if inner[0] == 1 and inner[1][0] != "string":
        dtype = {"byte": "int8", "char": "uint8"}.get(inner[1][0], inner[1][0])
        return np.zeros(length, dtype)
    return [zero(inner)] * length


def test_an_image_stays_bytes_and_other_numbers_are_python_numbers() -> None:
    types = STANDARD.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](1, 2), "camera")
    image = types["sensor_msgs/msg/Image"](header, 2, 3, "rgb8", 0, 9, np.arange(18, dtype=np.uint8))
    row = standard("sensor_msgs/msg/Image")(bytes(STANDARD.serialize_cdr(image, "sensor_msgs/msg/Image")))
    assert row == {
        "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "camera"},
        "height": 2,
        "width": 3,
        "encoding": "rgb8",
        "is_bigendian": 0,
        "step": 9,
        "data": bytes(range(18)),
    }
    assert type(row["height"]) is int and type(row["data"]) is bytes


def test_times_of_ros_1_have_the_names_that_ros_1_has_for_their_parts() -> None:
    decode = decoder("pkg/Stamped", "ros1msg", "time at\nduration took\ntime[] all", is_ros1=True)
    payload = struct.pack("<IIiiI", 7, 8, -1, 2, 1) + struct.pack("<II", 5, 6)
    stamps = {"at": {"secs": 7, "nsecs": 8}, "took": {"secs": -1, "nsecs": 2}, "all": [{"secs": 5, "nsecs": 6}]}
    assert decode(payload) == stamps


def test_bytes_and_chars_are_what_each_generation_means_by_them() -> None:
    text = "byte b\nchar c\nbyte[] bs\nchar[] cs"
    values = struct.pack("<BB", 200, 200)
    ros1 = values + struct.pack("<I2BI2B", 2, 1, 255, 2, 1, 255)
    ros2 = b"\0\1\0\0" + values + b"\0\0" + struct.pack("<I2BxxI2B", 2, 1, 255, 2, 1, 255)
    assert decoder("p/A", "ros1msg", text, is_ros1=True)(ros1) == {
        "b": -56,
        "c": 200,
        "bs": [1, -1],
        "cs": b"\x01\xff",
    }
    assert decoder("p/msg/A", "ros2msg", text)(ros2) == {"b": 200, "c": 200, "bs": b"\x01\xff", "cs": b"\x01\xff"}


def test_a_message_without_fields_is_an_empty_row() -> None:
    assert decoder("std_msgs/msg/Empty", "ros2msg", "")(b"\0\1\0\0\0") == {}
    assert decoder("std_msgs/Empty", "ros1msg", "# nothing\n", is_ros1=True)(b"") == {}
    assert decoder("p/msg/A", "ros2msg", "B b\nint32 n\n===\nMSG: p/B\n")(b"\0\1\0\0\0\0\0\0\7\0\0\0") == {
        "b": {},
        "n": 7,
    }


def test_an_empty_text_may_have_no_bytes_at_all() -> None:
    decode = decoder("p/msg/A", "ros2msg", "string s\nstring[] more\nint32 n")
    payload = b"\0\1\0\0" + struct.pack("<IIII2sxxi", 0, 2, 0, 2, b"a\0", 5)
    assert decode(payload) == {"s": "", "more": ["", "a"], "n": 5}


@pytest.mark.parametrize("line", ["string s", "string[1] s", "string[] s"])
def test_a_text_without_its_zero_is_a_value_error(line: str) -> None:
    count = b"\1\0\0\0" if "[]" in line else b""
    with pytest.raises(ValueError, match=r"the text at byte \d+ does not end with a zero"):
        decoder("p/msg/A", "ros2msg", line)(b"\0\1\0\0" + count + b"\2\0\0\0ab")


def test_the_same_type_with_other_fields_is_another_type() -> None:
    payload = b"\0\1\0\0" + struct.pack("<f", 1.0)
    assert decoder("p/msg/A", "ros2msg", "float32 x")(payload) == {"x": 1.0}
    assert decoder("p/msg/A", "ros2msg", "int32 y")(payload) == {"y": 0x3F800000}


def test_a_tree_of_messages_in_lists_decodes() -> None:
    text = "Node root\n===\nMSG: p/Node\nuint8 n\nNode[] children"
    payload = b"\0\1\0\0" + struct.pack("<BxxxIBxxxI", 1, 1, 2, 0)
    tree = {"root": {"n": 1, "children": [{"n": 2, "children": []}]}}
    assert decoder("p/msg/Tree", "ros2msg", text)(payload) == tree


def chain(length: int, line: str) -> str:
    return (
        f"\n{'=' * 80}\n".join(
            (f"MSG: p/M{n}\n" if n else "") + line.replace("NEXT", f"M{n + 1}") for n in range(length)
        )
        + f"\n{'=' * 80}\nMSG: p/M{length}\nuint8 x"
    )


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("A a", "has a p/A in itself"),
        ("B b\n===\nMSG: p/B\nA a", "has a p/A in itself"),
        (chain(200, "NEXT x"), "messages deep"),
        (chain(30, "NEXT x\nNEXT y"), "fields"),
        (chain(3000, "NEXT[] x"), "messages in messages"),
        ("int64 x\nwstring y", "the type 'wstring'"),
        ("B b", "of type 'B', which it does not define"),
        ("other/B b", "it does not define other/B"),
        ("float64 x\nfloat64 x", "two fields 'x'"),
        ("float64 q[7]\n", r"the line 'float64 q\[7\]'"),
        ("\x80\x02 garbage", "neither a field nor a constant"),
        ("int8 x\n===\nint8 y", "a section without a line 'MSG: package/Name' above 'int8 y'"),
        ("int8 x\n---\nint8 y\n---\nint8 z\n---\nint8 z", "4 parts between lines of ---"),
    ],
)  # fmt: skip
def test_a_definition_that_cannot_be_used_is_an_error_that_says_why(text: str, why: str) -> None:
    with pytest.raises(EncodingError, match=why):
        decoder("p/msg/A" if not text.startswith("M1") else "p/msg/M0", "ros2msg", text)


def test_a_list_of_what_takes_no_bytes_in_ros_1_is_read_up_to_a_number_since_nothing_else_bounds_it() -> None:
    decode = decoder("p/A", "ros1msg", "B[] x\nint8 n\n===\nMSG: p/B\n", is_ros1=True)
    assert decode(struct.pack("<Ib", 3, 7)) == {"x": [{}, {}, {}], "n": 7}
    with pytest.raises(ValueError, match="a list of 4000000000 values that take no bytes"):
        decode(struct.pack("<Ib", 4_000_000_000, 7))
    fixed = decoder("p/A", "ros1msg", "B[2] x\n===\nMSG: p/B\n", is_ros1=True)
    assert fixed(b"") == {"x": [{}, {}]}


@pytest.mark.parametrize(
    "text",
    [
        "B[4000000000] x\n===\nMSG: p/B\nC[4000000000] y\n===\nMSG: p/C\n",
        "B[200] x\n===\nMSG: p/B\nC[200] y\n===\nMSG: p/C\n",
        "\n".join(f"B[250] x{n}" for n in range(100)) + "\n===\nMSG: p/B\n",
    ],
)
def test_a_definition_of_many_values_that_take_no_bytes_is_refused(text: str) -> None:
    with pytest.raises(EncodingError, match=r"values that take no bytes|more than 10000 fields"):
        decoder("p/A", "ros1msg", text, is_ros1=True)


def test_lengths_that_lie_take_no_memory() -> None:
    huge = b"\0\1\0\0" + struct.pack("<I", 2**32 - 1)
    for line in ("float64[] x", "uint8[] x", "string[] x", "string x", "int8[] x", "bool[] x", "B[] x"):
        with pytest.raises(ValueError, match=r"bytes|buffer"):
            decoder("p/msg/A", "ros2msg", f"{line}\n===\nMSG: p/B\nuint8 y")(huge)
    with pytest.raises(ValueError, match="bytes"):
        decoder("p/msg/A", "ros2msg", "float64[2000000000] x\nint8 y")(huge)
    with pytest.raises(ValueError, match="bytes"):
        decoder("p/msg/A", "ros2msg", "B[4000000000] x\n===\nMSG: p/B\nuint64 y")(huge)


def test_cdr_of_another_kind_is_refused_with_its_head() -> None:
    for head in (b"\0\2\0\0", b"\0\3\0\0", b"\0\x0a\0\0", b"\0\x0b\0\0", b"\0\5\0\0", b"\1\0\0\0", b"\0"):
        with pytest.raises(ValueError, match=r"it starts with b'.*', which announces .* no plain CDR"):
            decoder("p/msg/A", "ros2msg", "float32 x")(head + bytes(4) if len(head) == 4 else head)
