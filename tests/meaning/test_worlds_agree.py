"""A field is the same thing in every world: what motion capture tools see as a body, ROS sees as a pose.

ezc3d and OpenSim judge the files of motion capture, rosbags judges the bags.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import ezc3d
import numpy as np
import pytest

from ml_dash_mcap import Recording
from tests.support.bags import export, record, with_rosbags

Row = dict[str, Any]

PLACE = [1.0, 2.0, 3.0]
TURN = [0.0, 0.0, 0.6, 0.8]
MATRIX = [[0.28, -0.96, 0.0, 1.0], [0.96, 0.28, 0.0, 2.0], [0.0, 0.0, 1.0, 3.0], [0.0, 0.0, 0.0, 1.0]]
FLAT = [number for row in MATRIX for number in row]
"""The same pose as a matrix."""


def xyz(numbers: list[float]) -> Row:
    return dict(zip("xyzw", numbers, strict=False))


POSES: list[tuple[Row, str]] = [
    ({"ee_pos": PLACE, "ee_quat": TURN}, "/t/ee_pose"),
    ({"tcp_pos": PLACE, "tcp_quat": TURN}, "/t/tcp_pose"),
    ({"left_ee_position": PLACE, "left_ee_orientation": TURN}, "/t/left_ee_pose"),
    ({"base_translation": PLACE, "base_rotation": TURN}, "/t/base_pose"),
    ({"xyz": PLACE, "rot": TURN}, "/t/pose"),
    ({"pos": PLACE, "quaternion": TURN}, "/t/pose"),
    ({"Position": PLACE, "Orientation": TURN}, "/t/pose"),
    ({"tcp_pose": [*PLACE, *TURN]}, "/t/tcp_pose"),
    ({"tcp_pose": MATRIX}, "/t/tcp_pose"),
    ({"pose": FLAT}, "/t/pose"),
    ({"transform": MATRIX}, "/t/pose"),
    ({"T": MATRIX}, "/t/t"),
    ({"T_base_ee": FLAT}, "/t/pose"),
    ({"world_T_camera": MATRIX}, "/t/world_t_camera"),
    ({"position": xyz(PLACE), "orientation": xyz(TURN)}, "/t/pose"),
    ({"tcp": {"pos": xyz(PLACE), "quat": xyz(TURN)}}, "/t/tcp/pose"),
    ({"hand": {"wrist_pos": PLACE, "wrist_quat": TURN}}, "/t/hand/wrist_pose"),
]
"""Rows with one pose, in all the ways in which people log it, to its topic in ROS."""


@pytest.mark.parametrize(
    ("row", "topic"), POSES, ids=[" ".join(row) + f" {number}" for number, (row, _) in enumerate(POSES)]
)
def test_a_pose_is_a_body_to_motion_capture_and_a_pose_to_ros(tmp_path: Path, row: Row, topic: str) -> None:
    record(tmp_path / "run", {"t": [row, row]}, {"t": {"quat_order": "xyzw", "frame_id": "base"}})
    with Recording(tmp_path / "run") as recording:
        recording.export(tmp_path / "a.c3d")
    file = ezc3d.c3d(str(tmp_path / "a.c3d"))
    assert file["parameters"]["ROTATION"]["LABELS"]["value"] == ["t"]
    assert file["data"]["rotations"][:, :, 0, 0] == pytest.approx(np.array(MATRIX), abs=1e-6)

    (found, *more) = with_rosbags(export(tmp_path / "run", tmp_path / "bag", profile="std"))
    assert (found.topic, found.type) == (topic, "geometry_msgs/msg/PoseStamped")
    assert [one.topic for one in more] == [topic]
    pose = found.message.pose
    assert found.message.header.frame_id == "base"
    assert [pose.position.x, pose.position.y, pose.position.z] == PLACE
    turn = [pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w]
    assert turn == pytest.approx(TURN)


def test_two_matrices_are_two_bodies_and_two_poses(tmp_path: Path) -> None:
    row = {"T_base_left": MATRIX, "T_base_right": MATRIX}
    record(tmp_path / "run", {"t": [row, row]})
    with Recording(tmp_path / "run") as recording:
        recording.export(tmp_path / "a.c3d")
    labels = ezc3d.c3d(str(tmp_path / "a.c3d"))["parameters"]["ROTATION"]["LABELS"]["value"]
    assert labels == ["t:T_base_left", "t:T_base_right"]
    topics = {one.topic for one in with_rosbags(export(tmp_path / "run", tmp_path / "bag", profile="std"))}
    assert topics == {"/t/t_base_left", "/t/t_base_right"}


def test_several_poses_of_a_row_are_told_apart_by_what_they_belong_to(tmp_path: Path) -> None:
    row = {"ee_pos": PLACE, "ee_quat": TURN, "tcp_pos": PLACE, "tcp_quat": TURN, "camera_pose": [*PLACE, *TURN]}
    record(tmp_path / "run", {"t": [row, row]}, {"t": {"quat_order": "xyzw"}})
    with Recording(tmp_path / "run") as recording:
        recording.export(tmp_path / "a.c3d")
    labels = ezc3d.c3d(str(tmp_path / "a.c3d"))["parameters"]["ROTATION"]["LABELS"]["value"]
    assert labels == ["t:ee", "t:tcp", "t:camera"]
    topics = {one.topic for one in with_rosbags(export(tmp_path / "run", tmp_path / "bag", profile="std"))}
    assert topics == {"/t/ee_pose", "/t/tcp_pose", "/t/camera_pose"}


def test_a_dict_of_a_quaternion_says_its_order_by_its_keys(tmp_path: Path) -> None:
    row = {"tcp_pos": xyz(PLACE), "tcp_quat": {"w": 0.8, "x": 0.0, "y": 0.0, "z": 0.6}}
    record(tmp_path / "run", {"t": [row]}, {"t": {"quat_order": "wxyz"}})
    (found,) = with_rosbags(export(tmp_path / "run", tmp_path / "bag", profile="std"))
    assert (found.message.pose.orientation.z, found.message.pose.orientation.w) == (0.6, 0.8)


def test_a_dict_without_one_of_its_numbers_is_no_pose_of_that_row(tmp_path: Path) -> None:
    whole = {"tcp_pos": xyz(PLACE), "tcp_quat": xyz(TURN)}
    part = {"tcp_pos": {"x": 1.0, "y": 2.0}, "tcp_quat": xyz(TURN)}
    record(tmp_path / "run", {"t": [whole, part, whole]}, {"t": {"quat_order": "xyzw"}})
    found = with_rosbags(export(tmp_path / "run", tmp_path / "bag", profile="std"))
    assert [(one.topic, one.time_ns) for one in found] == [("/t/tcp_pose", 0), ("/t/tcp_pose", 20_000_000)]


JOINTS: list[tuple[str, str, str]] = [
    *(
        (name, "position", "")
        for name in ("q", "qpos", "joint_angles", "joint_angle", "joint_pos", "jointpos", "joints")
    ),
    *((name, "velocity", "_u") for name in ("dq", "qvel", "joint_speeds", "joint_velocities")),
    *((name, "effort", "_tau") for name in ("tau", "efforts", "torques", "joint_effort")),
]
"""Names of joints' numbers, to the field of JointState and to what OpenSim appends to the joint's name."""


@pytest.mark.parametrize(("name", "role", "suffix"), JOINTS)
def test_the_numbers_of_joints_are_those_of_joints_in_both_worlds(
    tmp_path: Path, name: str, role: str, suffix: str
) -> None:
    opensim = pytest.importorskip("opensim")
    row = {name: [0.25, 0.5]}
    record(tmp_path / "run", {"t": [row, row]}, {"t": {"joint_names": ["a", "b"]}})
    with Recording(tmp_path / "run") as recording:
        recording.export(tmp_path / "a.sto")
    table = opensim.TimeSeriesTable(str(tmp_path / "a.sto"))
    assert list(table.getColumnLabels()) == [f"a{suffix}", f"b{suffix}"]
    found, _ = with_rosbags(export(tmp_path / "run", tmp_path / "bag", profile="std"))
    assert (found.topic, found.message.name) == ("/t/joint_states", ["a", "b"])
    assert getattr(found.message, role).tolist() == [0.25, 0.5]


def test_one_torque_a_joint_is_an_effort_and_a_torque_beside_a_force_is_a_wrench(tmp_path: Path) -> None:
    record(
        tmp_path / "run", {"arm": [{"q": [0.5] * 7, "torque": [1.0] * 7}], "wrist": [{"force": PLACE, "torque": PLACE}]}
    )
    found = {one.topic: one.message for one in with_rosbags(export(tmp_path / "run", tmp_path / "bag", profile="std"))}
    assert found.keys() == {"/arm/joint_states", "/wrist/wrench"}
    assert found["/arm/joint_states"].effort.tolist() == [1.0] * 7


def test_a_single_joint_is_one_in_both_worlds(tmp_path: Path) -> None:
    opensim = pytest.importorskip("opensim")
    rows = [{"q": 0.5, "_ts": 0.0}, {"q": 0.25, "_ts": 0.01}]
    record(tmp_path / "run", {"pendulum": rows})
    with Recording(tmp_path / "run") as recording:
        recording.export(tmp_path / "a.sto")
    assert list(opensim.TimeSeriesTable(str(tmp_path / "a.sto")).getColumnLabels()) == ["q0"]
    found, _ = with_rosbags(export(tmp_path / "run", tmp_path / "bag", profile="std"))
    assert found.message.position.tolist() == [0.5]


@pytest.mark.parametrize("unit", ["mm", "MM", "millimeters", "millimetre"])
def test_a_unit_of_length_is_spelt_alike_in_both_worlds(tmp_path: Path, unit: str) -> None:
    row = {"tcp_pos": [1000.0, 2000.0, 3000.0], "tcp_quat": TURN}
    record(tmp_path / "run", {"t": [row, row]}, {"t": {"quat_order": "xyzw", "units": {"tcp_pos": unit}}})
    with Recording(tmp_path / "run") as recording:
        recording.export(tmp_path / "a.c3d")
    assert ezc3d.c3d(str(tmp_path / "a.c3d"))["data"]["points"][:3, 0, 0].tolist() == PLACE
    found, _ = with_rosbags(export(tmp_path / "run", tmp_path / "bag", profile="std"))
    assert found.message.pose.position.z == pytest.approx(3.0)


@pytest.mark.parametrize("unit", ["deg", "degrees", "Degree"])
def test_a_unit_of_angles_is_spelt_alike_in_both_worlds(tmp_path: Path, unit: str) -> None:
    opensim = pytest.importorskip("opensim")
    row = {"q": [180.0]}
    record(tmp_path / "run", {"t": [row, row]}, {"t": {"units": {"q": unit}}})
    with Recording(tmp_path / "run") as recording:
        recording.export(tmp_path / "a.sto")
    assert opensim.TimeSeriesTable(str(tmp_path / "a.sto")).getTableMetaDataString("inDegrees") == "yes"
    found, _ = with_rosbags(export(tmp_path / "run", tmp_path / "bag", profile="std"))
    assert found.message.position.tolist() == [np.pi]


@pytest.mark.parametrize(
    "row",
    [
        {"tcp_pos": PLACE},
        {"tcp_pos": PLACE, "ee_quat": TURN},
        {"t_base_ee": MATRIX},
        {"robot": {"tcp_pos": PLACE}, "tcp_quat": TURN},
        {"posture": PLACE, "quat": TURN},
    ],
)
def test_what_is_no_pose_is_none_in_ros(tmp_path: Path, row: Row) -> None:
    record(tmp_path / "run", {"t": [row]}, {"t": {"quat_order": "xyzw"}})
    found = with_rosbags(export(tmp_path / "run", tmp_path / "bag"))
    assert not [one.topic for one in found if one.type.startswith("geometry_msgs")]
