"""A recording becomes a rosbag2 folder that ROS's tools and viewers read."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

from ml_dash_mcap.errors import (
    ConversionError,
    ConversionWarning,
    DestinationExistsError,
    OptionError,
    UsageError,
)
from ml_dash_mcap.recorder import Recorder
from ml_dash_mcap.recording import Recording
from tests.support.bags import ROBOT, export, record, robot_rows, smooth_columns, with_rosbags

STORAGES = ("mcap", "sqlite3")


def information(bag: Path) -> dict[str, Any]:
    found: dict[str, Any] = YAML(typ="safe").load(bag / "metadata.yaml")["rosbag2_bagfile_information"]
    return found


@pytest.fixture(params=STORAGES)
def bag(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    record(tmp_path / "run", {"robot": robot_rows(50)}, {"robot": {"frame_id": "base", "quat_order": "xyzw"}})
    return export(tmp_path / "run", tmp_path / "bag", storage=request.param)


def test_rosbags_finds_our_message_and_the_standard_ones(bag: Path) -> None:
    found = with_rosbags(bag)
    types = {one.topic: one.type for one in found}
    assert types == {
        "/robot": "ml_dash_msgs/msg/Robot",
        "/robot/joint_states": "sensor_msgs/msg/JointState",
        "/robot/gripper": "sensor_msgs/msg/JointState",
        "/robot/ee_pose": "geometry_msgs/msg/PoseStamped",
    }
    assert [one.time_ns for one in found if one.topic == "/robot"] == [10_000_000 * number for number in range(50)]
    own = [one.message for one in found if one.topic == "/robot"]
    assert [message.ts for message in own] == [0.01 * number for number in range(50)]
    assert [message.step for message in own] == list(range(50))
    assert own[0].phase == "reach"
    joints = [one.message for one in found if one.topic == "/robot/joint_states"]
    assert joints[3].name == [f"joint{number}" for number in range(1, 8)]
    assert joints[3].position.tolist() == robot_rows(4)[3]["q"]
    assert (joints[3].header.frame_id, joints[3].header.stamp.sec, joints[3].header.stamp.nanosec) == (
        "base",
        0,
        30_000_000,
    )
    pose = next(one.message.pose for one in found if one.topic == "/robot/ee_pose")
    assert (pose.position.x, pose.position.y, pose.position.z) == (0.5, 0.0, 0.25)
    assert (pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w) == (0.0, 0.0, 0.6, 0.8)


def test_the_bytes_of_standard_messages_are_those_that_rosbags_writes(bag: Path) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    found = [one for one in with_rosbags(bag) if one.topic != "/robot"]
    assert len(found) == 150
    for one in found:
        assert bytes(store.serialize_cdr(store.deserialize_cdr(one.data, one.type), one.type)) == one.data


def test_mcap_ros2_support_decodes_every_message(tmp_path: Path) -> None:
    record(tmp_path / "run", {"robot": robot_rows(50)})
    bag = export(tmp_path / "run", tmp_path / "bag")
    counts: dict[str, int] = {}
    with (bag / "bag_0.mcap").open("rb") as file:
        for schema, channel, message, decoded in make_reader(
            file, validate_crcs=True, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            assert schema is not None
            assert schema.encoding == "ros2msg"
            assert channel.metadata["topic_type_hash"].startswith("RIHS01_")
            if channel.topic == "/robot":
                assert decoded.step == counts.get("/robot", 0) == message.sequence
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
    assert counts == dict.fromkeys(("/robot", "/robot/joint_states", "/robot/gripper", "/robot/ee_pose"), 50)


@pytest.mark.parametrize(("distro", "version"), [("humble", 8), ("iron", 8), ("jazzy", 9), ("rolling", 9)])
@pytest.mark.parametrize("storage", STORAGES)
def test_the_metadata_is_of_the_version_that_a_distribution_reads(
    tmp_path: Path, distro: str, version: int, storage: str
) -> None:
    record(tmp_path / "run", {"robot": robot_rows(3)})
    bag = export(tmp_path / "run", tmp_path / "bag", distro=distro, storage=storage)
    assert information(bag)["version"] == version
    with Reader(bag) as reader:
        assert reader.ros_distro == distro
        assert reader.message_count == 12
        (qos,) = reader.connections[0].ext.offered_qos_profiles
        assert (qos.history.name, qos.depth, qos.reliability.name, qos.durability.name) == (
            *("KEEP_LAST", 10, "RELIABLE", "VOLATILE"),
        )


@pytest.mark.parametrize("storage", STORAGES)
def test_a_bag_is_split_by_time_when_a_file_has_grown(tmp_path: Path, storage: str) -> None:
    with Recorder(tmp_path / "run") as recorder:
        recorder.topic("robot").append_columns(_ts=np.arange(2000) / 100, **smooth_columns(2000))
        recorder.topic("imu").append_columns(_ts=np.arange(500) / 25, accel=np.ones((500, 3)), gyro=np.ones((500, 3)))
    bag = export(tmp_path / "run", tmp_path / "bag", storage=storage, split_bytes=100_000)
    said = information(bag)
    files = said["files"]
    assert len(files) >= 3
    assert [one["path"] for one in files] == said["relative_file_paths"]
    assert sum(one["message_count"] for one in files) == said["message_count"] == 9000
    starts = [one["starting_time"]["nanoseconds_since_epoch"] for one in files]
    assert starts == sorted(starts)
    ends = [start + one["duration"]["nanoseconds"] for start, one in zip(starts, files, strict=True)]
    assert all(end <= start for end, start in zip(ends[:-1], starts[1:], strict=True))
    with Reader(bag) as reader:
        assert reader.message_count == 9000
        assert sum(connection.topic == "/robot" for connection, _, _ in reader.messages()) == 2000


def test_a_field_that_comes_late_is_in_the_message_from_the_start(tmp_path: Path) -> None:
    with Recorder(tmp_path / "run") as recorder:
        topic = recorder.topic("robot")
        topic.append_columns(_ts=np.arange(500) / 100, **smooth_columns(500))
        recorder.flush()
        topic.append(q=[1.0] * 7, note="late", nested={"a": 1}, _ts=6.0)
    seen: list[int] = []
    bag = export(tmp_path / "run", tmp_path / "bag", progress=lambda done, total: seen.append(done))
    own = [one.message for one in with_rosbags(bag) if one.topic == "/robot"]
    assert len(own) == 501
    assert (own[0].note, own[-1].note, own[-1].nested.a) == ("", "late", 1)
    assert own[0].field_state.tolist() == [1, 1, 1, 1, 1, 1, 0, 0]
    assert own[-1].field_state.tolist() == [1, 0, 0, 0, 0, 0, 1, 1]
    assert sum(one.topic == "/robot/ee_pose" for one in with_rosbags(bag)) == 500
    assert seen == sorted(seen) and seen[-1] == 501


def test_topics_that_look_alike_stay_apart(tmp_path: Path) -> None:
    record(tmp_path / "run", {"a/b": [{"x": 1}], "a_b": [{"y": 2}], "a.b": [{"z": 3}], "/a/b": [{"w": 4}]})
    found = with_rosbags(export(tmp_path / "run", tmp_path / "bag"))
    assert {one.topic: one.type for one in found} == {
        "/a/b": "ml_dash_msgs/msg/AB",
        "/a/b_2": "ml_dash_msgs/msg/ABV2",
        "/a_b": "ml_dash_msgs/msg/ABV3",
        "/a_b_2": "ml_dash_msgs/msg/ABV4",
    } or len({one.topic for one in found}) == len({one.type for one in found}) == 4


@pytest.mark.parametrize(
    ("profile", "topics"),
    [
        ("std", ["/robot/ee_pose", "/robot/gripper", "/robot/joint_states"]),
        ("lossless", ["/robot"]),
        ("json", ["/robot"]),
    ],
)
def test_a_profile_says_which_messages_are_written(tmp_path: Path, profile: str, topics: list[str]) -> None:
    record(tmp_path / "run", {"robot": robot_rows(3)})
    bag = export(tmp_path / "run", tmp_path / "bag", profile=profile)
    found = with_rosbags(bag)
    assert sorted({one.topic for one in found}) == topics
    assert (bag / "ml_dash_msgs/package.xml").exists() == (profile != "std")
    if profile == "json":
        assert found[0].type == "ml_dash_msgs/msg/Json"
        assert '"phase":"reach"' in found[0].message.json


def test_times_are_shifted_where_asked_and_rows_keep_their_own(tmp_path: Path) -> None:
    record(tmp_path / "run", {"robot": robot_rows(2)})
    found = with_rosbags(export(tmp_path / "run", tmp_path / "bag", time_offset=1_700_000_000.5))
    own = [one for one in found if one.topic == "/robot"]
    assert [one.time_ns for one in own] == [1_700_000_000_500_000_000, 1_700_000_000_510_000_000]
    assert own[1].message.header.stamp.nanosec == 510_000_000
    assert [one.message.ts for one in own] == [0.0, 0.01]


def test_an_empty_recording_is_an_empty_bag(tmp_path: Path) -> None:
    record(tmp_path / "run", {"robot": [], "robot2": robot_rows(1)})
    with Recording(tmp_path / "run") as recording:
        bag = recording.export(tmp_path / "bag", format="rosbag2", topics=["robot2"], start=5.0)
    with Reader(bag) as reader:
        assert reader.message_count == 0


# -- what cannot be said ----------------------------------------------------------------------------------------------


def refused(tmp_path: Path, error: type[Exception], match: str, topics: dict[str, Any], **options: Any) -> None:
    record(tmp_path / "run", topics, options.pop("metadata", None))
    with pytest.raises(error, match=match):
        export(tmp_path / "run", tmp_path / "out/bag", **options)
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())


def test_a_quaternion_that_is_no_unit_one_is_named_with_its_row(tmp_path: Path) -> None:
    rows = [*robot_rows(2), {**ROBOT, "ee_quat": [0.0, 0.0, 0.0, 2.0]}]
    refused(
        tmp_path, ConversionError, r"'robot', row 2 \(_ts=0\.02\).*'ee_quat' is no unit.*0\.0, 2\.0", {"robot": rows}
    )


def test_such_a_row_is_left_out_of_the_standard_message_where_allowed(tmp_path: Path) -> None:
    rows = [*robot_rows(2), {**ROBOT, "ee_quat": [0.0, 0.0, 0.0, 2.0]}]
    record(tmp_path / "run", {"robot": rows})
    with pytest.warns(ConversionWarning, match="row 2"):
        bag = export(tmp_path / "run", tmp_path / "bag", on_bad="lossless")
    topics = [one.topic for one in with_rosbags(bag)]
    assert (topics.count("/robot"), topics.count("/robot/ee_pose"), topics.count("/robot/joint_states")) == (3, 2, 3)


def test_a_time_that_ros_cannot_say_is_named_with_its_row(tmp_path: Path) -> None:
    rows = robot_rows(3)
    refused(tmp_path, ConversionError, r"'robot', row 0 \(_ts=0\.0\).*time_offset", {"robot": rows}, time_offset=-0.005)


def test_a_time_after_2038_is_named_with_its_row(tmp_path: Path) -> None:
    rows = [{**ROBOT, "_ts": 1.0}, {**ROBOT, "_ts": 2.0**31}]
    refused(tmp_path, ConversionError, r"'robot', row 1 \(_ts=2147483648\.0\).*2038", {"robot": rows})


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"distro": "foxy"}, "distro='foxy'.*humble"),
        ({"storage": "leveldb"}, "storage='leveldb'.*sqlite3"),
        ({"profile": "all"}, "profile='all'"),
        ({"on_bad": "skip"}, "on_bad='skip'"),
        ({"compression": "bz2"}, "compression='bz2'"),
        ({"split_bytes": 0}, "split_bytes=0"),
        ({"time_offset": float("nan")}, "time_offset=nan"),
        ({"mapping": ["robot"]}, "mapping="),
        ({"mapping": {"robot": ["q"]}}, r"mapping of the topic 'robot' is \['q'\]"),
        ({"time_offset": 1e300}, r"time_offset=1e\+300"),
        ({"time_offset": True}, "time_offset=True"),
        ({"frame_id": 5}, "frame_id=5"),
        ({"tf": "yes"}, "tf='yes'"),
        ({"storage": "sqlite3", "compression": "zstd"}, "compression='zstd'.*sqlite3"),
    ],
)
def test_an_option_that_makes_no_sense_is_named(tmp_path: Path, options: dict[str, Any], match: str) -> None:
    refused(tmp_path, OptionError, match, {"robot": robot_rows(1)}, **options)


@pytest.mark.parametrize("package", ["My-Msgs", "sensor_msgs"])
def test_a_package_name_that_ros_refuses_or_has_is_named(tmp_path: Path, package: str) -> None:
    refused(tmp_path, ConversionError, f"package='{package}'", {"robot": robot_rows(1)}, package=package)


def test_an_option_that_there_is_not_is_named(tmp_path: Path) -> None:
    refused(tmp_path, UsageError, "no option 'stored'", {"robot": robot_rows(1)}, stored="mcap")


def test_a_destination_that_exists_is_left_alone(tmp_path: Path) -> None:
    record(tmp_path / "run", {"robot": robot_rows(1)})
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag/mine").write_text("mine")
    with pytest.raises(DestinationExistsError):
        export(tmp_path / "run", tmp_path / "bag")
    assert [path.name for path in (tmp_path / "bag").iterdir()] == ["mine"]


def test_the_sqlite_file_is_like_those_of_rosbag2(tmp_path: Path) -> None:
    record(tmp_path / "run", {"robot": robot_rows(3)})
    bag = export(tmp_path / "run", tmp_path / "bag", storage="sqlite3")
    base = sqlite3.connect(bag / "bag_0.db3")
    assert base.execute("SELECT schema_version, ros_distro FROM schema").fetchall() == [(4, "jazzy")]
    times = [time for (time,) in base.execute("SELECT timestamp FROM messages ORDER BY id")]
    assert times == sorted(times)
    assert base.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    base.close()
