"""Fields become standard messages where name, shape and type fit, and metadata comes before any convention."""

from __future__ import annotations

import math
import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ml_dash_mcap.errors import ConversionError, ConversionWarning
from ml_dash_mcap.meaning import units
from tests.support.bags import ROBOT, Found, export, record, with_rosbags
from tests.support.examples import examples

Row = dict[str, Any]


def messages(
    tmp_path: Path, rows: list[Row], metadata: dict[str, Any] | None = None, **options: Any
) -> dict[str, list[Found]]:
    """Return the standard messages of a bag, by topic."""
    record(tmp_path / "run", {"t": rows}, {"t": metadata or {}})
    found: dict[str, list[Found]] = {}
    for one in with_rosbags(export(tmp_path / "run", tmp_path / "bag", profile="std", **options)):
        found.setdefault(one.topic, []).append(one)
    return found


def only(
    tmp_path: Path, rows: list[Row], metadata: dict[str, Any] | None = None, **options: Any
) -> tuple[str, str, Any]:
    """Return topic, type and first message of the one standard topic that there is."""
    found = messages(tmp_path, rows, metadata, **options)
    assert len(found) == 1
    ((topic, said),) = found.items()
    return topic, said[0].type, said[0].message


def numbers(value: Any) -> list[float]:
    return [getattr(value, name) for name in "xyzw" if hasattr(value, name)]


QUATERNION = [0.0, 0.0, 0.6, 0.8]
TURNED = [[0.0, -1.0, 0.0, 1.0], [1.0, 0.0, 0.0, 2.0], [0.0, 0.0, 1.0, 3.0], [0.0, 0.0, 0.0, 1.0]]
HALF = math.sqrt(0.5)


def test_joint_states_take_names_and_units_from_the_metadata(tmp_path: Path) -> None:
    said = {"joint_names": ["a", "b"], "units": {"q": "deg", "tau": "mNm"}, "frame_id": "base"}
    topic, type_, message = only(tmp_path, [{"q": [180.0, 90.0], "tau": [1.0, 2.0]}], said)
    assert (topic, type_) == ("/t/joint_states", "sensor_msgs/msg/JointState")
    assert message.name == ["a", "b"]
    assert message.position.tolist() == [math.pi, math.pi / 2]
    assert message.velocity.tolist() == []
    assert message.effort.tolist() == [0.001, 0.002]
    assert message.header.frame_id == "base"


def test_fields_of_different_lengths_are_no_joint_states(tmp_path: Path) -> None:
    with pytest.warns(ConversionWarning, match="no standard message"):
        assert messages(tmp_path, [{"q": [0.5, 0.5], "qd": [0.5]}]) == {}


def test_joint_names_of_another_number_are_an_error(tmp_path: Path) -> None:
    with pytest.raises(ConversionError, match="joint_names are 1, and 'q' has 2 values"):
        messages(tmp_path, [{"q": [0.5, 0.5]}], {"joint_names": ["a"]})


def test_a_command_and_a_gripper_are_joint_states_of_their_own(tmp_path: Path) -> None:
    found = messages(tmp_path, [{"target_q": [1, 2], "gripper": 0.04}])
    assert found["/t/joint_command"][0].message.position.tolist() == [1.0, 2.0]
    gripper = found["/t/gripper"][0].message
    assert (gripper.name, gripper.position.tolist()) == (["gripper"], [0.04])


def test_the_names_of_the_arms_joints_are_not_those_of_the_gripper(tmp_path: Path) -> None:
    found = messages(tmp_path, [{"q": [0.5] * 2, "gripper": [0.1, 0.2]}], {"joint_names": ["a", "b"]})
    assert found["/t/joint_states"][0].message.name == ["a", "b"]
    assert found["/t/gripper"][0].message.name == ["gripper1", "gripper2"]


def test_a_mapping_names_the_joints_of_the_gripper(tmp_path: Path) -> None:
    said = {"gripper": {"type": "sensor_msgs/JointState", "position": "width", "joint_names": ["finger"]}}
    found = messages(tmp_path, [{"width": 0.04}], {"joint_names": ["a", "b"]}, mapping={"t": said})
    assert found["/t/gripper"][0].message.name == ["finger"]


@pytest.mark.parametrize(
    ("row", "topic"),
    [
        ({"ee_pos": [1.0, 2.0, 3.0], "ee_quat": QUATERNION}, "/t/ee_pose"),
        ({"pos": [1.0, 2.0, 3.0], "quat": QUATERNION}, "/t/pose"),
        ({"position": [1.0, 2.0, 3.0], "orientation": QUATERNION}, "/t/pose"),
        ({"ee_pose": [1.0, 2.0, 3.0, *QUATERNION]}, "/t/ee_pose"),
    ],
)
def test_a_position_and_a_quaternion_are_a_pose(tmp_path: Path, row: Row, topic: str) -> None:
    found, type_, message = only(tmp_path, [row], {"quat_order": "xyzw"})
    assert (found, type_) == (topic, "geometry_msgs/msg/PoseStamped")
    assert numbers(message.pose.position) == [1.0, 2.0, 3.0]
    assert numbers(message.pose.orientation) == QUATERNION


@pytest.mark.parametrize("matrix", [TURNED, [number for row in TURNED for number in row]])
@pytest.mark.parametrize("name", ["T_base_ee", "pose"])
def test_a_matrix_is_a_pose(tmp_path: Path, matrix: list[Any], name: str) -> None:
    topic, _, message = only(tmp_path, [{name: matrix}], {"units": {name: "mm"}})
    assert topic == "/t/pose"
    assert numbers(message.pose.position) == pytest.approx([0.001, 0.002, 0.003])
    assert numbers(message.pose.orientation) == pytest.approx([0.0, 0.0, HALF, HALF])


def test_a_matrix_that_is_no_pose_is_named_with_its_row(tmp_path: Path) -> None:
    with pytest.raises(ConversionError, match=r"'t', row 1 .*'pose' is no pose"):
        messages(tmp_path, [{"pose": TURNED}, {"pose": [[2.0 * number for number in row] for row in TURNED]}])


def test_quaternions_are_turned_round_where_the_metadata_says_so(tmp_path: Path) -> None:
    row = {"ee_pos": [1.0, 2.0, 3.0], "ee_quat": [0.8, 0.0, 0.0, 0.6]}
    assert numbers(only(tmp_path, [row], {"quat_order": "wxyz"})[2].pose.orientation) == [0.0, 0.0, 0.6, 0.8]


def test_a_quaternion_order_that_there_is_not_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ConversionError, match="quat_order is 'wzyx'"):
        messages(tmp_path, [{"ee_pos": [1.0, 2.0, 3.0], "ee_quat": QUATERNION}], {"quat_order": "wzyx"})


def test_a_quaternion_that_looks_like_the_other_order_is_warned_about(tmp_path: Path) -> None:
    with pytest.warns(ConversionWarning, match="looks like w x y z"):
        messages(tmp_path, [{"pos": [1.0, 2.0, 3.0], "quat": [1.0, 0.0, 0.0, 0.0]}])


def test_poses_are_transforms_where_asked(tmp_path: Path) -> None:
    row = {"ee_pos": [1.0, 2.0, 3.0], "ee_quat": QUATERNION}
    found = messages(tmp_path, [row], {"frame_id": "base"}, tf=True)
    (transform,) = found["/tf"][0].message.transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("base", "t/ee_pose")
    assert numbers(transform.transform.translation) == [1.0, 2.0, 3.0]
    assert numbers(transform.transform.rotation) == QUATERNION


def test_velocities_and_forces(tmp_path: Path) -> None:
    found = messages(tmp_path, [{"ee_vel": [1, 2, 3, 4, 5, 6], "force": [1.0, 2.0, 3.0], "torque": [4.0, 5.0, 6.0]}])
    twist = found["/t/twist"][0].message.twist
    assert (numbers(twist.linear), numbers(twist.angular)) == ([1, 2, 3], [4, 5, 6])
    wrench = found["/t/wrench"][0].message.wrench
    assert (numbers(wrench.force), numbers(wrench.torque)) == ([1, 2, 3], [4, 5, 6])


def test_an_imu_says_what_it_does_not_measure(tmp_path: Path) -> None:
    _, type_, message = only(tmp_path, [{"accel": [0.0, 0.0, 1.0]}], {"units": {"accel": "g"}})
    assert type_ == "sensor_msgs/msg/Imu"
    assert numbers(message.linear_acceleration) == [0.0, 0.0, 9.80665]
    assert message.linear_acceleration_covariance.tolist() == [0.0] * 9
    assert (message.orientation_covariance[0], message.angular_velocity_covariance[0]) == (-1, -1)


def test_a_magnetic_field_is_in_tesla_and_a_temperature_in_degrees(tmp_path: Path) -> None:
    found = messages(tmp_path, [{"mag": [10.0, 20.0, 30.0], "temp": 300.0}], {"units": {"temp": "K"}})
    assert numbers(found["/t/mag"][0].message.magnetic_field) == pytest.approx([1e-5, 2e-5, 3e-5])
    assert found["/t/temp"][0].message.temperature == pytest.approx(26.85)


@pytest.mark.parametrize(
    ("unit", "linear", "angular"),
    [
        ("mm/s", 0.001, 1.0),
        ("deg/s", 1.0, math.pi / 180),
        ("mm/s, deg/s", 0.001, math.pi / 180),
        (["m/s", "rpm"], 1.0, math.pi / 30),
    ],
)
def test_the_two_halves_of_a_twist_have_units_of_their_own(
    tmp_path: Path, unit: Any, linear: float, angular: float
) -> None:
    message = only(tmp_path, [{"twist": [1.0] * 6}], {"units": {"twist": unit}})[2]
    assert numbers(message.twist.linear) == [linear] * 3
    assert numbers(message.twist.angular) == [angular] * 3


@pytest.mark.parametrize(
    ("row", "said", "match"),
    [
        ({"wrench": [1.0] * 6}, {"units": {"wrench": "lb"}}, "'wrench' is in 'lb'; as force .*; as torque these"),
        ({"twist": [1.0] * 6}, {"units": {"twist": "mm/s, m"}}, "'twist' is in 'mm/s, m'"),
        ({"q": [0.5]}, {"units": "deg"}, "its units are 'deg'; they must be a dict"),
        ({"q": [0.5]}, {"joint_names": "a"}, "its joint_names are 'a'; they must be a list"),
        ({"q": [0.5]}, {"frame_id": 5}, "its frame_id is 5; it must be a name"),
        ({"depth": [[0.5]]}, {"units": {"depth": "deg"}}, "'depth' is in 'deg'; as length"),
    ],
)
def test_metadata_that_do_not_fit_are_named(tmp_path: Path, row: Row, said: dict[str, Any], match: str) -> None:
    with pytest.raises(ConversionError, match=rf"topic 't': .*{match}.*mapping=\{{'t': .*on_bad='lossless'"):
        messages(tmp_path, [row], said)


@pytest.mark.parametrize("said", [{"left.q": "deg"}, {"left": {"q": "deg"}}])
def test_units_of_nested_fields_are_nested_too_or_dotted(tmp_path: Path, said: dict[str, Any]) -> None:
    assert only(tmp_path, [{"left": {"q": [180.0]}}], {"units": said})[2].position.tolist() == [math.pi]


def test_units_of_a_field_that_is_not_there_are_warned_about(tmp_path: Path) -> None:
    with pytest.warns(
        ConversionWarning, match=r"'t': its units have 'q', and there is no such field; there are left\.q"
    ):
        messages(tmp_path, [{"left": {"q": [180.0]}}], {"units": {"q": "deg"}})


def test_a_unit_that_does_not_fit_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConversionError, match="'temp' is in 'rad'; as temperature these are known: degC"):
        messages(tmp_path, [{"temp": 300.0}], {"units": {"temp": "rad"}})


def test_a_camera(tmp_path: Path) -> None:
    k = [[500.0, 0.0, 320.0], [0.0, 501.0, 240.0], [0.0, 0.0, 1.0]]
    _, type_, message = only(tmp_path, [{"K": k, "dist": [0.1] * 5, "width": 640, "height": 480}])
    assert type_ == "sensor_msgs/msg/CameraInfo"
    assert (message.width, message.height, message.distortion_model) == (640, 480, "plumb_bob")
    assert message.k.tolist() == [number for row in k for number in row]
    assert message.p.tolist() == [500.0, 0.0, 320.0, 0.0, 0.0, 501.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]


def test_images(tmp_path: Path) -> None:
    pixels = np.arange(24).reshape(2, 4, 3).tolist()
    found = messages(tmp_path, [{"rgb": pixels, "depth": [[1000, 2000], [3000, 65535]], "jpeg": b"\xff\xd8\xff"}])
    image = found["/t/image"][0].message
    assert (image.encoding, image.height, image.width, image.step) == ("rgb8", 2, 4, 12)
    assert image.data.tolist() == list(range(24))
    depth = found["/t/depth"][0].message
    assert (depth.encoding, depth.step, depth.data.view(np.uint16).tolist()) == ("16UC1", 4, [1000, 2000, 3000, 65535])
    compressed = found["/t/image/compressed"][0].message
    assert (compressed.format, bytes(compressed.data)) == ("jpeg", b"\xff\xd8\xff")


@pytest.mark.parametrize(
    ("depth", "unit", "encoding", "found"),
    [
        ([[1500.0]], "mm", "32FC1", 1.5),
        ([[2]], "m", "16UC1", 2000),
        ([[2]], "cm", "16UC1", 20),
        ([[2]], "mm", "16UC1", 2),
        ([[0.5]], "m", "32FC1", 0.5),
    ],
)
def test_depths_are_in_the_unit_that_their_encoding_means(
    tmp_path: Path, depth: Any, unit: str, encoding: str, found: float
) -> None:
    message = only(tmp_path, [{"depth": depth}], {"units": {"depth": unit}})[2]
    assert message.encoding == encoding
    assert message.data.view(np.float32 if encoding == "32FC1" else np.uint16).tolist() == [found]


@pytest.mark.parametrize("row", [{"image": [[1, 2]]}, {"depth": [[[1, 2, 3]]]}])
def test_pixels_that_may_be_colours_or_depths_are_left_alone(tmp_path: Path, row: Row) -> None:
    with pytest.warns(ConversionWarning, match="no standard message"):
        assert messages(tmp_path, [row]) == {}


@pytest.mark.parametrize("size", [-1, 2.5, 2**32])
def test_a_size_that_is_no_number_of_pixels_is_named_with_its_row(tmp_path: Path, size: float) -> None:
    with pytest.raises(ConversionError, match=rf"row 0 .*'width' is {size}, which is no number of pixels"):
        messages(tmp_path, [{"K": [[1.0] * 3] * 3, "width": size}])


def test_pixels_that_do_not_fit_are_named_with_their_row(tmp_path: Path) -> None:
    with pytest.raises(ConversionError, match=r"row 1 .*outside 0 to 255"):
        messages(tmp_path, [{"rgb": [[[1, 2, 3]]]}, {"rgb": [[[1, 2, 256]]]}])


def test_fields_in_nested_dicts_have_topics_below(tmp_path: Path) -> None:
    topic, type_, _ = only(tmp_path, [{"left": {"sensor": {"gyro": [1.0, 2.0, 3.0]}}}])
    assert (topic, type_) == ("/t/left/sensor/imu", "sensor_msgs/msg/Imu")


def test_rows_without_a_field_have_no_message_of_it(tmp_path: Path) -> None:
    found = messages(tmp_path, [{"q": [0.5], "temp": 1.0}, {"q": [0.5]}, {"q": None, "temp": 2.0}])
    assert [one.time_ns for one in found["/t/joint_states"]] == [0, 10_000_000]
    assert [one.message.temperature for one in found["/t/temp"]] == [1.0, 2.0]


# -- what the caller says ---------------------------------------------------------------------------------------------


def test_a_mapping_comes_before_conventions(tmp_path: Path) -> None:
    mapping = {
        "t": {
            "/arm/state": {"type": "sensor_msgs/JointState", "position": "obs.angles", "joint_names": ["a", "b"]},
            "pose": {"type": "geometry_msgs/msg/PoseStamped", "pose": "matrix", "frame_id": "world"},
            "gripper": None,
        }
    }
    row = {"obs": {"angles": [1.0, 2.0]}, "matrix": TURNED, "gripper": 0.5}
    found = messages(tmp_path, [row], mapping=mapping)
    assert sorted(found) == ["/arm/state", "/t/pose"]
    assert found["/arm/state"][0].message.name == ["a", "b"]
    assert found["/t/pose"][0].message.header.frame_id == "world"


@pytest.mark.parametrize(
    ("said", "match"),
    [
        (
            {"pose": {"type": "geometry_msgs/PoseStamped", "pose": "q"}},
            r"'q' is float64\[7\], which does not fit 'pose'|needs",
        ),
        ({"x": {"type": "geometry_msgs/Pose", "pose": "q"}}, "'geometry_msgs/Pose' is none of"),
        ({"x": {"type": "sensor_msgs/JointState", "position": "qq"}}, "no field 'qq'; there are q"),
        ({"x": {"type": "sensor_msgs/JointState", "where": "q"}}, "has no 'where'; it has position"),
        ({"x": {"type": "geometry_msgs/PoseStamped", "position": "ee_pos"}}, r"needs position\+orientation or pose"),
        ({"x": {"position": "q"}}, "`type`"),
        ({"/a//b": {"type": "sensor_msgs/JointState", "position": "q"}}, "no ROS topic"),
    ],
)
def test_a_mapping_that_does_not_fit_is_named(tmp_path: Path, said: dict[str, Any], match: str) -> None:
    row = {**ROBOT, "q": [0.5] * 5} if "pose" in said else ROBOT
    with pytest.raises(
        ConversionError, match=match if "pose" not in said else r"float64\[5\], which does not fit 'pose'"
    ):
        messages(tmp_path, [row], mapping={"t": said})


def test_a_mapping_comes_before_the_units_and_names_of_the_metadata(tmp_path: Path) -> None:
    said = {"type": "sensor_msgs/JointState", "position": "q", "effort": "f", "units": {"q": "deg"}}
    metadata = {"units": {"q": "rad", "f": "mNm"}}
    _, _, message = only(tmp_path, [{"q": [180.0], "f": [1.0]}], metadata, mapping={"t": {"joint_states": said}})
    assert (message.position.tolist(), message.effort.tolist()) == ([math.pi], [0.001])


def test_fields_of_different_lengths_that_were_asked_for_are_named(tmp_path: Path) -> None:
    said = {"x": {"type": "sensor_msgs/JointState", "position": "q", "velocity": "w"}}
    with pytest.raises(ConversionError, match="different numbers of joints: 'q' has 2, 'w' has 1"):
        messages(tmp_path, [{"q": [0.5, 0.5], "w": 1.0}], mapping={"t": said})


@pytest.mark.parametrize("topic", ["/t", "/u"])
def test_a_topic_that_is_taken_cannot_be_asked_for(tmp_path: Path, topic: str) -> None:
    record(tmp_path / "run", {"t": [{"q": [0.5]}], "u": [{"x": 1}]})
    mapping = {"t": {topic: {"type": "sensor_msgs/JointState", "position": "q"}}}
    with pytest.raises(ConversionError, match=f"'t': mapping of '{topic}': another topic has that name"):
        export(tmp_path / "run", tmp_path / "bag", mapping=mapping)


# -- arrays whose length changes --------------------------------------------------------------------------------------


ODD = {"t": {"joint_states": {"type": "sensor_msgs/JointState", "position": "odd"}}}
LEFT = {"t": {"pose": {"type": "geometry_msgs/PoseStamped", "position": "odd", "orientation": "quat"}}}


def joints(found: dict[str, list[Found]], topic: str = "/t/joint_states") -> list[Any]:
    """Names and positions of each message."""
    return [(one.message.name, one.message.position.tolist()) for one in found[topic]]


@pytest.mark.parametrize(("field", "mapping"), [("q", None), ("odd", ODD)])
def test_joints_may_change_from_message_to_message(tmp_path: Path, field: str, mapping: Any) -> None:
    rows: list[Row] = [{field: [0.5, 0.5]}, {"x": 1}, {field: [0.5]}, {field: []}]
    with pytest.warns(ConversionWarning, match="/t/joint_states: the number of joints changes, and nobody says their"):
        found = messages(tmp_path, rows, mapping=mapping)
    assert joints(found) == [(["joint1", "joint2"], [0.5, 0.5]), (["joint1"], [0.5]), ([], [])]


def test_joints_that_change_have_the_names_of_their_row(tmp_path: Path) -> None:
    rows: list[Row] = [
        {"name": ["b", "a"], "position": [1.0, 2.0], "velocity": [3.0, 4.0], "effort": []},
        {"name": ["c"], "position": [5], "velocity": [], "effort": [6.0]},
        {"name": [], "position": [], "velocity": [], "effort": []},
        {"name": ["d", "e", "ö"], "position": [7.0, 8.0, 9.0], "velocity": [], "effort": []},
    ]
    found = messages(tmp_path, rows, {"units": {"position": "deg"}})
    degrees = math.pi / 180
    assert joints(found) == [(row["name"], [degrees * angle for angle in row["position"]]) for row in rows]
    assert [one.message.velocity.tolist() for one in found["/t/joint_states"]] == [[3.0, 4.0], [], [], []]
    assert [one.message.effort.tolist() for one in found["/t/joint_states"]] == [[], [6.0], [], []]


@pytest.mark.parametrize("key", ["name", "names", "joint_names"])
def test_joints_have_the_names_that_the_row_says(tmp_path: Path, key: str) -> None:
    rows: list[Row] = [{key: ["a", "b"], "q": [1.0, 2.0]}, {key: ["b", "a"], "q": [2.0, 1.0]}]
    assert joints(messages(tmp_path, rows)) == [(["a", "b"], [1.0, 2.0]), (["b", "a"], [2.0, 1.0])]


def test_what_is_said_of_a_topic_comes_before_the_names_in_its_rows(tmp_path: Path) -> None:
    rows: list[Row] = [{"name": ["a", "b"], "q": [1.0, 2.0]}]
    assert joints(messages(tmp_path, rows, {"joint_names": ["c", "d"]})) == [(["c", "d"], [1.0, 2.0])]


def test_a_mapping_says_which_field_has_the_names(tmp_path: Path) -> None:
    said = {"type": "sensor_msgs/JointState", "position": "odd", "name": "who"}
    rows: list[Row] = [{"who": ["a"], "odd": [1.0]}, {"who": ["b", "c"], "odd": [1.0, 2.0]}]
    found = messages(tmp_path, rows, mapping={"t": {"joint_states": said}})
    assert joints(found) == [(["a"], [1.0]), (["b", "c"], [1.0, 2.0])]
    with pytest.raises(ConversionError, match=r"field 'odd' is lists of float64 .* does not fit 'name'"):
        export(tmp_path / "run", tmp_path / "other", mapping={"t": {"joint_states": {**said, "name": "odd"}}})


def test_names_that_are_not_as_many_as_the_joints_are_told_and_not_used(tmp_path: Path) -> None:
    rows: list[Row] = [{"name": ["a", "b"], "q": [1.0, 2.0]}, {"name": ["c"], "q": [1.0, 2.0]}, {"q": [1.0, 2.0]}]
    with pytest.warns(ConversionWarning, match="field 'name' has other numbers of names than there are joints"):
        found = messages(tmp_path, rows)
    assert [names for names, _ in joints(found)] == [["a", "b"], ["joint1", "joint2"], ["joint1", "joint2"]]


def test_joints_that_are_not_as_many_as_each_other_or_as_their_names_are_named_with_their_row(tmp_path: Path) -> None:
    rows: list[Row] = [{"q": [1.0], "qd": [1.0]}, {"q": [1.0, 2.0], "qd": [1.0]}]
    with pytest.raises(ConversionError, match=r"'t', row 1 .*'qd' has 1 values and 'q' has 2.*on_bad='lossless'"):
        messages(tmp_path, rows, {"joint_names": ["a"]})
    with pytest.raises(ConversionError, match=r"row 1 .*'q' has 2 values, and the topic's joint_names are 1"):
        export(
            tmp_path / "run",
            tmp_path / "x",
            mapping={"t": {"joint_states": {"type": "sensor_msgs/JointState", "position": "q"}}},
        )
    with pytest.warns(ConversionWarning, match="/t/joint_states lacks rows that it cannot say"):
        bag = export(tmp_path / "run", tmp_path / "y", on_bad="lossless")
    assert [one.topic for one in with_rosbags(bag)].count("/t/joint_states") == 1


@pytest.mark.parametrize(("field", "mapping"), [("pos", None), ("odd", LEFT)])
def test_an_array_whose_length_changes_is_named_with_its_row(tmp_path: Path, field: str, mapping: Any) -> None:
    rows: list[Row] = [{field: [0.5] * length, "quat": QUATERNION} for length in (3, 3, 2)]
    rows.insert(1, {"x": 1})
    match = rf"topic 't', row 3 \(_ts=0\.03\): field '{field}' is lists of float64 whose length changes"
    with pytest.raises(ConversionError, match=match):
        messages(tmp_path, rows, mapping=mapping)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run"]
    with pytest.warns(ConversionWarning, match=match.replace("field", "/t/pose is left out: field")):
        bag = export(tmp_path / "run", tmp_path / "bag", mapping=mapping, on_bad="lossless")
    assert [one.topic for one in with_rosbags(bag)] == ["/t"] * 4


def test_such_an_array_is_no_matter_where_no_message_needs_it(tmp_path: Path) -> None:
    rows = [{"pos": [0.5, 0.5], "q": [1.0]}, {"pos": [0.5], "q": [1.0, 2.0]}]
    record(tmp_path / "run", {"t": rows})
    bag = export(tmp_path / "run", tmp_path / "bag", mapping={"t": {"joint_states": None}})
    assert {one.topic for one in with_rosbags(bag)} == {"/t"}


def test_an_array_whose_length_changes_far_on_is_named_with_its_row(tmp_path: Path) -> None:
    rows: list[Row] = [
        {"left": {"pos": [float(number)] * (3 if number < 9000 else 2), "quat": QUATERNION}} for number in range(9001)
    ]
    with pytest.raises(ConversionError, match=r"topic 't', row 9000 \(_ts=.*\): field 'left\.pos' is lists"):
        messages(tmp_path, rows)


def test_joints_that_change_far_on_are_written_as_they_are(tmp_path: Path) -> None:
    rows: list[Row] = [{"name": ["a", "b", "c"][:count], "q": [1.0] * count} for count in [2] * 9000 + [3]]
    found = joints(messages(tmp_path, rows))
    assert found[0] == (["a", "b"], [1.0, 1.0]) and found[9000] == (["a", "b", "c"], [1.0] * 3)


NAMES = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=4)


@st.composite
def joint_rows(draw: st.DrawFn) -> Row:
    """A row whose joints are its own: some numbers, none or as many velocities, and names, unless it has none."""
    count = draw(st.integers(0, 4))
    numbers = st.lists(st.floats(-9, 9), min_size=count, max_size=count)
    names = draw(st.lists(NAMES, min_size=count, max_size=count))
    row: Row = {"position": draw(numbers), "velocity": draw(st.sampled_from([[], draw(numbers)]))}
    return {"name": names, **row}


@settings(max_examples=examples(15), deadline=None)
@given(rows=st.lists(joint_rows(), min_size=1, max_size=6), format=st.sampled_from(["rosbag2", "rosbag1"]))
def test_whatever_joints_rows_have_their_messages_have_the_same(rows: list[Row], format: str) -> None:
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", ConversionWarning)  # of rows that have no joints at all
        record(Path(folder) / "run", {"t": [{"_ts": 1.0 + number, **row} for number, row in enumerate(rows)]})
        dest = Path(folder) / ("out.bag" if format == "rosbag1" else "bag")
        found = [
            one for one in with_rosbags(export(Path(folder) / "run", dest, format)) if one.topic == "/t/joint_states"
        ]
    if any(row["position"] for row in rows):
        assert [(one.message.name, one.message.position.tolist(), one.message.velocity.tolist()) for one in found] == [
            (row["name"], row["position"], row["velocity"]) for row in rows
        ]


# -- what a row says of what has a default ----------------------------------------------------------------------------


def frames(found: dict[str, list[Found]], topic: str) -> list[str]:
    return [one.message.header.frame_id for one in found[topic]]


@pytest.mark.parametrize("said", [{"frame_id": "tool"}, {"header": {"frame_id": "tool", "seq": 3}}])
def test_the_frame_is_that_of_the_row_unless_the_topic_has_one(tmp_path: Path, said: Row) -> None:
    rows: list[Row] = [{"accel": [1.0, 2.0, 3.0], "left": {"mag": [1.0] * 3}, **said}, {"accel": [1.0, 2.0, 3.0]}]
    found = messages(tmp_path, rows, frame_id="otherwise")
    assert frames(found, "/t/imu") == ["tool", "otherwise"]
    record(tmp_path / "two", {"t": rows}, {"t": {"frame_id": "base"}})
    two = with_rosbags(export(tmp_path / "two", tmp_path / "bag2", profile="std"))
    assert {one.message.header.frame_id for one in two if one.topic == "/t/imu"} == {"base"}


def test_the_frame_of_the_row_is_that_of_what_is_nested_in_it(tmp_path: Path) -> None:
    rows: list[Row] = [{"left": {"mag": [1.0] * 3}, "right": {"mag": [1.0] * 3, "frame_id": "own"}, "frame_id": "tool"}]
    found = messages(tmp_path, rows)
    assert (frames(found, "/t/left/mag"), frames(found, "/t/right/mag")) == (["tool"], ["own"])


def transforms(found: dict[str, list[Found]]) -> list[tuple[str, str]]:
    return [(inner.header.frame_id, inner.child_frame_id) for one in found["/tf"] for inner in one.message.transforms]


POSE = {"ee_pos": [1.0, 2.0, 3.0], "ee_quat": QUATERNION}


def test_transforms_without_a_parent_are_of_the_world_and_the_user_is_told(tmp_path: Path) -> None:
    with pytest.warns(ConversionWarning, match=r"/tf: nobody says which frame .*'ee_pos' .* called 'world'"):
        found = messages(tmp_path, [POSE, POSE], tf=True)
    assert transforms(found) == [("world", "t/ee_pose")] * 2
    assert frames(found, "/t/ee_pose") == ["", ""], "a header may have none"


def test_transforms_have_the_frames_that_the_row_or_the_topic_says(tmp_path: Path) -> None:
    rows: list[Row] = [{**POSE, "frame_id": "/base", "child_frame_id": "tool"}, {**POSE, "frame_id": "map"}]
    assert transforms(messages(tmp_path, rows, tf=True)) == [("base", "tool"), ("map", "t/ee_pose")]


def test_what_is_said_of_a_topic_names_the_child_of_its_transforms(tmp_path: Path) -> None:
    said = {"frame_id": "base", "child_frame_id": "/tool"}
    assert transforms(messages(tmp_path, [POSE], said, tf=True)) == [("base", "tool")]
    mapping = {"t": {"/tf": {"type": "tf2_msgs/TFMessage", "position": "ee_pos", "orientation": "ee_quat"}}}
    bag = export(tmp_path / "run", tmp_path / "again", mapping=mapping, profile="std")
    assert transforms({"/tf": [one for one in with_rosbags(bag) if one.topic == "/tf"]}) == [("base", "tool")]
    record(tmp_path / "plain", {"t": [POSE]})
    bag = export(tmp_path / "plain", tmp_path / "third", mapping=mapping, profile="std", frame_id="map")
    assert transforms({"/tf": [one for one in with_rosbags(bag) if one.topic == "/tf"]}) == [("map", "t")]


def test_covariances_and_variances_are_those_of_the_row(tmp_path: Path) -> None:
    covariance = [float(number) for number in range(9)]
    rows: list[Row] = [
        {
            "accel": [1.0, 2.0, 3.0],
            "linear_acceleration_covariance": covariance,
            "gyro_covariance": covariance,
            "mag": [1.0] * 3,
            "mag_covariance": np.reshape(covariance, (3, 3)).tolist(),
            "temperature": 1.0,
            "variance": 4.0,
        },
        {"accel": [1.0, 2.0, 3.0], "mag": [1.0] * 3, "temperature": 1.0},
    ]
    found = messages(tmp_path, rows, {"units": {"accel": "g"}})
    first, second = (one.message for one in found["/t/imu"])
    assert first.linear_acceleration_covariance.tolist() == [9.80665**2 * number for number in covariance]
    assert second.linear_acceleration_covariance.tolist() == [0.0] * 9
    assert first.angular_velocity_covariance[0] == -1, "there is no angular velocity"
    field = [one.message.magnetic_field_covariance.tolist() for one in found["/t/mag"]]
    assert field == [pytest.approx([1e-12 * number for number in covariance]), [0.0] * 9]
    assert [one.message.variance for one in found["/t/temp"]] == [4.0, 0.0]


def test_a_camera_is_what_the_row_says(tmp_path: Path) -> None:
    row = {
        "K": [[1.0, 0.0, 2.0], [0.0, 3.0, 4.0], [0.0, 0.0, 1.0]],
        "D": [0.1, 0.2, 0.3, 0.4],
        "R": [0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        "P": [[1.0, 0.0, 2.0, 5.0], [0.0, 3.0, 4.0, 6.0], [0.0, 0.0, 1.0, 0.0]],
        "distortion_model": "equidistant",
        "header": {"frame_id": "lens"},
    }
    _, _, message = only(tmp_path, [row])
    assert (message.distortion_model, message.d.tolist(), message.header.frame_id) == ("equidistant", row["D"], "lens")
    assert message.r.tolist() == row["R"]
    assert message.p.tolist() == [number for line in row["P"] for number in line]


def test_pixels_are_in_the_encoding_that_the_row_says_if_they_can_be(tmp_path: Path) -> None:
    rows: list[Row] = [{"rgb": [[[1, 2, 3]]], "encoding": name} for name in ("bgr8", "rgb8", "mono16")]
    rows.append({"rgb": [[[1, 2, 3]]]})
    with pytest.warns(ConversionWarning, match="field 'encoding' is 'mono16', which the pixels of 'rgb' are not"):
        found = messages(tmp_path, rows)
    assert [one.message.encoding for one in found["/t/image"]] == ["bgr8", "rgb8", "rgb8", "rgb8"]
    assert {one.message.data.tobytes() for one in found["/t/image"]} == {b"\1\2\3"}


def test_a_picture_has_the_format_that_the_row_says_if_it_is_one(tmp_path: Path) -> None:
    jpeg, said = b"\xff\xd8\xff", "bgr8; jpeg compressed bgr8"
    rows: list[Row] = [{"image": jpeg, "format": said}, {"image": jpeg, "format": "png"}, {"image": jpeg}]
    found = messages(tmp_path, rows)
    assert [one.message.format for one in found["/t/image/compressed"]] == [said, "jpeg", "jpeg"]


# -- the sums ---------------------------------------------------------------------------------------------------------


def test_every_usual_unit_is_a_known_one() -> None:
    assert all(units.scale(quantity, None) is not None for quantity in units.UNITS)
    assert units.scale("angle", "parsec") is None


def test_bytes_that_are_no_picture_are_left_alone(tmp_path: Path) -> None:
    with pytest.warns(ConversionWarning, match="neither a JPEG nor a PNG"):
        assert list(messages(tmp_path, [{"image": b"\0\0", "temp": 1.0}])) == ["/t/temp"]


def test_a_mapping_of_a_topic_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConversionError, match="'robot', which is not exported; there are 't'"):
        messages(tmp_path, [{"q": [0.5]}], mapping={"robot": None})


def test_a_topic_of_ours_keeps_its_name_from_a_standard_message(tmp_path: Path) -> None:
    record(tmp_path / "run", {"robot": [{"q": [0.5]}], "robot/joint_states": [{"x": 1}]})
    with pytest.warns(ConversionWarning, match="/robot/joint_states is left out: another topic has that name"):
        bag = export(tmp_path / "run", tmp_path / "bag")
    assert {one.topic: one.type for one in with_rosbags(bag)} == {
        "/robot": "ml_dash_msgs/msg/Robot",
        "/robot/joint_states": "ml_dash_msgs/msg/RobotJointStates",
    }
