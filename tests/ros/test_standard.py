"""Fields become standard messages where name, shape and type fit, and metadata comes before any convention."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ml_dash_mcap.errors import ConversionError, ConversionWarning
from ml_dash_mcap.ros import units
from tests.support.bags import ROBOT, Found, export, record, with_rosbags

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


@pytest.mark.parametrize(
    ("field", "mapping"),
    [("q", None), ("odd", {"t": {"joint_states": {"type": "sensor_msgs/JointState", "position": "odd"}}})],
)
def test_an_array_whose_length_changes_is_named_with_its_row(tmp_path: Path, field: str, mapping: Any) -> None:
    rows = [{field: [0.5, 0.5]}, {"x": 1}, {field: [0.5, 0.5]}, {field: [0.5]}]
    match = rf"topic 't', row 3 \(_ts=0\.03\): field '{field}' is lists of float64 whose length changes"
    with pytest.raises(ConversionError, match=match):
        messages(tmp_path, rows, mapping=mapping)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run"]
    with pytest.warns(ConversionWarning, match=match.replace("field", "/t/joint_states is left out: field")):
        bag = export(tmp_path / "run", tmp_path / "bag", mapping=mapping, on_bad="lossless")
    assert [one.topic for one in with_rosbags(bag)] == ["/t"] * 4


def test_such_an_array_is_no_matter_where_no_message_needs_it(tmp_path: Path) -> None:
    rows = [{"pos": [0.5, 0.5], "q": [1.0]}, {"pos": [0.5], "q": [1.0, 2.0]}]
    record(tmp_path / "run", {"t": rows})
    bag = export(tmp_path / "run", tmp_path / "bag", mapping={"t": {"joint_states": None}})
    assert {one.topic for one in with_rosbags(bag)} == {"/t"}


def test_an_array_whose_length_changes_far_on_is_named_with_its_row(tmp_path: Path) -> None:
    rows: list[Row] = [{"left": {"q": [float(number)] * (2 if number < 9000 else 3)}} for number in range(9001)]
    with pytest.raises(ConversionError, match=r"topic 't', row 9000 \(_ts=.*\): field 'left\.q' is lists"):
        messages(tmp_path, rows)


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
