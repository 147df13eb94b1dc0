"""Other people's bags become recordings, whatever ROS made them and however they are damaged."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ml_dash_mcap.conversion import convert
from ml_dash_mcap.errors import (
    ConversionWarning,
    DamagedFileError,
    EncodingError,
    FormatError,
    MissingRecordingError,
    NotFoundError,
    OptionError,
    UndecodedWarning,
    UsageError,
)
from ml_dash_mcap.formats import registry
from ml_dash_mcap.formats.ros.bag_ros1.read import Ros1File
from ml_dash_mcap.recording import Recording
from tests.support import shared, system_python
from tests.support.bags import export, record, robot_rows
from tests.support.examples import examples

Row = dict[str, Any]

STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(
    get_types_from_msg("uint8[] data\nfloat32[2] pair\nstring class\ntime_msgs/Inner[] inner", "time_msgs/msg/Odd")
)
STORE.register(get_types_from_msg("int64 n", "time_msgs/msg/Inner"))


def odd(number: int) -> Any:
    inner = STORE.types["time_msgs/msg/Inner"]
    return STORE.types["time_msgs/msg/Odd"](
        np.array([number, 255], np.uint8), np.array([0.5, number], np.float32), "word", [inner(number)] * number
    )


def stamped(number: int) -> Any:
    types = STORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](100 + number, 5), "map")
    return types["geometry_msgs/msg/PointStamped"](header, types["geometry_msgs/msg/Point"](1.0, 2.0, 3.0))


def write_rosbag2(
    folder: Path, plugin: StoragePlugin = StoragePlugin.MCAP, mode: CompressionMode = CompressionMode.NONE
) -> Path:
    """Write a bag with rosbags: three odd messages and three with a header, two of each at one time."""
    writer = Ros2Writer(folder, version=9, storage_plugin=plugin)
    if mode != CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        odds = writer.add_connection("/odd", "time_msgs/msg/Odd", typestore=STORE)
        points = writer.add_connection("/point", "geometry_msgs/msg/PointStamped", typestore=STORE)
        for number, time_ns in enumerate((1_000_000_000, 2_000_000_000, 2_000_000_000)):
            writer.write(odds, time_ns, STORE.serialize_cdr(odd(number), odds.msgtype))
            writer.write(points, time_ns, STORE.serialize_cdr(stamped(number), points.msgtype))
    return folder


ODD_ROWS = [
    {"data": bytes([number, 255]), "pair": [0.5, float(number)], "class": "word", "inner": [{"n": number}] * number}
    for number in range(3)
]


def converted(src: Path, dest: Path, **options: Any) -> dict[str, list[Row]]:
    with Recording(convert(src, dest, **options)) as recording:
        return {topic: list(recording[topic].rows()) for topic in recording.topics}


@pytest.mark.parametrize("plugin", list(StoragePlugin))
@pytest.mark.parametrize("mode", list(CompressionMode))
def test_a_rosbag2_folder_becomes_rows_compressed_or_not(
    tmp_path: Path, plugin: StoragePlugin, mode: CompressionMode
) -> None:
    impossible = (StoragePlugin.SQLITE3, CompressionMode.STORAGE), (StoragePlugin.MCAP, CompressionMode.MESSAGE)
    if (plugin, mode) in impossible:
        return
    rows = converted(write_rosbag2(tmp_path / "bag", plugin, mode), tmp_path / "run")
    times = [1.0, 2.0, 2.0]
    assert rows["/odd"] == [{**row, "_ts": time} for row, time in zip(ODD_ROWS, times, strict=True)]
    assert [row["_ts"] for row in rows["/point"]] == times
    assert rows["/point"][1] == {
        "header": {"stamp": {"sec": 101, "nanosec": 5}, "frame_id": "map"},
        "point": {"x": 1.0, "y": 2.0, "z": 3.0},
        "_ts": 2.0,
    }


def test_the_headers_stamps_are_the_times_where_asked(tmp_path: Path) -> None:
    rows = converted(write_rosbag2(tmp_path / "bag"), tmp_path / "run", time="header")
    assert [row["_ts"] for row in rows["/point"]] == [100.000000005, 101.000000005, 102.000000005]
    assert [row["_ts"] for row in rows["/odd"]] == [1.0, 2.0, 2.0]


def test_some_topics_can_be_chosen_and_progress_is_told(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    rows = converted(
        write_rosbag2(tmp_path / "bag"),
        tmp_path / "run",
        topics=["/odd"],
        progress=lambda done, total: seen.append((done, total)),
    )
    assert sorted(rows) == ["/odd"]
    assert seen[-1] == (6, 6)


@pytest.fixture
def ours(tmp_path: Path) -> Path:
    """A bag that we exported, with a message of ours and standard ones."""
    record(tmp_path / "in", {"robot": robot_rows(5)})
    return export(tmp_path / "in", tmp_path / "ours")


@pytest.mark.parametrize("name", ["robot", "/robot"])
def test_a_topic_of_ours_is_chosen_by_its_name_in_the_recording_or_in_the_bag(
    ours: Path, tmp_path: Path, name: str
) -> None:
    rows = converted(ours, tmp_path / "run", topics=[name])
    assert [row["step"] for row in rows.pop("robot")] == list(range(5))
    assert not rows


def test_a_standard_message_that_was_derived_comes_where_it_is_named(ours: Path, tmp_path: Path) -> None:
    rows = converted(ours, tmp_path / "run", topics=["/robot/joint_states"])
    assert [row["position"] for row in rows.pop("/robot/joint_states")] == [row["q"] for row in robot_rows(5)]
    assert not rows


def test_images_and_point_clouds_are_bytes_with_their_shape(tmp_path: Path) -> None:
    types = STORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](1, 0), "cam")
    image = types["sensor_msgs/msg/Image"](header, 2, 3, "rgb8", 0, 9, np.arange(18, dtype=np.uint8))
    field = types["sensor_msgs/msg/PointField"]("x", 0, 7, 1)
    points = np.array([0.5, 1.5], np.float32).view(np.uint8)
    cloud = types["sensor_msgs/msg/PointCloud2"](header, 1, 2, [field], False, 4, 8, points, True)
    with Ros2Writer(tmp_path / "bag", version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        for topic, message in (("/image", image), ("/cloud", cloud)):
            connection = writer.add_connection(topic, message.__msgtype__, typestore=STORE)
            writer.write(connection, 10**9, STORE.serialize_cdr(message, connection.msgtype))
    rows = converted(tmp_path / "bag", tmp_path / "run")
    (found,) = rows["/image"]
    assert (found["height"], found["width"], found["encoding"], found["step"]) == (2, 3, "rgb8", 9)
    assert found["data"] == bytes(range(18))
    (found,) = rows["/cloud"]
    assert found["fields"] == [{"name": "x", "offset": 0, "datatype": 7, "count": 1}]
    assert (found["height"], found["width"], found["point_step"], found["row_step"]) == (1, 2, 4, 8)
    assert np.frombuffer(found["data"], np.float32).tolist() == [0.5, 1.5]


def test_a_ros_1_bag_becomes_rows(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    with Ros1Writer(tmp_path / "in.bag") as writer:
        connection = writer.add_connection("/point", "geometry_msgs/msg/PointStamped", typestore=store)
        for number in range(3):
            header = types["std_msgs/msg/Header"](number, types["builtin_interfaces/msg/Time"](5, 6), "map")
            message = types["geometry_msgs/msg/PointStamped"](header, types["geometry_msgs/msg/Point"](1.0, 2.0, 3.0))
            writer.write(connection, 10**9 * number, store.serialize_ros1(message, connection.msgtype))
    rows = converted(tmp_path / "in.bag", tmp_path / "run")["/point"]
    assert rows[2] == {
        "header": {"seq": 2, "stamp": {"secs": 5, "nsecs": 6}, "frame_id": "map"},
        "point": {"x": 1.0, "y": 2.0, "z": 3.0},
        "_ts": 2.0,
    }
    assert converted(tmp_path / "in.bag", tmp_path / "run2", time="header")["/point"][0]["_ts"] == 5.000000006


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_a_bag_that_ros_1_itself_wrote_becomes_rows(tmp_path: Path, compression: str) -> None:
    needs = ("rosbag", "roslz4", "sensor_msgs.msg")
    system_python.run("write_bag.py", tmp_path / "in.bag", compression, needs=needs, package="python3-rosbag")
    rows = converted(tmp_path / "in.bag", tmp_path / "run")
    assert [row["_ts"] for row in rows["/joints"]] == [100 + number + 5e-9 for number in range(100)]
    assert [(row["name"], row["position"]) for row in rows["/joints"]] == [
        (["a", "\u00e4"], [0.5, float(number)]) for number in range(100)
    ]
    assert [(row["height"], row["width"], row["data"]) for row in rows["/image"]] == [
        (1, 2, bytes([number, 255])) for number in range(100)
    ]
    by_header = converted(tmp_path / "in.bag", tmp_path / "run2", time="header", topics=["/joints"])
    assert [row["_ts"] for row in by_header["/joints"]] == [number + 7e-9 for number in range(100)]


def test_a_file_of_a_bag_can_be_read_alone(tmp_path: Path) -> None:
    write_rosbag2(tmp_path / "sq", StoragePlugin.SQLITE3)
    assert len(converted(tmp_path / "sq/sq.db3", tmp_path / "run")["/odd"]) == 3
    write_rosbag2(tmp_path / "mc")
    assert len(converted(tmp_path / "mc/mc.mcap", tmp_path / "run2")["/odd"]) == 3


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_a_folder_without_its_metadata_is_read_by_its_files(tmp_path: Path, plugin: StoragePlugin) -> None:
    bag = write_rosbag2(tmp_path / "sq", plugin)
    (bag / "metadata.yaml").unlink()
    assert len(converted(bag, tmp_path / "run")["/odd"]) == 3


def test_a_folder_of_ours_without_its_metadata_gives_the_rows_back(ours: Path, tmp_path: Path) -> None:
    (ours / "metadata.yaml").unlink()
    assert list(converted(ours, tmp_path / "run")) == ["robot"]


# -- what cannot be read ----------------------------------------------------------------------------------------------


def refused(src: Path, tmp_path: Path, error: type[Exception], match: str, **options: Any) -> None:
    with pytest.raises(error, match=match):
        convert(src, tmp_path / "to/run", **options)
    assert not list(tmp_path.glob("to/*"))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    bag = write_rosbag2(tmp_path / "bag", StoragePlugin.SQLITE3)
    (bag / "bag.db3").unlink()
    refused(bag, tmp_path, MissingRecordingError, r"bag\.db3")


def test_a_file_outside_the_folder_is_refused(tmp_path: Path) -> None:
    bag = write_rosbag2(tmp_path / "bag", StoragePlugin.SQLITE3)
    text = (bag / "metadata.yaml").read_text().replace("bag.db3", "../bag.db3")
    (bag / "metadata.yaml").write_text(text)
    refused(bag, tmp_path, MissingRecordingError, "outside")


@pytest.mark.parametrize("text", ["rosbag2_bagfile_information: [", "rosbag2_bagfile_information"])
def test_broken_metadata_are_named(tmp_path: Path, text: str) -> None:
    bag = write_rosbag2(tmp_path / "bag", StoragePlugin.SQLITE3)
    (bag / "metadata.yaml").write_text(text)
    refused(bag, tmp_path, DamagedFileError, r"metadata\.yaml")


@pytest.mark.parametrize("part", [0.3, 0.7, 0.95])
def test_a_truncated_bag_is_an_error_that_names_it(tmp_path: Path, part: float) -> None:
    record(tmp_path / "in", {"robot": [{**row, "_ts": 1.0 + number} for number, row in enumerate(robot_rows(300))]})
    bag = export(tmp_path / "in", tmp_path / "in.bag", "rosbag1")
    folder = export(tmp_path / "in", tmp_path / "sq", storage="sqlite3")
    for path in (bag, folder / "sq_0.db3"):
        data = path.read_bytes()
        path.write_bytes(data[: int(len(data) * part)])
        refused(path, tmp_path, DamagedFileError, path.name)


@pytest.mark.parametrize(("part", "count"), [(0.1, 0), (0.99, 30)])
def test_an_mcap_file_that_is_cut_is_an_error_unless_what_it_has_is_wanted(
    tmp_path: Path, part: float, count: int
) -> None:
    record(tmp_path / "in", {"robot": [{"x": number, "_ts": 1.0 + number} for number in range(30)]})
    bag = export(tmp_path / "in", tmp_path / "mc") / "mc_0.mcap"
    data = bag.read_bytes()
    bag.write_bytes(data[: int(len(data) * part)])
    refused(bag.parent, tmp_path, DamagedFileError, r"mc_0\.mcap, byte \d+: the file has no end.*on_damage='skip'")
    with pytest.warns(ConversionWarning, match=r"mc_0\.mcap, byte .*left out"):
        rows = converted(bag.parent, tmp_path / "run", on_damage="skip")
    assert len(rows.get("robot", ())) == count


def test_a_chunk_that_is_damaged_is_an_error_unless_the_rest_is_wanted(tmp_path: Path) -> None:
    bag = write_rosbag2(tmp_path / "bag")
    path = bag / "bag.mcap"
    data = bytearray(path.read_bytes())
    data[bytes(data).index(b"word")] ^= 1
    path.write_bytes(data)
    rows = converted(bag, tmp_path / "as-it-is")  # rosbags writes no checksums
    assert rows["/odd"][0]["class"] != "word"
    ours = export(record(tmp_path / "in", {"a": [{"x": 0.5}]}), tmp_path / "ours", compression="none")
    data = bytearray((ours / "ours_0.mcap").read_bytes())
    data[bytes(data).index(np.float64(0.5).tobytes())] ^= 1
    (ours / "ours_0.mcap").write_bytes(data)
    refused(ours, tmp_path, DamagedFileError, "CRC")
    with pytest.warns(ConversionWarning, match="CRC"):
        assert not converted(ours, tmp_path / "run", on_damage="skip").get("a")


def test_a_message_of_ours_that_is_damaged_costs_no_other_where_the_rest_is_wanted(tmp_path: Path) -> None:
    record(tmp_path / "in", {"robot": [{"text": f"row {number}", "_ts": 1.0 + number} for number in range(50)]})
    bag = export(tmp_path / "in", tmp_path / "in.bag", "rosbag1")
    data = bytearray(bag.read_bytes())
    at = data.index(b"row 17")
    data[at - 4 : at] = b"\xff\xff\0\0"  # the text's length
    bag.write_bytes(data)
    refused(bag, tmp_path, DamagedFileError, r"a message of topic '/robot' from 1000000000 ns to 50000000000 ns is no")
    with pytest.warns(ConversionWarning, match=r"the message of topic '/robot' at 18000000000 ns is no .*left out"):
        rows = converted(bag, tmp_path / "run", on_damage="skip")
    assert [row["text"] for row in rows["robot"]] == [f"row {number}" for number in range(50) if number != 17]


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        (b"compression=none", b"compression=nune", "compression is b'nune', which is not known"),
        (b"op=\x05", b"op=\x09", "not what the index says"),
        (b"op=\x07", b"op=\x02", "not what the index says"),
        (b"conn=", b"cunn=", "no proper 'conn'"),
        (b"#ROSBAG V2.0", b"#ROSBAG V1.2", "its version is b'1.2'"),
        (b"index_pos=", b"index_pos=\0\0\0\0\0\0\0\0", "no index.*rosbag reindex"),
        (b"time=", b"time=\xff", None),
        (b"size=", b"size=\xff\xff\xff\xff", "4294967295 bytes, of"),
    ],
)
def test_a_ros_1_bag_with_a_broken_record_is_named(tmp_path: Path, old: bytes, new: bytes, match: str | None) -> None:
    record(tmp_path / "in", {"robot": [{"x": 0.5, "_ts": 1.0}]})
    bag = export(tmp_path / "in", tmp_path / "in.bag", "rosbag1")
    data = bytearray(bag.read_bytes())
    at = data.rindex(old) if old in (b"op=\x07", b"conn=") else data.index(old)
    data[at : at + len(new)] = new
    bag.write_bytes(data)
    if match is None:
        assert len(converted(bag, tmp_path / "run")["robot"]) == 1  # the index says the time, and so does the row
    else:
        refused(bag, tmp_path, DamagedFileError, rf"in\.bag.*{match}")


@pytest.fixture(scope="module")
def small_bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Bags of ROS 1, by compression."""
    folder = tmp_path_factory.mktemp("small")
    record(folder / "in", {"robot": [{**row, "_ts": 1.0 + number} for number, row in enumerate(robot_rows(3))]})
    return {
        name: export(folder / "in", folder / f"{name}.bag", "rosbag1", compression=name).read_bytes()
        for name in ("none", "bz2", "lz4")
    }


@settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_damage_to_a_ros_1_bag_is_no_other_error(
    tmp_path: Path, small_bags: dict[str, bytes], data: st.DataObject
) -> None:
    whole = bytearray(small_bags[data.draw(st.sampled_from(sorted(small_bags)))])
    for _ in range(data.draw(st.integers(1, 4))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    (tmp_path / "x.bag").write_bytes(whole[: data.draw(st.integers(0, len(whole)) | st.just(len(whole)))])
    with contextlib.suppress(DamagedFileError):
        read_blocks(tmp_path / "x.bag")
    with contextlib.suppress(DamagedFileError):
        read_blocks(tmp_path / "x.bag", salvages=True)


def read_blocks(path: Path, **options: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConversionWarning)  # names that are no UTF-8 are told
        _read_blocks(path, **options)


def _read_blocks(path: Path, **options: Any) -> None:
    with contextlib.closing(Ros1File(path, **options)) as bag:
        for block in bag.blocks(bag.channels):
            columns = (block.channels, block.times_ns, block.published_ns, block.sequences, block.payloads)
            assert {len(column) for column in columns} == {len(block)}


def test_empty_files_are_no_bags(tmp_path: Path) -> None:
    for name in ("x.bag", "x.db3"):
        (tmp_path / name).touch()
        refused(tmp_path / name, tmp_path, DamagedFileError, name)


def test_nothing_at_the_source_is_a_missing_recording(tmp_path: Path) -> None:
    refused(tmp_path / "nothing", tmp_path, MissingRecordingError, "nothing")


def test_topics_that_are_not_there_are_named(ours: Path, tmp_path: Path) -> None:
    refused(ours, tmp_path, NotFoundError, "no topic 'robt'.*did you mean 'robot'", topics=["robt"])


def test_what_is_no_bag_is_told_from_one(tmp_path: Path) -> None:
    (tmp_path / "x.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    refused(tmp_path / "x.bag", tmp_path, DamagedFileError, r"x\.bag")
    base = sqlite3.connect(tmp_path / "x.db3")
    base.execute("CREATE TABLE topics(id INTEGER)")
    base.commit()
    base.close()
    refused(tmp_path / "x.db3", tmp_path, DamagedFileError, "no bag")
    (tmp_path / "x.txt").write_text("text")
    assert registry.detect(tmp_path / "x.txt") is None
    assert registry.detect(tmp_path / "nothing") is None
    refused(tmp_path / "x.txt", tmp_path, FormatError, "format=")


def test_a_type_that_nobody_knows_is_named_or_left_out(tmp_path: Path) -> None:
    bag = write_rosbag2(tmp_path / "bag", StoragePlugin.SQLITE3)
    base = sqlite3.connect(bag / "bag.db3")
    base.execute("DELETE FROM message_definitions")
    base.commit()
    base.close()
    with pytest.warns(ConversionWarning, match=r"topic '/odd' of type 'time_msgs/msg/Odd'.*definitions="):
        convert(bag, tmp_path / "kept")
    with Recording(tmp_path / "kept") as recording, pytest.warns(UndecodedWarning, match="/odd"):
        assert [row["data"][:4] for row in recording["/odd"].rows()] == [bytes([0, 1, 0, 0])] * 3
    unknown = r"topic '/odd' of type 'time_msgs/msg/Odd'.*definitions="
    refused(bag, tmp_path, EncodingError, unknown, on_unknown="raise")
    with pytest.warns(ConversionWarning, match="/odd"):
        assert sorted(converted(bag, tmp_path / "skipped", on_unknown="skip")) == ["/point"]
    text = "uint8[] data\nfloat32[2] pair\nstring class\ntime_msgs/Inner[] inner\n===\nMSG: time_msgs/Inner\nint64 n\n"
    given = converted(bag, tmp_path / "given", definitions={"time_msgs/Odd": text})
    assert given["/odd"][1]["data"] == bytes([1, 255])


def test_messages_that_are_not_of_their_type_are_named(tmp_path: Path) -> None:
    bag = write_rosbag2(tmp_path / "bag", StoragePlugin.SQLITE3)
    base = sqlite3.connect(bag / "bag.db3")
    base.execute("UPDATE messages SET data = X'0001000000' WHERE id = 2")
    base.commit()
    base.close()
    what = r"topic '/point' has a message of 5 bytes that is no geometry_msgs/msg/PointStamped"
    for options in ({}, {"encoding": "json"}):
        with pytest.warns(UndecodedWarning, match=what):
            rows = converted(bag, tmp_path / f"run{len(options)}", **options)
        assert [len(rows["/odd"]), len(rows["/point"])] == [3, 3]
        assert rows["/point"][0] == {"_data": b"\0\1\0\0\0", "_ts": 1.0}
    match = r"'/point' at 1000000000 ns is no geometry_msgs"
    refused(bag, tmp_path, DamagedFileError, match, encoding="json", on_unknown="raise")


@pytest.mark.parametrize(
    ("options", "error", "match"),
    [
        ({"time": "receive"}, OptionError, "time='receive'"),
        ({"on_unknown": "warn"}, OptionError, "on_unknown='warn'"),
        ({"times": "log"}, UsageError, "no option 'times'"),
        ({"on_damage": "ignore"}, OptionError, "on_damage='ignore'"),
        ({"topics": "/odd"}, UsageError, r"pass a list of topics, such as topics=\['/odd'\]"),
        ({"definitions": ["a"]}, OptionError, r"definitions=\['a'\]"),
        ({"definitions": {"a/B": 5}}, OptionError, "'a/B': pass its text"),
        ({"definitions": {"a/B": Path("nowhere.msg")}}, OptionError, "'a/B': nowhere.msg cannot be read"),
    ],
)
def test_an_option_that_makes_no_sense_is_named(
    tmp_path: Path, options: dict[str, Any], error: type[Exception], match: str
) -> None:
    refused(write_rosbag2(tmp_path / "bag"), tmp_path, error, match, **options)


# -- bags from the wild -----------------------------------------------------------------------------------------------


def counts(src: Path, dest: Path, **options: Any) -> dict[str, int]:
    with Recording(convert(src, dest, **options)) as recording:
        return {topic: info.count for topic, info in recording.topics.items()}


@pytest.mark.parametrize("name", ["a-turtlesim-none.bag", "a-turtlesim-bz2.bag"])
def test_the_turtles_of_ros_1(tmp_path: Path, name: str) -> None:
    with Recording(convert(shared.file(f"rosbag1/{name}"), tmp_path / "run")) as recording:
        assert sum(info.count for info in recording.topics.values()) == 8647
        assert recording.topics["/tf"].count == 2688
        assert recording.duration == pytest.approx(21.7, abs=0.1)
        row = next(iter(recording["/tf"].rows()))
        assert sorted(row["transforms"][0]) == ["child_frame_id", "header", "transform"]


def test_chunks_that_are_not_in_order(tmp_path: Path) -> None:
    with Recording(convert(shared.file("rosbag1/a-unsorted-chunks.bag"), tmp_path / "run")) as recording:
        assert recording.topics["foo"].count == 3
        assert recording.duration == pytest.approx(2.0, abs=0.01)


def test_a_bag_of_humble_without_definitions_needs_those_of_its_own_types(tmp_path: Path) -> None:
    src = shared.file("rosbag2/a-humble-turtlesim-sqlite3")
    with pytest.raises(EncodingError, match="turtlesim/msg/Pose"):
        convert(src, tmp_path / "run", on_unknown="raise")
    text = "float32 x\nfloat32 y\nfloat32 theta\nfloat32 linear_velocity\nfloat32 angular_velocity\n"
    assert counts(src, tmp_path / "run", definitions={"turtlesim/msg/Pose": text}) == {
        "/turtle1/cmd_vel": 475,
        "/turtle1/pose": 2245,
    }


def test_a_bag_of_foxy_in_five_files(tmp_path: Path) -> None:
    found = counts(shared.file("rosbag2/a-foxy-split5-sqlite3"), tmp_path / "run")
    assert sorted(found) == [letter * 3 for letter in "ABCDEFGH"]
    assert sum(found.values()) == 6074
    with Recording(tmp_path / "run") as recording:
        assert (recording.start, recording.end) == (1000e-9, 2998e-9)


def test_a_bag_of_services_without_metadata(tmp_path: Path) -> None:
    src = shared.file("rosbag2/a-rolling2023-services-nometa-mcap")
    shutil.copytree(src, tmp_path / "bag")
    for src in (tmp_path / "bag", tmp_path / "bag/topics_and_services.mcap"):
        found = counts(src, tmp_path / f"from-{src.name}")
        assert {topic: count for topic, count in found.items() if count} == {
            "/parameter_events": 7,
            "/add_two_ints/_service_event": 6,
        }


def test_a_bag_of_humble_in_mcap(tmp_path: Path) -> None:
    found = counts(shared.file("rosbag2/a-humble-imu-jointstate-mcap"), tmp_path / "run")
    assert found == {"/one_shot/imu": 1, "/one_shot/joint_state": 1}
