"""A topic's own message says all that its rows say, and ROS's own tools take it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ml_dash_mcap.codecs.ros.message_columns import Constant
from ml_dash_mcap.codecs.ros.pack import pack
from ml_dash_mcap.codecs.ros.unpack import unpack
from ml_dash_mcap.formats.ros.messages import arrow_blocks, lossless, lossless_definitions, restore
from ml_dash_mcap.formats.ros.messages.fill import MisfitError, fill
from ml_dash_mcap.formats.ros.messages.lossless import Message
from ml_dash_mcap.rows.dotted import flatten
from ml_dash_mcap.rows.table import block_of
from ml_dash_mcap.rows.value_shapes import of_values
from tests.support.examples import examples
from tests.support.row_shapes import tables, typed

Row = dict[str, Any]
PACKAGE = "ml_dash_msgs"
ROS1, ROS2 = True, False


def timed(rows: list[Row]) -> list[Row]:
    return [{**row, "_ts": 0.1 * number} for number, row in enumerate(rows)]


def designed(rows: list[Row], *, is_json: bool = False) -> Message:
    return lossless.design(of_values(rows), "robot/arm", set(), is_json=is_json)


def to_bytes(message: Message, rows: list[Row], *, is_ros1: bool = False, room: int = 0) -> list[bytes]:
    stamp = {"secs": Constant(1), "nsecs": Constant(2)} if is_ros1 else {"sec": Constant(1), "nanosec": Constant(2)}
    header: dict[str, Any] = {"stamp": stamp, "frame_id": Constant("base")}
    times = np.array([row["_ts"] for row in rows])
    column = {"header": {"seq": Constant(0), **header}, "ts": times, **fill(message, rows)}
    definitions = lossless_definitions.describe(message, PACKAGE, is_ros1=is_ros1)
    return pack(definitions, column, len(rows), is_ros1=is_ros1, room=room).messages(room)


def to_rows(message: Message, messages: list[bytes], *, is_ros1: bool = False) -> list[Row]:
    definitions = lossless_definitions.describe(message, PACKAGE, is_ros1=is_ros1)
    return restore.rows(message, unpack(definitions, messages, is_ros1=is_ros1))


@given(tables(), st.sampled_from([ROS1, ROS2]), st.booleans())
@settings(max_examples=examples(200), deadline=None)
def test_any_rows_come_back_bit_for_bit(rows: list[Row], is_ros1: bool, is_json: bool) -> None:
    rows = timed(rows)
    message = designed(rows, is_json=is_json)
    back = to_rows(message, to_bytes(message, rows, is_ros1=is_ros1, room=31), is_ros1=is_ros1)
    assert typed(back) == typed(rows)


@given(tables())
@settings(max_examples=examples(100), deadline=None)
def test_the_text_of_a_message_says_what_it_is(rows: list[Row]) -> None:
    message = designed(timed(rows))
    assert (
        lossless_definitions.parse(f"{PACKAGE}/msg/{message.name}", lossless_definitions.embedded(message, PACKAGE))
        == message
    )


@given(tables(), st.sampled_from([ROS1, ROS2]))
@settings(max_examples=examples(60), deadline=None)
def test_the_bytes_are_those_that_rosbags_writes(rows: list[Row], is_ros1: bool) -> None:
    rows = timed(rows)
    message = designed(rows)
    store = get_typestore(Stores.EMPTY)
    name = f"{PACKAGE}/msg/{message.name}"
    store.register(get_types_from_msg(lossless_definitions.embedded(message, PACKAGE, is_ros1=is_ros1), name))
    if is_ros1:
        store.register(get_types_from_msg("int32 sec\nuint32 nanosec", "builtin_interfaces/msg/Time"))
    for data in to_bytes(message, rows, is_ros1=is_ros1):
        if is_ros1:
            again = bytes(store.serialize_ros1(store.deserialize_ros1(data, name), name))
        else:
            again = bytes(store.serialize_cdr(store.deserialize_cdr(data, name), name))
        assert again == data


@pytest.mark.parametrize("is_ros1", [ROS1, ROS2])
def test_long_values_of_various_lengths_come_back(is_ros1: bool) -> None:
    rows = timed([{"image": bytes([number]) * number**2, "text": "x" * number} for number in (40, 0, 31, 77)])
    message = designed(rows)
    assert to_rows(message, to_bytes(message, rows, is_ros1=is_ros1, room=5), is_ros1=is_ros1) == rows


def test_plain_numbers_make_a_message_of_one_size() -> None:
    rows = timed([{"q": [0.5] * 7, "gripper": 0.04, "ok": True, "n": 3, "T": [[0.5] * 4] * 4}] * 3)
    message = designed(rows)
    assert lossless_definitions.text(message, PACKAGE).splitlines()[2:] == [
        "std_msgs/Header header",
        "float64 ts  # the exact time stamp, in seconds",
        "float64[7] q",
        "float64 gripper",
        "bool ok",
        "int64 n",
        "float64[16] t  # shape 4x4, row by row",
    ]
    assert len({len(data) for data in to_bytes(message, rows)}) == 1


def test_what_a_type_cannot_say_is_said_beside_it() -> None:
    rows = timed([{"q": [0, 0.5], "x": 1, "any": {}}, {"q": [0.5, 0.5], "x": 0.5, "s": "a", "d": {"k": None}}])
    text = lossless_definitions.text(designed(rows), PACKAGE)
    assert "uint8[5] field_state" in text
    assert "float64[2] q\nuint8[2] q_integers" in text
    assert "ml_dash_msgs/RobotArmD d" in text
    assert "string f_any  # JSON" not in text
    assert "string any  # JSON" in text


def test_units_stand_in_brackets_and_nothing_else_does() -> None:
    message = designed(timed([{"q": [0.5], "odd [x]": 1}]))
    message = Message(
        message.name, message.fields, False, about={"topic": "robot", "metadata": {"units": {"q": "rad"}, "n": [1]}}
    )
    text = lossless_definitions.text(message, PACKAGE)
    assert "float64[1] q  # [rad]" in text
    assert "[" not in text.splitlines()[0]
    assert lossless_definitions.parse(message.name, text) == message


UTF8 = st.text(st.characters(exclude_categories=["Cs"]), max_size=3) | st.just("\0")
LEAVES = {"": st.integers(-(2**63), 2**63 - 1), "b": UTF8, "v": st.lists(st.floats(), min_size=1, max_size=2)}
NESTED = st.fixed_dictionaries(
    {"": UTF8, "a": st.fixed_dictionaries(LEAVES), "n": st.booleans(), "_ts": st.floats(0, 9)}
)


@given(st.lists(NESTED, min_size=1, max_size=4))
def test_columns_of_rows_have_the_shape_of_the_rows(rows: list[Row]) -> None:
    block = block_of([flatten(row, "_ts") for row in rows])
    assert arrow_blocks.shape_of(block) == of_values(rows)


def test_rows_of_another_form_do_not_fit() -> None:
    message = designed(timed([{"q": [0.5, 0.5]}]))
    for odd in ({"q": [0.5]}, {"q": [1, 0.5]}, {"q": None}, {}, {"q": [0.5, 0.5], "r": 1}, {"q": [0.5, True]}):
        with pytest.raises(MisfitError):
            fill(message, timed([odd]))


@pytest.mark.parametrize("cut", [1, 3, 4, 11, 40])
def test_a_message_that_is_cut_or_too_long_is_refused(cut: int) -> None:
    rows = timed([{"q": [0.5] * 7, "s": "text", "r": [{"k": 1}]}, {"q": [0.5] * 7, "s": "", "r": []}])
    message = designed(rows)
    data = to_bytes(message, rows)
    with pytest.raises(ValueError, match="message"):
        to_rows(message, [data[0][:-cut]])
    with pytest.raises(ValueError, match="message"):
        to_rows(message, [data[0], data[1] + bytes(cut + 3)])
