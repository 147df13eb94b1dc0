"""Messages that are read as columns say what the same messages say as rows, in the same types of Arrow."""

from __future__ import annotations

import struct
import time
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ml_dash_mcap import Recording
from ml_dash_mcap.codecs.ros.message_decoder import MessageDecoder, decoder
from ml_dash_mcap.codecs.ros_columns import LEAST_MESSAGES, RosColumnReader
from ml_dash_mcap.errors import UndecodedWarning
from ml_dash_mcap.rows.dotted import flatten
from ml_dash_mcap.rows.field_choice import project
from ml_dash_mcap.rows.table import Block, Column, block_of
from tests.support import ros_messages
from tests.support.examples import examples

MANY = settings(max_examples=examples(120), deadline=None)


@st.composite
def cases(draw: st.DrawFn, least: int = 1) -> tuple[ros_messages.Messages, list[dict[str, Any]]]:
    messages = draw(ros_messages.messages(least))
    return messages, draw(st.lists(ros_messages.rows(messages), min_size=1, max_size=12))


def columns_of(decode: MessageDecoder, payloads: list[bytes]) -> Block | None:
    payloads = payloads * LEAST_MESSAGES
    columns = RosColumnReader(lambda: decode, None).read(payloads)
    return columns and Block(len(payloads), {name: Column(array) for name, array in columns.arrays.items()})


def columns_of_rows(rows: list[dict[str, Any]]) -> Block:
    block = block_of([flatten({"_ts": 0.0, **row}, "_ts") for row in rows * LEAST_MESSAGES])
    return Block(block.count, {name: column for name, column in block.columns.items() if name != "_ts"})


def assert_same(one: Block | None, other: Block) -> None:
    assert one is not None
    assert list(one.columns) == list(other.columns)
    for name, column in one.columns.items():
        assert column.array.type == other.columns[name].array.type, name
        assert column.is_text == other.columns[name].is_text
        column.array.validate(full=True)
        assert repr(column.array.to_pylist()) == repr(other.columns[name].array.to_pylist()), name


@MANY
@given(case=cases(), is_little=st.booleans())
def test_columns_of_cdr_are_those_of_its_rows(case, is_little) -> None:
    messages, rows = case
    store = ros_messages.typestore(messages)
    payloads = [
        bytes(
            store.serialize_cdr(ros_messages.instance(store, messages, row), "pkg/msg/Outer", little_endian=is_little)
        )
        for row in rows
    ]
    decode = decoder("pkg/msg/Outer", "ros2msg", ros_messages.text(messages))
    assert_same(columns_of(decode, payloads), columns_of_rows(rows))


@MANY
@given(case=cases())
def test_columns_of_ros_1_are_those_of_its_rows(case) -> None:
    messages, rows = case
    store = ros_messages.typestore(messages)
    payloads = [
        bytes(store.serialize_ros1(ros_messages.instance(store, messages, row), "pkg/msg/Outer")) for row in rows
    ]
    decode = decoder("pkg/Outer", "ros1msg", ros_messages.text(messages), is_ros1=True)
    assert_same(columns_of(decode, payloads), columns_of_rows(rows))


@MANY
@given(case=cases(), data=st.data())
def test_bytes_that_are_no_such_message_are_refused_or_say_what_their_rows_say(case, data) -> None:
    messages, rows = case
    store = ros_messages.typestore(messages)
    text = ros_messages.text(messages)
    payloads = [
        bytes(store.serialize_cdr(ros_messages.instance(store, messages, row), "pkg/msg/Outer")) for row in rows
    ]
    which = data.draw(st.integers(0, len(payloads) - 1))
    broken = bytearray(payloads[which])
    for _ in range(data.draw(st.integers(1, 3))):
        broken[data.draw(st.integers(0, len(broken) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, 4))
    payloads[which] = bytes(broken[: len(broken) - cut])
    columns = columns_of(decoder("pkg/msg/Outer", "ros2msg", text), payloads)
    if columns is None:
        return
    decode = decoder("pkg/msg/Outer", "ros2msg", text)
    assert_same(columns, columns_of_rows([decode(payload) for payload in payloads]))


@pytest.mark.parametrize("length", [0, 1, 7, 8, 9, 100])
@pytest.mark.parametrize("first", ["", "uint8 first", "uint16 first", "float64 first"])
@pytest.mark.parametrize(
    "item", ["float64 a\nuint8 b", "uint8 a\nuint16 b\nuint8 c", "uint8[3] a", "float32 a\nuint64 b"]
)
def test_items_of_a_fixed_size_lie_where_alignment_puts_them(length: int, first: str, item: str) -> None:
    text = f"{first}\nInner[] x\nuint8 last\n{'=' * 80}\nMSG: pkg/Inner\n{item}"
    fields = dict(line.split()[::-1] for line in item.splitlines())
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text, "pkg/msg/Outer"))
    inner = store.types["pkg/msg/Inner"]
    rows, payloads = [], []
    for number in range(3):
        values = [
            {
                name: (bytes([at] * 3) if "[" in type_ else at % 200 + (0.5 if "float" in type_ else 0))
                for name, type_ in fields.items()
            }
            for at in range(length + number)
        ]
        items = [
            inner(**{k: np.frombuffer(v, np.uint8) if isinstance(v, bytes) else v for k, v in value.items()})
            for value in values
        ]
        firsts = {"first": number + (0.5 if "float" in first else 0)} if first else {}
        message = store.types["pkg/msg/Outer"](**firsts, x=items, last=number)
        payloads.append(bytes(store.serialize_cdr(message, "pkg/msg/Outer")))
        rows.append({**firsts, "x": values, "last": number})
    assert_same(columns_of(decoder("pkg/msg/Outer", "ros2msg", text), payloads), columns_of_rows(rows))


def in_columns(text: str, payloads: list[bytes]) -> Block | None:
    return columns_of(decoder("pkg/msg/Outer", "ros2msg", text), payloads)


def chained(depth: int) -> str:
    """Messages each of which has two lists of the next."""
    sections = [f"MSG: pkg/M{at}\nM{at + 1}[] a\nM{at + 1}[] b" for at in range(depth)]
    return f"\n{'=' * 80}\n".join(["M0[] a\nM0[] b", *sections, f"MSG: pkg/M{depth}\nstring s"])


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("float64[4000000000] x", 64),
        ("string[4000000000] x", 64),
        (f"Inner[4000000000] x\n{'=' * 80}\nMSG: pkg/Inner\nfloat64[4000000000] y", 64),
        (f"uint8[] u\nOuter[] x\n{'=' * 80}\nMSG: pkg/Outer\nuint8[] u\nOuter[] x", 8),
        (chained(30), 8),
        ("string[] x", 1_000_000),
        (f"Inner[] x\n{'=' * 80}\nMSG: pkg/Inner", 4),
    ],
    ids=[
        "long array",
        "many texts",
        "arrays in arrays",
        "message in itself",
        "lists in lists",
        "a long list",
        "nothings",
    ],
)
def test_what_would_take_long_or_much_memory_by_columns_is_left_to_rows(text: str, size: int) -> None:
    tracemalloc.start()
    begin = time.process_time()
    try:
        in_columns(text, [b"\0\1\0\0" + bytes(size)] * 2)
        payload = b"\0\1\0\0" + b"\xff" * 4 + bytes(size)
        assert in_columns(text, [payload] * 2) is None
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 100e6
    assert time.process_time() - begin < 5


def test_messages_of_two_byte_orders_or_without_a_head_are_left_to_rows() -> None:
    little, big = b"\0\1\0\0\1\0\0\0", b"\0\0\0\0\0\0\0\1"
    assert in_columns("uint32 x", [little, little]) is not None
    assert in_columns("uint32 x", [big, big]) is not None
    for odd in (
        [little, big],
        [b""],
        [b"\0"],
        [b"\0\7\0\0\1\0\0\0"],
        [little, little[:-1]],
        [little, little + bytes(4)],
    ):
        assert in_columns("uint32 x", odd) is None


JOINTS = "std_msgs/Header header\nstring[] name\nfloat64[] position\nuint8[] raw"


def joint_states(count: int) -> list[bytes]:
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(JOINTS, "p/msg/Joints"))
    header, time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    return [
        bytes(
            store.serialize_cdr(
                store.types["p/msg/Joints"](
                    header=header(stamp=time(sec=at, nanosec=5), frame_id="base"),
                    name=["a", "b"],
                    position=np.array([0.5 * at, 1.5]),
                    raw=np.frombuffer(bytes([at % 256, 1]), np.uint8),
                ),
                "p/msg/Joints",
            )
        )
        for at in range(count)
    ]


def write(path: Path, payloads: list[bytes]) -> Path:
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(JOINTS, "p/msg/Joints"))
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=4096)
        writer.start(profile="ros2")
        text = store.generate_msgdef("p/msg/Joints", ros_version=2)[0]
        schema = writer.register_schema("p/msg/Joints", "ros2msg", text.encode())
        channel = writer.register_channel("/joints", "cdr", schema)
        for at, payload in enumerate(payloads):
            writer.add_message(channel, at * 10**8, payload, at * 10**8)
        writer.finish()
    return path


@pytest.mark.parametrize("columns", [None, ["position"], ["header"], ["raw", "header.stamp.sec"]])
def test_the_columns_of_a_topic_are_those_of_its_rows(tmp_path: Path, columns: list[str] | None) -> None:
    with Recording(write(tmp_path / "a.mcap", joint_states(300))) as recording:
        table = recording["/joints"].to_arrow(columns=columns)
        rows = [
            flatten(row if columns is None else project(row, columns), "_ts") for row in recording["/joints"].rows()
        ]
        assert table.rename_columns(["_ts", *table.column_names[1:]]).to_pylist() == rows
        assert len(table) == 300


def test_a_message_that_is_not_what_its_type_says_costs_the_others_nothing(tmp_path: Path) -> None:
    payloads = joint_states(100)
    payloads[2] = payloads[2][:-3]
    with Recording(write(tmp_path / "a.mcap", payloads)) as recording:
        with pytest.warns(UndecodedWarning, match="no p/msg/Joints") as warned:
            table = recording["/joints"].to_arrow()
        assert len(warned) == 1
    assert table["_data"].to_pylist() == [None, None, payloads[2], *[None] * 97]
    assert table["position"].to_pylist() == [[0.5 * at, 1.5] if at != 2 else None for at in range(100)]


def test_few_messages_are_left_to_rows() -> None:
    decode = decoder("pkg/msg/Outer", "ros2msg", "uint32 x")
    payloads = [b"\0\1\0\0\1\0\0\0"] * LEAST_MESSAGES
    assert RosColumnReader(lambda: decode, None).read(payloads) is not None
    assert RosColumnReader(lambda: decode, None).read(payloads[1:]) is None


IDL = """module pkg { module msg {
  enum Color { RED, GREEN };
  struct Outer { double m[2][3]; octet o[2][2]; Color c; sequence<Color> more; sequence<double> two[2]; string t; };
}; };"""


def test_arrays_in_arrays_and_enumerations_are_what_their_rows_are() -> None:
    payloads = []
    for number in range(4):
        data = b"\0\1\0\0" + struct.pack("<6d4BI", *(0.5 * number + at for at in range(6)), 1, 2, 3, number, number % 2)
        data += struct.pack(f"<I{number}I", number, *range(number))
        for length in (number, 1):  # doubles lie at multiples of 8, counted from behind the head
            data += struct.pack("<I", length)
            data += bytes(-(len(data) - 4) % 8) * (length > 0) + struct.pack(f"<{length}d", *[0.25] * length)
        payloads.append(data + struct.pack("<I3s", 3, b"ab\0"))
    decode = decoder("pkg/msg/Outer", "ros2idl", IDL)
    rows = [decode(payload) for payload in payloads]
    assert rows[3]["m"] == [[1.5, 2.5, 3.5], [4.5, 5.5, 6.5]]
    assert (rows[3]["o"], rows[3]["more"], rows[3]["two"]) == ([b"\1\2", b"\3\3"], [0, 1, 2], [[0.25] * 3, [0.25]])
    assert_same(columns_of(decode, payloads), columns_of_rows(rows))
