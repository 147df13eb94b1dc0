"""A recording becomes a ROS 1 bag that ROS 1 itself reads."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from rosbags.rosbag1 import Reader

from ml_dash_mcap.conversion import convert
from ml_dash_mcap.errors import ConversionError, ConversionWarning, DestinationExistsError, OptionError
from ml_dash_mcap.recording import Recording
from tests.support import system_python
from tests.support.bags import ROBOT, export, record, robot_rows, with_rosbags

COMPRESSIONS = ("none", "bz2", "lz4")


def with_ros1(bag: Path) -> Any:
    return system_python.run(
        "read_bag.py", bag, needs=("rosbag", "roslz4", "sensor_msgs.msg", "geometry_msgs.msg"), package="python3-rosbag"
    )


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_real_ros_1_reads_all_messages_and_knows_our_types(tmp_path: Path, compression: str) -> None:
    rows = [{**row, "_ts": 1.0 + 0.01 * number, "nested": {"a": [1.5]}} for number, row in enumerate(robot_rows(2000))]
    record(tmp_path / "run", {"robot": rows})
    bag = export(tmp_path / "run", tmp_path / "out.bag", "rosbag1", compression=compression)
    found = with_ros1(bag)
    assert found["compression"] == compression
    topics = found["topics"]
    assert {name: one["type"] for name, one in topics.items()} == {
        "/robot": "ml_dash_msgs/Robot",
        "/robot/joint_states": "sensor_msgs/JointState",
        "/robot/gripper": "sensor_msgs/JointState",
        "/robot/ee_pose": "geometry_msgs/PoseStamped",
    }
    for one in topics.values():
        assert one["count"] == one["read"] == 2000
        assert one["valid"]
        assert one["times"] == sorted(one["times"])
    first = topics["/robot"]["first"]
    assert (first["ts"], first["q"], first["phase"], first["nested"]["a"]) == (1.0, rows[0]["q"], "reach", [1.5])
    assert topics["/robot/joint_states"]["first"]["position"] == rows[0]["q"]


def test_real_ros_1_reads_a_camera(tmp_path: Path) -> None:
    k = [[500.0, 0.0, 320.0], [0.0, 501.0, 240.0], [0.0, 0.0, 1.0]]
    record(tmp_path / "run", {"cam": [{"K": k, "dist": [0.1] * 5, "rgb": [[[1, 2, 3]]], "_ts": 1.0}]})
    found = with_ros1(export(tmp_path / "run", tmp_path / "out.bag", "rosbag1"))["topics"]
    assert found["/cam/camera_info"]["first"]["K"] == [number for row in k for number in row]
    assert found["/cam/image"]["first"]["data"] == [1, 2, 3]


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_the_messages_of_all_topics_lie_in_the_order_of_time(tmp_path: Path, compression: str) -> None:
    topics = {
        "fast": [{"x": 0.5, "text": "x" * 3000, "_ts": 1 + number / 1000} for number in range(1500)],
        "slow": [{"y": number, "_ts": 1.0005 + number / 10} for number in range(15)],
        "late": [{"z": number, "_ts": 2.25} for number in range(3)],
    }
    record(tmp_path / "run", topics)
    bag = export(tmp_path / "run", tmp_path / "out.bag", "rosbag1", compression=compression)
    data = bag.read_bytes()
    chunks = [match.start() for match in re.finditer(rb"op=\x05", data)]
    assert len(chunks) >= 4
    with Reader(bag) as reader:
        infos = reader.chunk_infos
        assert len(infos) == len(chunks)
        assert all(before.end_time <= after.start_time for before, after in pairwise(infos))
        times = [time for _, time, _ in reader.messages()]
    assert len(times) == 1516
    assert times == sorted(times)
    with Recording(convert(bag, tmp_path / "back")) as back:
        assert {name: [row["_ts"] for row in back[name].rows()] for name in topics} == {
            name: sorted({row["_ts"] for row in rows}) for name, rows in topics.items()
        }


def test_each_connection_is_defined_in_the_chunk_that_first_has_it(tmp_path: Path) -> None:
    record(tmp_path / "run", {"a": [{"text": "x" * 2_000_000, "_ts": 1.0}], "b": [{"x": 0.5, "_ts": 9.0}]})
    data = export(tmp_path / "run", tmp_path / "out.bag", "rosbag1").read_bytes()
    connections = [match.start() for match in re.finditer(rb"op=\x07", data)]
    first, second = (match.start() for match in re.finditer(rb"op=\x05", data))
    assert len(connections) == 4  # twice in the index
    assert first < connections[0] < second < connections[1] < data.rindex(b"op=\x04") < connections[2]


def test_the_interface_package_lies_beside_the_bag(tmp_path: Path) -> None:
    record(tmp_path / "run", {"robot": [{"x": 1.5, "_ts": 1.0}]})
    export(tmp_path / "run", tmp_path / "out.bag", "rosbag1", package="my_msgs")
    assert (tmp_path / "out_interfaces/my_msgs/msg/Robot.msg").exists()
    assert [one.type for one in with_rosbags(tmp_path / "out.bag")] == ["my_msgs/msg/Robot"]


def test_a_message_at_time_0_is_warned_about(tmp_path: Path) -> None:
    record(tmp_path / "run", {"robot": [{"x": 1.5}]})
    with pytest.warns(ConversionWarning, match="time_offset"):
        export(tmp_path / "run", tmp_path / "out.bag", "rosbag1")


def test_nothing_is_left_behind_where_a_row_cannot_be_said(tmp_path: Path) -> None:
    record(tmp_path / "run", {"robot": [{**ROBOT, "ee_quat": [0.0] * 4, "_ts": 1.0}]})
    with pytest.raises(ConversionError, match="no unit quaternion"):
        export(tmp_path / "run", tmp_path / "out/out.bag", "rosbag1")
    assert not list(tmp_path.glob("out*/*"))


def test_an_unknown_compression_is_named(tmp_path: Path) -> None:
    record(tmp_path / "run", {"robot": [{"x": 1.5, "_ts": 1.0}]})
    with pytest.raises(OptionError, match="compression='zstd'"):
        export(tmp_path / "run", tmp_path / "out.bag", "rosbag1", compression="zstd")


def test_a_bag_that_exists_is_left_alone(tmp_path: Path) -> None:
    record(tmp_path / "run", {"robot": [{"x": 1.5, "_ts": 1.0}]})
    (tmp_path / "out.bag").write_text("mine")
    with pytest.raises(DestinationExistsError):
        export(tmp_path / "run", tmp_path / "out.bag", "rosbag1")
    assert (tmp_path / "out.bag").read_text() == "mine"


def test_a_package_that_exists_is_left_alone(tmp_path: Path) -> None:
    record(tmp_path / "run", {"robot": [{"x": 1.5, "_ts": 1.0}]})
    (tmp_path / "out_interfaces").mkdir()
    (tmp_path / "out_interfaces/mine").write_text("mine")
    with pytest.raises(DestinationExistsError, match="out_interfaces"):
        export(tmp_path / "run", tmp_path / "out.bag", "rosbag1")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out_interfaces", "run"]


def test_joints_that_change_and_frames_are_read_by_ros_1(tmp_path: Path) -> None:
    pose = {"ee_pos": ROBOT["ee_pos"], "ee_quat": ROBOT["ee_quat"]}
    rows = [
        {"name": ["b", "a"], "position": [1.0, 2.0], "velocity": [], "effort": [], **pose, "_ts": 1.0},
        {"name": ["c"], "position": [3.0], "velocity": [4.0], "effort": [], **pose, "frame_id": "map", "_ts": 2.0},
    ]
    record(tmp_path / "run", {"arm": rows})
    with pytest.warns(ConversionWarning, match="'world'"):
        bag = export(tmp_path / "run", tmp_path / "out.bag", "rosbag1", profile="std", tf=True)
    topics = with_ros1(bag)["topics"]
    joints = topics["/arm/joint_states"]
    assert (joints["read"], joints["valid"]) == (2, True)
    assert (joints["first"]["name"], joints["first"]["position"]) == (["b", "a"], [1.0, 2.0])
    (transform,) = topics["/tf"]["first"]["transforms"]
    assert (transform["header"]["frame_id"], transform["child_frame_id"]) == ("world", "arm/ee_pose")
