"""Names that anybody may have chosen become names that ROS accepts."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ml_dash_mcap.errors import ConversionError
from ml_dash_mcap.formats.ros import ros_names

FIELD = re.compile(r"(?!.*__)(?!.*_$)[a-z][a-z0-9_]*")
MESSAGE = re.compile(r"[A-Z][A-Za-z0-9]*")
"""Of `rosidl_adapter` 3.3 (`VALID_FIELD_NAME_PATTERN`, `VALID_MESSAGE_NAME_PATTERN`)."""
TOPIC = re.compile(r"(?!.*__)(?!.*_$)(/[A-Za-z_][A-Za-z0-9_]*)+")
"""https://design.ros2.org/articles/topic_and_service_names.html"""


@pytest.mark.parametrize(
    ("key", "name"),
    [
        ("q", "q"),
        ("eeQuat", "ee_quat"),
        ("T_ee", "t_ee"),
        ("T_EE2Base", "t_ee2_base"),
        ("joint positions [rad]", "joint_positions_rad"),
        ("a__b_", "a_b"),
        ("2nd", "f_2nd"),
        ("class", "f_class"),
        ("None", "f_none"),
        ("int", "f_int"),
        ("header", "f_header"),
        ("ts", "f_ts"),
        ("_ts", "f_ts"),
        ("", "f"),
        ("\u89d2\u5ea6", "f"),
        ("a.b", "a_b"),
    ],
)
def test_a_key_becomes_a_fields_name(key: str, name: str) -> None:
    assert ros_names.field(key) == name


def test_keys_that_look_alike_stay_apart() -> None:
    assert ros_names.fields(["eeQuat", "ee_quat", "ee quat"]) == {
        "eeQuat": "ee_quat",
        "ee_quat": "ee_quat_2",
        "ee quat": "ee_quat_3",
    }


@pytest.mark.parametrize(
    ("topic", "name"),
    [
        ("robot", "/robot"),
        ("cam/left-camera.0", "/cam/left_camera_0"),
        ("/robot/", "/robot"),
        ("_hidden/2", "/hidden/t_2"),
        ("../x", "/x"),
        ("\u89d2\u5ea6", "/topic"),
    ],
)
def test_a_topic_becomes_a_topic_of_ros(topic: str, name: str) -> None:
    assert ros_names.topic(topic) == name


def test_topics_that_look_alike_stay_apart() -> None:
    assert ros_names.topic("a_b", {ros_names.topic("a.b")}) == "/a_b_2"


@pytest.mark.parametrize(
    ("topic", "name"),
    [("cam/wrist", "CamWrist"), ("robot", "Robot"), ("3d", "Topic3d"), ("a_b", "AB"), ("\u89d2", "Topic")],
)
def test_a_topic_names_its_message(topic: str, name: str) -> None:
    assert ros_names.message(topic) == name


def test_messages_of_topics_that_look_alike_stay_apart() -> None:
    assert ros_names.message("a/b", {"AB"}) == "ABV2"


@given(st.lists(st.text(max_size=12), max_size=6, unique=True))
def test_any_keys_become_different_names_that_ros_takes(keys: list[str]) -> None:
    found = ros_names.fields(keys)
    assert list(found) == keys
    assert len(set(found.values())) == len(keys)
    assert all(FIELD.fullmatch(name) and name not in ros_names.TAKEN_FIELDS for name in found.values())


@given(st.text(min_size=1, max_size=20))
def test_any_topic_becomes_one_that_ros_takes(topic: str) -> None:
    assert TOPIC.fullmatch(ros_names.topic(topic))
    assert TOPIC.fullmatch(ros_names.topic(topic, {ros_names.topic(topic)}))
    assert MESSAGE.fullmatch(ros_names.message(topic))


@pytest.mark.parametrize("name", ["Upper", "a__b", "a_", "9a", "", "a-b", None])
def test_a_package_that_ros_refuses_is_named(name: str) -> None:
    with pytest.raises(ConversionError, match="ROS package"):
        ros_names.check_package(name)


@pytest.mark.parametrize("name", ["robot", "/a//b", "/a/", "/1", "/a__b", "/a-b", ""])
def test_a_topic_that_ros_refuses_is_named(name: str) -> None:
    with pytest.raises(ConversionError, match="no ROS topic"):
        ros_names.check_topic(name)
