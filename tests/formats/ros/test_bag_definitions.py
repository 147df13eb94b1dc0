"""Bags that do not define their types are read by the definitions of the ROS that recorded them, on every way in."""

from __future__ import annotations

import sqlite3
import struct
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

from ml_dash_mcap import ConversionWarning, Recording, UndecodedWarning, convert

HUMBLE, JAZZY = get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS2_JAZZY)
RANGE = "sensor_msgs/msg/Range"


def opened(bag: Path, **options: Any) -> Recording:
    return Recording(bag, **options)


def converted(bag: Path, **options: Any) -> Recording:
    return Recording(convert(bag, bag.parent / "run", **options))


def as_rows(bag: Path, **options: Any) -> Recording:
    return Recording(convert(bag, bag.parent / "rows", encoding="json", **options))


WAYS = pytest.mark.parametrize("way", [opened, converted, as_rows], ids=lambda way: way.__name__)
Way = Callable[..., Recording]


def a_range(store: Any, *more: float) -> bytes:
    types = store.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](1, 2), "sonar")
    return bytes(store.serialize_cdr(types[RANGE](header, 1, 0.5, 1.0, 4.0, 2.0, *more), RANGE))


def ros2_bag(folder: Path, version: int, distro: str | None, topics: dict[str, tuple[str, bytes]]) -> Path:
    """A bag in SQLite as it was before Iron, without definitions: topics to type and message."""
    bag = folder / "bag"
    bag.mkdir()
    listed = "".join(
        f"    - topic_metadata:\n        name: {topic}\n        type: {type_}\n        serialization_format: cdr\n"
        "        offered_qos_profiles: ''\n      message_count: 1\n"
        for topic, (type_, _) in topics.items()
    )
    (bag / "metadata.yaml").write_text(
        f"rosbag2_bagfile_information:\n  version: {version}\n  storage_identifier: sqlite3\n"
        f"  relative_file_paths:\n    - bag_0.db3\n  duration:\n    nanoseconds: 0\n  starting_time:\n"
        f"    nanoseconds_since_epoch: 1\n  message_count: {len(topics)}\n  topics_with_message_count:\n{listed}"
        "  compression_format: ''\n  compression_mode: ''\n" + (f"  ros_distro: {distro}\n" if distro else "")
    )
    with sqlite3.connect(bag / "bag_0.db3") as file:
        file.execute(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY,name TEXT,type TEXT,serialization_format TEXT,offered_qos_profiles TEXT)"
        )
        file.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER,timestamp INTEGER,data BLOB)")
        for number, (topic, (type_, payload)) in enumerate(topics.items(), 1):
            file.execute("INSERT INTO topics VALUES(?,?,?,'cdr','')", (number, topic, type_))
            file.execute("INSERT INTO messages VALUES(?,?,?,?)", (number, number, number, payload))
    file.close()
    return bag


def row(recording: Recording, topic: str) -> dict[str, Any]:
    (found,) = recording[topic].rows()
    return {name: value for name, value in found.items() if name != "_ts"}


@WAYS
@pytest.mark.parametrize(
    ("version", "distro", "has_variance"),
    [
        (4, None, False),
        (5, None, False),
        (8, "humble", False),
        (8, "iron", True),
        (9, "jazzy", True),
        (8, "rolling", True),
    ],
)
def test_a_type_is_that_of_the_distribution_of_the_bag(tmp_path: Path, way: Way, version, distro, has_variance) -> None:
    payload = a_range(JAZZY, 0.25) if has_variance else a_range(HUMBLE)
    bag = ros2_bag(
        tmp_path, version, distro, {"/range": (RANGE, payload), "/empty": ("std_msgs/msg/Empty", b"\0\1\0\0\0")}
    )
    with way(bag) as recording:
        assert row(recording, "/range").get("variance") == (0.25 if has_variance else None)
        assert row(recording, "/range")["range"] == 2.0
        assert row(recording, "/empty") == {}


@WAYS
def test_types_and_the_messages_in_them_can_be_given(tmp_path: Path, way: Way) -> None:
    payload = b"\0\1\0\0" + struct.pack("<iII2s2xdI", 1, 2, 2, b"a\0", 1.5, 7)
    bag = ros2_bag(tmp_path, 5, None, {"/t": ("p/msg/Thing", payload), "/odd": ("p/msg/Odd", payload)})
    given = {"p/msg/Thing": "std_msgs/Header header\nPart part", "p/Part": "float64 x\nuint32 n"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConversionWarning)
        warnings.simplefilter("ignore", UndecodedWarning)
        with way(bag, definitions=given) as recording:
            header = {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "a"}
            assert row(recording, "/t") == {"header": header, "part": {"x": 1.5, "n": 7}}
            assert row(recording, "/odd") == {"data": payload}


NOETIC = get_typestore(Stores.ROS1_NOETIC)
TEMPERATURE = "sensor_msgs/msg/Temperature"


@WAYS
def test_ros_1_without_definitions_is_read_by_those_of_ros_1(tmp_path: Path, way: Way) -> None:
    payload = struct.pack("<IIIIdd", 7, 1, 2, 0, 3.0, 0.5)
    md5 = NOETIC.generate_msgdef(TEMPERATURE, ros_version=1)[1]
    bag = tmp_path / "a.bag"
    with Writer(bag) as writer:
        empty = "d41d8cd98f00b204e9800998ecf8427e"
        for topic, type_, digest, data in (
            ("/known", TEMPERATURE, md5, payload),
            ("/other", TEMPERATURE, "0" * 32, payload),
            ("/empty", "p/msg/Nothing", empty, b""),
        ):
            connection = writer.add_connection(topic, type_, msgdef="", md5sum=digest)
            writer.write(connection, 1, data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConversionWarning)
        warnings.simplefilter("ignore", UndecodedWarning)
        with way(bag) as recording:
            header = {"seq": 7, "stamp": {"secs": 1, "nsecs": 2}, "frame_id": ""}
            assert row(recording, "/known") == {"header": header, "temperature": 3.0, "variance": 0.5}
            assert row(recording, "/other") == {"data": payload}
            assert row(recording, "/empty") == {}


@WAYS
def test_a_text_that_is_no_utf_8_costs_nothing_else(tmp_path: Path, way: Way) -> None:
    payload = b"\0\1\0\0" + struct.pack("<I4s", 4, b"a\xffc\0")
    bag = ros2_bag(tmp_path, 5, None, {"/text": ("std_msgs/msg/String", payload)})
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        with way(bag) as recording:
            assert row(recording, "/text") == {"data": "a\ufffdc"}
    assert [one.category for one in warned] == [UndecodedWarning]


@WAYS
def test_two_connections_of_a_topic_are_read_by_their_own_definitions(tmp_path: Path, way: Way) -> None:
    bag = tmp_path / "a.bag"
    with Writer(bag) as writer:
        for number, text in enumerate(("int32 left\nint32 right\n", "int32 right\nint32 left\n")):
            connection = writer.add_connection(
                "/w", "p/msg/Wheels", msgdef=text, md5sum=str(number) * 32, callerid=f"/n{number}"
            )
            writer.write(connection, 1 + number, struct.pack("<ii", 1, 2))
    with way(bag) as recording:
        found = [(one["left"], one["right"]) for one in recording["/w"].rows()]
        assert found == [(1, 2), (2, 1)]
        assert recording["/w"].to_arrow().column("left").to_pylist() == [1, 2]


@WAYS
def test_what_cannot_be_decoded_is_its_bytes_on_every_way_in(tmp_path: Path, way: Way) -> None:
    payloads = [b"\0\3\0\0" + bytes(8), b"\0\7\0\0" + struct.pack("<d", 1.5), b"\0\1\0\0" + bytes(20)]
    bag = ros2_bag(tmp_path, 5, None, {f"/t{n}": ("std_msgs/msg/Float64", one) for n, one in enumerate(payloads)})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UndecodedWarning)
        with way(bag) as recording:
            found = [row(recording, f"/t{n}") for n in range(3)]
    assert found == [{"_data": payloads[0]}, {"data": 1.5}, {"_data": payloads[2]}]


@WAYS
def test_a_service_is_given_by_its_own_name(tmp_path: Path, way: Way) -> None:
    info = struct.pack("<BxxxiI16s4xq", 1, 2, 3, bytes(16), 4)
    payload = b"\0\1\0\0" + info + struct.pack("<I4xqI", 1, 7, 0)
    bag = ros2_bag(tmp_path, 9, "jazzy", {"/add/_service_event": ("p/srv/Add_Event", payload)})
    with way(bag, definitions={"p/srv/Add": "int64 a\n---\nint64 sum\n"}) as recording:
        found = row(recording, "/add/_service_event")
    assert (found["request"], found["response"]) == ([{"a": 7}], [])
