"""Bags go into a recording and out again with the same messages: bytes, nanoseconds, types, order, QoS, connections."""

from __future__ import annotations

import json
import shutil
import signal
import sqlite3
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from ruamel.yaml import YAML

from ml_dash_mcap import Recording, convert
from ml_dash_mcap.errors import ConversionWarning, DamagedFileError, NotFoundError, OptionError
from tests.support import ros_messages, shared, system_python
from tests.support.examples import examples

JAZZY = get_typestore(Stores.ROS2_JAZZY)
NOETIC = get_typestore(Stores.ROS1_NOETIC)
KINDS = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}
QOS = Qos(
    QosHistory.KEEP_ALL,
    3,
    QosReliability.BEST_EFFORT,
    QosDurability.TRANSIENT_LOCAL,
    QosTime(1, 2),
    QosTime(3, 4),
    QosLiveliness.AUTOMATIC,
    QosTime(5, 6),
    avoid_ros_namespace_conventions=True,
)


class Sent(NamedTuple):
    topic: str
    time_ns: int
    data: bytes


class Bag(NamedTuple):
    """All that a bag says, but for what its container says of itself."""

    messages: list[Sent]
    """In the order in which they are stored."""
    topics: list[Any]
    """Name, type, definition, digest, QoS or connection header, and how many messages."""


def read(path: Path) -> Bag:
    """Read a bag with the tools of others: rosbags for topics and definitions, and its storage for the order."""
    reader: Any = Ros1Reader(path) if path.suffix == ".bag" else Ros2Reader(path)
    with reader:
        topics = [
            (one.topic, one.msgtype, one.msgdef.data, one.digest, repr(one.ext), one.msgcount)
            for one in reader.connections
        ]
        by_time = [Sent(one.topic, time_ns, bytes(data)) for one, time_ns, data in reader.messages()]
    stored = by_time
    if files := sorted(path.glob("*.db3")):
        stored = [one for file in files for one in rows_of(file)]
    elif files := sorted(path.glob("*.mcap")):
        stored = [one for file in files for one in records_of(file)]
    assert sorted(stored) == sorted(by_time)
    return Bag(stored, sorted(topics))


def rows_of(file: Path) -> list[Sent]:
    base = sqlite3.connect(file)
    found = base.execute(
        "SELECT name, timestamp, data FROM messages JOIN topics ON topics.id = topic_id ORDER BY messages.id"
    )
    rows = [Sent(*row) for row in found]
    base.close()
    return rows


def records_of(file: Path) -> list[Sent]:
    with file.open("rb") as stream:
        found = make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False)
        return [Sent(channel.topic, message.log_time, message.data) for _, channel, message in found]


def there_and_back(bag: Path, **options: Any) -> Path:
    """Make a recording of a bag, and a bag of the same kind of that; returns the second bag."""
    kind = "rosbag1" if bag.suffix == ".bag" else "rosbag2"
    storage = {"storage": "sqlite3"} if kind == "rosbag2" and next(bag.glob("*.db3*"), None) else {}
    back = bag.parent / ("back.bag" if kind == "rosbag1" else "back")
    with Recording(convert(bag, bag.parent / "run")) as recording:
        recording.export(back, format=kind, **{**storage, **options})
    return back


@st.composite
def bags(draw: st.DrawFn) -> tuple[ros_messages.Messages, list[tuple[int, int, dict[str, Any]]]]:
    """Definitions, and messages: topic, time in ns, row."""
    messages = draw(ros_messages.messages())
    times = st.integers(0, 2**31 * 10**9 - 1) | st.integers(1_700_000_000_000_000_000, 1_700_000_000_000_000_100)
    sent = st.tuples(st.integers(0, 2), times, ros_messages.rows(messages))
    return messages, draw(st.lists(sent, max_size=12))


@settings(max_examples=examples(25), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(bags(), st.sampled_from(["mcap", "sqlite3", "ros1"]))
def test_any_bag_comes_back_as_it_was(tmp_path_factory: pytest.TempPathFactory, given_: Any, kind: str) -> None:
    messages, sent = given_
    folder = tmp_path_factory.mktemp("bag")
    store = ros_messages.typestore(messages)
    bag = folder / ("in.bag" if kind == "ros1" else "in")
    if kind == "ros1":
        writer: Any = Ros1Writer(bag)
        serialize = store.serialize_ros1
    else:
        writer = Ros2Writer(bag, version=9, storage_plugin=KINDS[kind])
        serialize = store.serialize_cdr
    options = {} if kind == "ros1" else {"offered_qos_profiles": [QOS]}
    with writer:
        topics = [
            writer.add_connection(f"/t{number}", "pkg/msg/Outer", typestore=store, **options) for number in range(4)
        ]
        for number, time_ns, row in sent:
            data = serialize(ros_messages.instance(store, messages, row), "pkg/msg/Outer")
            writer.write(topics[number], time_ns, bytes(data))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "there are messages at time 0", ConversionWarning)
        back = there_and_back(bag)
    assert read(back) == read(bag)


def twist(x: float) -> bytes:
    vector = JAZZY.types["geometry_msgs/msg/Vector3"]
    message = JAZZY.types["geometry_msgs/msg/Twist"](vector(x, 0.0, 0.0), vector(0.0, 0.0, 1.0))
    return bytes(JAZZY.serialize_cdr(message, "geometry_msgs/msg/Twist"))


TIMES = [1_700_000_000_000_000_000 + 50 * number for number in range(8)]


def write_twists(folder: Path, kind: str, mode: CompressionMode = CompressionMode.NONE) -> Path:
    """Eight messages 50 ns apart, closer than doubles are in seconds, and a topic without messages."""
    writer = Ros2Writer(folder, version=9, storage_plugin=KINDS[kind])
    if mode != CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    writer.set_custom_data("operator", 'ann: \u00e4 "1"')
    with writer:
        velocity = writer.add_connection("/turtle1/cmd_vel", "geometry_msgs/msg/Twist", typestore=JAZZY)
        writer.add_connection("/silent", "sensor_msgs/msg/Image", typestore=JAZZY, offered_qos_profiles=[QOS])
        for number, time_ns in enumerate(TIMES):
            writer.write(velocity, time_ns, twist(number))
    return folder


@pytest.mark.parametrize("kind", KINDS)
def test_messages_nanoseconds_apart_keep_times_type_and_number(tmp_path: Path, kind: str) -> None:
    bag = write_twists(tmp_path / "bag", kind)
    back = there_and_back(bag)
    assert read(back) == read(bag)
    metadata = YAML(typ="safe").load(back / "metadata.yaml")["rosbag2_bagfile_information"]
    assert metadata["custom_data"] == {"operator": 'ann: \u00e4 "1"'}
    assert metadata["ros_distro"] == "rosbags"
    with Recording(tmp_path / "run") as recording:
        assert [row["linear"]["x"] for row in recording["/turtle1/cmd_vel"].rows()] == list(range(8))
        assert recording.topics["/silent"].count == 0
        assert len(recording["/turtle1/cmd_vel"].to_arrow()) == 8


@pytest.mark.parametrize("kind", KINDS)
def test_every_mcap_reader_has_the_recording_of_a_bag(tmp_path: Path, kind: str) -> None:
    convert(write_twists(tmp_path / "bag", kind), tmp_path / "run")
    (file,) = (tmp_path / "run").glob("*.mcap")
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        assert {one.topic: one.message_encoding for one in summary.channels.values()} == {
            "/turtle1/cmd_vel": "cdr",
            "/silent": "cdr",
        }
        assert summary.statistics.message_count == 8
        found = list(reader.iter_messages())
    assert [(schema.name, message.log_time) for schema, _, message in found] == [
        ("geometry_msgs/msg/Twist", time_ns) for time_ns in TIMES
    ]


@pytest.mark.parametrize("kind", KINDS)
def test_some_topics_and_a_window_go_out_as_they_were(tmp_path: Path, kind: str) -> None:
    writer = Ros2Writer(tmp_path / "bag", version=9, storage_plugin=KINDS[kind])
    with writer:
        topics = [writer.add_connection(name, "geometry_msgs/msg/Twist", typestore=JAZZY) for name in ("/a", "/b")]
        for number in range(20):
            writer.write(topics[number % 2], 10**9 * (20 - number), twist(number))
    with Recording(convert(tmp_path / "bag", tmp_path / "run")) as recording:
        recording.export(tmp_path / "one", format="rosbag2", topics=["/b"])
        recording.export(tmp_path / "part", format="rosbag2", storage=kind, start=5.0, end=8.0)
        recording.export(tmp_path / "moved", format="rosbag2", time_offset=1.5)
        with pytest.raises(Exception, match="before 0"):
            recording.export(tmp_path / "early", format="rosbag2", time_offset=-100.0)
    whole = read(tmp_path / "bag").messages
    assert read(tmp_path / "one").messages == [one for one in whole if one.topic == "/b"]
    assert read(tmp_path / "part").messages == [one for one in whole if 5 * 10**9 <= one.time_ns <= 8 * 10**9]
    assert [one.time_ns for one in read(tmp_path / "moved").messages] == [one.time_ns + 1_500_000_000 for one in whole]
    assert not (tmp_path / "early").exists()


def test_convert_takes_some_topics(tmp_path: Path) -> None:
    bag = write_twists(tmp_path / "bag", "mcap")
    with Recording(convert(bag, tmp_path / "run", topics=["/silent"])) as recording:
        assert list(recording.topics) == ["/silent"]
    with pytest.raises(NotFoundError, match="/turtle1/cmd_vel"):
        convert(bag, tmp_path / "other", topics=["/turtle1/cmd_ve"])


def test_a_split_bag_keeps_its_files_and_can_be_split_again(tmp_path: Path) -> None:
    src = shared.file("rosbag2/a-foxy-split5-sqlite3")
    convert(src, tmp_path / "run")
    assert len(list((tmp_path / "run").glob("*.mcap"))) == 5
    with Recording(tmp_path / "run") as recording:
        assert sum(info.count for info in recording.topics.values()) == 6074
        recording.export(tmp_path / "one", format="rosbag2", storage="sqlite3")
        recording.export(tmp_path / "some", format="rosbag2", split_bytes=10_000)
    whole = [row for number in range(5) for row in rows_of(src / f"wbag_{number}.db3")]
    assert rows_of(tmp_path / "one/one_0.db3") == whole
    assert len(list((tmp_path / "some").glob("*.mcap"))) > 2
    assert sorted(read(tmp_path / "some").messages) == sorted(whole)


@pytest.mark.parametrize("name", ["a-turtlesim-none.bag", "a-turtlesim-bz2.bag", "a-unsorted-chunks.bag"])
def test_bags_of_ros_1_from_the_wild_come_back(tmp_path: Path, name: str) -> None:
    bag = shutil.copy(shared.file(f"rosbag1/{name}"), tmp_path / "in.bag")
    back = there_and_back(Path(bag), compression="bz2")
    assert read(back) == read(Path(bag))
    needs = ("rosbag", "roslz4", "sensor_msgs.msg")
    there, here = (
        system_python.run("read_raw_bag.py", path, needs=needs, package="python3-rosbag") for path in (bag, back)
    )
    assert here == there


def test_a_bag_of_humble_comes_back(tmp_path: Path) -> None:
    bag = Path(shutil.copytree(shared.file("rosbag2/a-humble-turtlesim-sqlite3"), tmp_path / "bag"))
    with pytest.warns(ConversionWarning, match="turtlesim/msg/Pose"):
        back = there_and_back(bag)
    assert rows_of(back / "back_0.db3") == rows_of(bag / "subset_0.db3")
    text = (back / "metadata.yaml").read_text()
    assert "version: 8" in text and "humble" in text


# -- ROS 1 connections -------------------------------------------------------------------------------------------------


def test_two_connections_of_different_definitions_keep_each_its_own(tmp_path: Path) -> None:
    texts = {"int32 left\nint32 right\n": "a" * 32, "int32 right\nint32 left\n": "b" * 32}
    with Ros1Writer(tmp_path / "in.bag") as writer:
        connections = [
            writer.add_connection(
                "/wheels", "pkg/msg/Wheels", msgdef=text, md5sum=digest, callerid=f"/node{number}", latching=number
            )
            for number, (text, digest) in enumerate(texts.items())
        ]
        for number in range(6):
            writer.write(connections[number % 2], 10**9 * (1 + number), np.array([7, 8], "<i4").tobytes())
    with Recording(convert(tmp_path / "in.bag", tmp_path / "run")) as recording:
        rows = [(row["left"], row["right"]) for row in recording["/wheels"].rows()]
        assert rows == [(7, 8), (8, 7)] * 3
        table = recording["/wheels"].to_numpy()
        assert table["left"].tolist() == [7, 8] * 3
        recording.export(tmp_path / "back.bag", format="rosbag1")
    assert read(tmp_path / "back.bag") == read(tmp_path / "in.bag")
    assert sorted(one[4] for one in read(tmp_path / "back.bag").topics) == [
        "ConnectionExtRosbag1(callerid='/node0', latching=0)",
        "ConnectionExtRosbag1(callerid='/node1', latching=1)",
    ]


# -- the other generation ----------------------------------------------------------------------------------------------


def test_ros_2_becomes_ros_1_as_rosbags_has_it(tmp_path: Path) -> None:
    bag = write_stamped(tmp_path / "in")
    with Recording(convert(bag, tmp_path / "run")) as recording, pytest.warns(ConversionWarning) as told:
        recording.export(tmp_path / "out.bag", format="rosbag1")
    assert {str(one.message) for one in told} == {
        "topic '/range': in ROS 1, sensor_msgs/msg/Range lacks the field 'variance'",
        "topic '/wide' is left out: type 'wide_msgs/msg/Wide': it has a wstring, which ROS 1 does not have",
    }
    with Ros1Reader(tmp_path / "out.bag") as reader:
        found = [(one.topic, one.msgtype, time_ns, bytes(data)) for one, time_ns, data in reader.messages()]
        for one in reader.connections:
            if one.msgtype in NOETIC.fielddefs:
                assert one.digest == NOETIC.generate_msgdef(one.msgtype, ros_version=1)[1]
        messages = {topic: NOETIC.deserialize_ros1(data, type_) for topic, type_, _, data in found if topic != "/own"}
        assert {one.topic: one.ext.latching for one in reader.connections}["/latched"] == 1
    assert [(topic, time_ns) for topic, _, time_ns, _ in found] == [
        ("/point", 1_000_000_001),
        ("/range", 1_000_000_002),
        ("/own", 1_000_000_003),
        ("/latched", 1_000_000_005),
    ]
    assert (messages["/point"].header.stamp.sec, messages["/point"].header.frame_id) == (5, "map")
    assert messages["/point"].point.z == 3.0
    assert messages["/range"].range == 2.5
    assert found[2][3] == np.array([7, 9], "<i4").tobytes()


def write_stamped(folder: Path) -> Path:
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg("int32 left\nint32 right", "own_msgs/msg/Wheels"))
    types = store.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](5, 6), "map")
    point = types["geometry_msgs/msg/PointStamped"](header, types["geometry_msgs/msg/Point"](1.0, 2.0, 3.0))
    range_ = types["sensor_msgs/msg/Range"](header, 1, 0.5, 0.1, 4.0, 2.5, 0.25)
    wheels = types["own_msgs/msg/Wheels"](7, 9)
    with Ros2Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for number, (topic, message) in enumerate((("/point", point), ("/range", range_), ("/own", wheels)), start=1):
            connection = writer.add_connection(topic, message.__msgtype__, typestore=store)
            writer.write(connection, 10**9 + number, store.serialize_cdr(message, connection.msgtype))
        wide = writer.add_connection(
            "/wide", "wide_msgs/msg/Wide", msgdef="wstring text\n", rihs01="RIHS01_0", serialization_format="cdr"
        )
        writer.write(wide, 10**9 + 4, b"\0\1\0\0\1\0\0\0a\0")
        latched = writer.add_connection("/latched", point.__msgtype__, typestore=store, offered_qos_profiles=[QOS])
        writer.write(latched, 10**9 + 5, store.serialize_cdr(point, latched.msgtype))
    return folder


def test_ros_1_becomes_ros_2_as_rosbags_has_it(tmp_path: Path) -> None:
    types = NOETIC.types
    header = types["std_msgs/msg/Header"](41, types["builtin_interfaces/msg/Time"](5, 6), "map")
    point = types["geometry_msgs/msg/PointStamped"](header, types["geometry_msgs/msg/Point"](1.0, 2.0, 3.0))
    vectors = np.arange(9, dtype=np.float64), np.arange(12, dtype=np.float64)
    roi = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    camera = types["sensor_msgs/msg/CameraInfo"](
        header, 1, 2, "plumb_bob", np.zeros(5), *(vectors[0], vectors[0], vectors[1]), 0, 0, roi
    )
    with Ros1Writer(tmp_path / "in.bag") as writer:
        for number, (topic, message) in enumerate((("/point", point), ("/camera", camera)), start=1):
            connection = writer.add_connection(topic, message.__msgtype__, typestore=NOETIC, latching=1)
            writer.write(connection, 10**9 + number, NOETIC.serialize_ros1(message, connection.msgtype))
    with Recording(convert(tmp_path / "in.bag", tmp_path / "run")) as recording:
        recording.export(tmp_path / "out", format="rosbag2", storage="sqlite3")
    with Ros2Reader(tmp_path / "out") as reader:
        found = {
            one.topic: (one, time_ns, JAZZY.deserialize_cdr(data, one.msgtype))
            for one, time_ns, data in reader.messages()
        }
    for connection, _, _ in found.values():
        assert connection.digest == JAZZY.hash_rihs01(connection.msgtype)
        assert connection.ext.offered_qos_profiles[0].durability == QosDurability.TRANSIENT_LOCAL
    assert found["/point"][1] == 1_000_000_001
    assert found["/point"][2].header.stamp.nanosec == 6
    assert found["/camera"][2].k.tolist() == vectors[0].tolist()


# -- how bags lie on disk ----------------------------------------------------------------------------------------------

CRASH = """
import os, shutil, signal, sqlite3, sys
base = sqlite3.connect(sys.argv[1], isolation_level=None)
base.execute("PRAGMA journal_mode=WAL")
base.execute("PRAGMA wal_autocheckpoint=0")
first = int(sys.argv[2])
if first == 0:
    base.executescript("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
        " serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,"
        " data BLOB NOT NULL);"
        "INSERT INTO topics VALUES (1, '/n', 'std_msgs/msg/UInt8', 'cdr', '')")
for number in range(first, int(sys.argv[3])):
    base.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)", (number, b"\\0\\1\\0\\0" + bytes([number])))
if len(sys.argv) > 4:
    base.execute("PRAGMA wal_checkpoint(TRUNCATE)")
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize("checkpointed", [0, 3])
def test_rows_that_a_crash_left_in_the_write_ahead_log_are_there(tmp_path: Path, checkpointed: int) -> None:
    (tmp_path / "bag").mkdir()
    file = tmp_path / "bag/bag_0.db3"
    runs = [(0, 3, "checkpoint"), (3, 10)] if checkpointed else [(0, 10)]
    for run in runs:
        killed = subprocess.run([sys.executable, "-c", CRASH, str(file), *map(str, run)])
        assert killed.returncode == -signal.SIGKILL
    assert Path(f"{file}-wal").stat().st_size
    before = {one.name: one.read_bytes() for one in file.parent.iterdir()}
    for path in (file, file.parent):
        with Recording(path) as recording:
            assert [row["data"] for row in recording["/n"].rows()] == list(range(10))
            assert recording["/n"].info.schema_name == "std_msgs/msg/UInt8"
    assert {one.name: one.read_bytes() for one in file.parent.iterdir()} == before
    assert len(rows_of(file)) == 10  # as SQLite itself says


def split_bag(folder: Path) -> Path:
    """Three files of three messages; the first two are compressed, as a recorder that was killed leaves them."""
    folder.mkdir()
    for number in range(3):
        part = write_twists(folder.parent / f"part{number}", "mcap")
        data = (part / f"part{number}.mcap").read_bytes()
        if number < 2:
            (folder / f"b_{number}.mcap.zstd").write_bytes(zstandard.ZstdCompressor().compress(data))
        else:
            (folder / f"b_{number}.mcap").write_bytes(data)
    return folder


def test_files_that_are_compressed_and_in_no_metadata_are_read(tmp_path: Path) -> None:
    bag = split_bag(tmp_path / "b")
    with Recording(bag) as recording:
        assert recording.topics["/turtle1/cmd_vel"].count == 24
        assert recording.check()
        assert len(list(recording["/turtle1/cmd_vel"].rows())) == 24
    with Recording(bag / "b_0.mcap.zstd") as recording:
        assert recording.topics["/turtle1/cmd_vel"].count == 8
    with Recording(convert(bag, tmp_path / "run")) as recording:
        assert recording.topics["/turtle1/cmd_vel"].count == 24


@pytest.mark.parametrize("has_metadata", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_messages_that_are_compressed_one_by_one_are_unpacked(tmp_path: Path, kind: str, has_metadata: bool) -> None:
    plain = write_twists(tmp_path / "plain", kind)
    bag = tmp_path / "bag"
    shutil.copytree(plain, bag)
    pack_messages(bag / ("plain.db3" if kind == "sqlite3" else "plain.mcap"), kind)
    metadata = bag / "metadata.yaml"
    if has_metadata:
        text = metadata.read_text().replace("compression_format: ''", "compression_format: zstd")
        text = text.replace('compression_format: ""', "compression_format: zstd")
        metadata.write_text(
            text.replace("compression_mode: ''", "compression_mode: MESSAGE").replace(
                'compression_mode: ""', "compression_mode: MESSAGE"
            )
        )
        assert "MESSAGE" in metadata.read_text()
    else:
        metadata.unlink()
    if kind == "mcap" and not has_metadata:
        src = bag  # nothing but the bytes tell
    src = bag
    with Recording(convert(src, tmp_path / "run")) as recording:
        assert [row["linear"]["x"] for row in recording["/turtle1/cmd_vel"].rows()] == list(range(8))
    if has_metadata:
        with Recording(bag) as recording:
            assert len(list(recording["/turtle1/cmd_vel"].rows())) == 8


def pack_messages(file: Path, kind: str) -> None:
    compress = zstandard.ZstdCompressor().compress
    if kind == "sqlite3":
        base = sqlite3.connect(file)
        for number, data in base.execute("SELECT id, data FROM messages").fetchall():
            base.execute("UPDATE messages SET data = ? WHERE id = ?", (compress(data), number))
        base.commit()
        base.close()
        return
    with file.open("rb") as stream:
        found = list(make_reader(stream).iter_messages())
    with file.open("wb") as stream:
        writer = McapWriter(stream, compression=CompressionType.NONE)
        writer.start(profile="ros2", library="test")
        schema = writer.register_schema(found[0][0].name, found[0][0].encoding, found[0][0].data)
        channel = writer.register_channel(found[0][1].topic, "cdr", schema, dict(found[0][1].metadata))
        for _, _, message in found:
            writer.add_message(
                channel, message.log_time, compress(message.data), message.publish_time, message.sequence
            )
        writer.finish()


def test_paths_that_old_metadata_have_are_found(tmp_path: Path) -> None:
    bag = write_twists(tmp_path / "renamed", "sqlite3")
    text = (bag / "metadata.yaml").read_text()
    assert "renamed.db3" in text
    (bag / "metadata.yaml").write_text(
        text.replace("renamed.db3", "rosbag2_test/renamed.db3").replace("version: 9", "version: 2")
    )
    with Recording(bag) as recording:
        assert recording.topics["/turtle1/cmd_vel"].count == 8


# -- one odd part ------------------------------------------------------------------------------------------------------


def test_a_channel_of_json_in_a_bag_stays_json(tmp_path: Path) -> None:
    with (tmp_path / "in.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema(
            "note", "jsonschema", b'{"type": "object", "properties": {"text": {"type": "string"}}}'
        )
        channel = writer.register_channel("/note", "json", schema)
        for number in range(3):
            writer.add_message(channel, 5, json.dumps({"text": f"n{number}"}).encode(), 5)
        writer.finish()
    for options in ({}, {"encoding": "json"}):
        with Recording(convert(tmp_path / "in.mcap", tmp_path / f"run{len(options)}", **options)) as recording:
            assert [row["text"] for row in recording["/note"].rows()] == ["n0", "n1", "n2"]


def test_messages_of_others_that_share_a_time_stay_as_many_in_a_bag(tmp_path: Path) -> None:
    times = [1_700_000_000_000_000_000 + 50 * number for number in range(8)] + [1_700_000_000_000_001_000] * 3
    with (tmp_path / "in.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        schema = writer.register_schema("note", "jsonschema", b'{"type": "object"}')
        channel = writer.register_channel("note", "json", schema)
        for number, time_ns in enumerate(times):
            writer.add_message(channel, time_ns, json.dumps({"n": number}).encode(), time_ns)
        writer.finish()
    for kind, options in (("rosbag2", {}), ("rosbag2", {"storage": "sqlite3"}), ("rosbag1", {})):
        name = f"{kind}-{len(options)}" + (".bag" if kind == "rosbag1" else "")
        with Recording(tmp_path / "in.mcap") as recording:
            recording.export(tmp_path / name, format=kind, **options)
        assert [one.time_ns for one in read(tmp_path / name).messages] == times
        with Recording(convert(tmp_path / name, tmp_path / f"run-{name}")) as recording:
            assert [row["n"] for row in recording["note"].rows()] == list(range(11))
            recording.export(tmp_path / f"again-{name}", format=kind, **options)
        assert [one.time_ns for one in read(tmp_path / f"again-{name}").messages] == times


def test_a_bag_of_ours_can_be_kept_as_messages(tmp_path: Path) -> None:
    from tests.support.bags import export, record, robot_rows

    bag = export(record(tmp_path / "run", {"robot": robot_rows(3)}), tmp_path / "bag")
    with Recording(convert(bag, tmp_path / "kept", encoding="ros")) as recording:
        assert "/robot/joint_states" in recording.topics
        recording.export(tmp_path / "back", format="rosbag2")
    assert read(tmp_path / "back") == read(bag)
    with pytest.raises(OptionError, match="encoding='rows'"):
        convert(bag, tmp_path / "no", encoding="rows")


def test_the_rest_of_a_bag_that_was_cut_is_there_where_wanted(tmp_path: Path) -> None:
    with Ros1Writer(tmp_path / "in.bag") as writer:
        writer.chunk_threshold = 2000
        connection = writer.add_connection("/t", "geometry_msgs/msg/Vector3", typestore=NOETIC)
        for number in range(200):
            writer.write(connection, 10**9 + number, np.array([number, 0, 0], "<f8").tobytes())
    data = (tmp_path / "in.bag").read_bytes()
    (tmp_path / "cut.bag").write_bytes(data[: len(data) // 2])
    with pytest.raises(DamagedFileError, match=r"cut\.bag"):
        Recording(tmp_path / "cut.bag")
    with (
        pytest.warns(ConversionWarning, match=r"cut\.bag"),
        Recording(tmp_path / "cut.bag", on_damage="skip") as recording,
    ):
        rows = [row["x"] for row in recording["/t"].rows()]
    assert 20 < len(rows) < 200 and rows == list(range(len(rows)))
    with pytest.warns(ConversionWarning, match=r"cut\.bag"):
        convert(tmp_path / "cut.bag", tmp_path / "run", on_damage="skip")
    with Recording(tmp_path / "run") as recording:
        assert recording.topics["/t"].count == len(rows)


@pytest.mark.parametrize("is_chunked", [True, False])
@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD])
def test_all_that_an_mcap_file_has_is_carried(tmp_path: Path, compression: CompressionType, is_chunked: bool) -> None:
    with (tmp_path / "in.mcap").open("wb") as stream:
        writer = McapWriter(stream, compression=compression, use_chunking=is_chunked, chunk_size=2000)
        writer.start(profile="ros2", library="another recorder")
        schema = writer.register_schema("std_msgs/msg/UInt8", "ros2msg", b"uint8 data # of nothing")
        metadata = {"offered_qos_profiles": "", "topic_type_hash": "RIHS01_1", "more": "of it"}
        channels = [
            writer.register_channel("/a", "cdr", schema, metadata),
            writer.register_channel("/b", "cdr", schema),
        ]
        for number in range(1000):
            time_ns = 5000 - number if number % 7 == 0 else 5000 + number
            payload = bytes([0, 1, 0, 0, number % 256])
            writer.add_message(channels[number % 3 == 0], time_ns, payload, 9000 + number, 3 * number)
        writer.add_attachment(1, 2, "cal.json", "application/json", b"{}")
        writer.add_metadata("mine", {"a": "b"})
        writer.finish()
    with Recording(convert(tmp_path / "in.mcap", tmp_path / "run")) as recording:
        assert recording.attachments["cal.json"].read() == b"{}"
        assert ("mine", {"a": "b"}) in recording.metadata
        (copy,) = recording.segments
        recording.export(tmp_path / "bag", format="rosbag2")
    for path in (copy, tmp_path / "bag/bag_0.mcap"):
        assert whole_records(path) == whole_records(tmp_path / "in.mcap")


def whole_records(path: Path) -> list[Any]:
    with path.open("rb") as stream:
        found = make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False)
        return [
            (channel.topic, channel.metadata.get("more"), schema and schema.data, *vars(message).values())
            for schema, channel, message in ((one, two, without_channel(three)) for one, two, three in found)
        ]


def without_channel(message: Any) -> Any:
    message.channel_id = 0  # the number of a channel is its file's own
    return message


@pytest.mark.parametrize("name", ["rosbag1/a-turtlesim-none.bag", "rosbag2/a-foxy-split5-sqlite3"])
def test_rows_are_the_same_whether_they_are_made_by_the_conversion_or_when_asked_for(tmp_path: Path, name: str) -> None:
    src = shared.file(name)
    convert(src, tmp_path / "kept")
    convert(src, tmp_path / "rows", encoding="json")
    with Recording(tmp_path / "kept") as kept, Recording(tmp_path / "rows") as rows:
        assert {rows.topics[topic].encoding for topic in rows.topics} == {"json"}
        assert sorted(kept.topics) == sorted(rows.topics)
        for topic in kept.topics:
            assert list(kept[topic].rows()) == list(rows[topic].rows())


def test_definitions_that_are_given_are_in_the_recording(tmp_path: Path) -> None:
    src = shared.file("rosbag2/a-humble-turtlesim-sqlite3")
    text = "float32 x\nfloat32 y\nfloat32 theta\nfloat32 linear_velocity\nfloat32 angular_velocity\n"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        convert(src, tmp_path / "run", definitions={"turtlesim/msg/Pose": text})
        with Recording(tmp_path / "run") as recording:
            assert recording["/turtle1/pose"].to_numpy()["x"].shape == (2245,)
        with Recording(src, definitions={"turtlesim/Pose": text}) as recording:
            assert "theta" in recording.topics["/turtle1/pose"].fields
    with pytest.warns(ConversionWarning, match="turtlesim"), Recording(src, on_unknown="skip") as recording:
        assert list(recording.topics) == ["/turtle1/cmd_vel"]


def test_a_definition_that_is_given_for_a_part_of_a_type_goes_into_the_recording(tmp_path: Path) -> None:
    with (tmp_path / "in.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema("a_msgs/msg/Outer", "ros2msg", b"a_msgs/Inner inner")
        channel = writer.register_channel("/n", "cdr", schema)
        writer.add_message(channel, 1, b"\0\1\0\0\7", 1)
        writer.finish()
    convert(tmp_path / "in.mcap", tmp_path / "run", definitions={"a_msgs/msg/Inner": "uint8 n\n"})
    with Recording(tmp_path / "run") as recording:
        assert [row["inner"] for row in recording["/n"].rows()] == [{"n": 7}]


# -- what a hunt found -------------------------------------------------------------------------------------------------


def write_numbers(path: Path, values: list[int], *, first_ns: int = 1, qos: str = "", **beside: str) -> None:
    """An MCAP file of bytes, one a nanosecond."""
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/UInt8", "ros2msg", b"uint8 data")
        channel = writer.register_channel("/n", "cdr", schema, {"offered_qos_profiles": qos} if qos else {})
        for number, value in enumerate(values):
            writer.add_message(channel, first_ns + number, bytes([0, 1, 0, 0, value]), first_ns + number)
        if beside:
            writer.add_attachment(1, 2, "calib.yaml", "text/yaml", b"k: 1")
            writer.add_metadata("mine", beside)
        writer.finish()


def test_files_come_out_in_the_order_of_recording_however_many_they_are(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    for number in range(12):
        write_numbers(tmp_path / f"bag/bag_{number}.mcap", [number])  # all at one time: only the order of files tells
    with Recording(tmp_path / "bag") as bag, Recording(convert(tmp_path / "bag", tmp_path / "run")) as run:
        for number, recording in enumerate((bag, run)):
            assert [row["data"] for row in recording["/n"].rows()] == list(range(12))
            recording.export(tmp_path / f"out{number}", format="rosbag2", storage="sqlite3")
            assert [one.data[4] for one in rows_of(tmp_path / f"out{number}/out{number}_0.db3")] == list(range(12))
    text = "rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths: [z.mcap, a.mcap]\n"
    (tmp_path / "named").mkdir()
    (tmp_path / "named/metadata.yaml").write_text(text)
    write_numbers(tmp_path / "named/z.mcap", [1])
    write_numbers(tmp_path / "named/a.mcap", [2])
    with Recording(tmp_path / "named") as bag, Recording(convert(tmp_path / "named", tmp_path / "run2")) as run:
        assert [[row["data"] for row in one["/n"].rows()] for one in (bag, run)] == [[1, 2], [1, 2]]


@pytest.mark.parametrize("is_chunked", [True, False])
def test_a_type_that_is_completed_takes_no_other_types_place(tmp_path: Path, is_chunked: bool) -> None:
    with (tmp_path / "in.mcap").open("wb") as stream:
        writer = McapWriter(stream, use_chunking=is_chunked)
        writer.start(profile="ros2")
        point = writer.register_schema("geometry_msgs/msg/Point", "ros2msg", b"float64 x\nfloat64 y\nfloat64 z")
        text = writer.register_schema("std_msgs/msg/String", "", b"")
        channels = [writer.register_channel("/s", "cdr", text), writer.register_channel("/p", "cdr", point)]
        writer.add_message(channels[0], 5, b"\0\1\0\0\6\0\0\0hello\0", 5)
        writer.add_message(channels[1], 6, b"\0\1\0\0" + np.array([1.0, 2.0, 3.0]).tobytes(), 6)
        writer.finish()
    with Recording(convert(tmp_path / "in.mcap", tmp_path / "run")) as recording:
        assert [row["data"] for row in recording["/s"].rows()] == ["hello"]
        assert [row["z"] for row in recording["/p"].rows()] == [3.0]
        (file,) = recording.segments
    with file.open("rb") as stream:
        streamed = [
            (channel.topic, schema.name, bool(schema.data))
            for schema, channel, _ in NonSeekingReader(stream).iter_messages()
        ]
    assert streamed == [("/s", "std_msgs/msg/String", True), ("/p", "geometry_msgs/msg/Point", True)]


def test_what_else_a_bag_has_goes_out_again_or_is_named(tmp_path: Path) -> None:
    write_numbers(tmp_path / "in.mcap", [1], owner="ann")
    convert(tmp_path / "in.mcap", tmp_path / "run")
    for src in (tmp_path / "in.mcap", tmp_path / "run"):
        with Recording(src) as recording:
            recording.export(tmp_path / f"{src.stem}-out", format="rosbag2")
            with pytest.warns(ConversionWarning, match=r"SQLite.*'calib\.yaml', 'mine'"):
                recording.export(tmp_path / f"{src.stem}-sqlite", format="rosbag2", storage="sqlite3")
        with Recording(tmp_path / f"{src.stem}-out") as recording:
            assert recording.attachments["calib.yaml"].read() == b"k: 1"
            assert ("mine", {"owner": "ann"}) in recording.metadata


def test_profiles_of_two_files_are_both_said(tmp_path: Path) -> None:
    profile = "- history: keep_last\n  depth: {}\n  reliability: reliable\n  durability: {}\n  deadline: {{sec: 0, nsec: 0}}\n"
    profile += (
        "  lifespan: {{sec: 0, nsec: 0}}\n  liveliness: automatic\n  liveliness_lease_duration: {{sec: 0, nsec: 0}}\n"
    )
    profile += "  avoid_ros_namespace_conventions: false\n"
    (tmp_path / "bag").mkdir()
    for number, how in enumerate(((9, "volatile"), (1, "transient_local"))):
        write_numbers(tmp_path / f"bag/b_{number}.mcap", [number], qos=profile.format(*how))
    with Recording(tmp_path / "bag") as recording:
        recording.export(tmp_path / "out", format="rosbag2")
    with Ros2Reader(tmp_path / "out") as reader:
        (connection,) = reader.connections
    assert [one.depth for one in connection.ext.offered_qos_profiles] == [9, 1]


def test_what_only_metadata_say_of_a_bag_goes_out_however_it_was_opened(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    write_numbers(tmp_path / "bag/b_0.mcap", [1])
    (tmp_path / "bag/metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  version: 8\n  relative_file_paths: [b_0.mcap]\n  ros_distro: iron\n"
        "  custom_data: {robot: r2d2}\n  topics_with_message_count:\n    - message_count: 1\n      topic_metadata:\n"
        "        {name: /n, type: std_msgs/msg/UInt8, type_description_hash: RIHS01_abc,\n"
        "         offered_qos_profiles: '- history: 1'}\n"
    )
    convert(tmp_path / "bag", tmp_path / "run")
    for src in ("bag", "run"):
        with Recording(tmp_path / src) as recording:
            recording.export(tmp_path / f"{src}-out", format="rosbag2")
        said = YAML(typ="safe").load(tmp_path / f"{src}-out/metadata.yaml")["rosbag2_bagfile_information"]
        topic = said["topics_with_message_count"][0]["topic_metadata"]
        assert (said["version"], said["ros_distro"], said["custom_data"]) == (8, "iron", {"robot": "r2d2"})
        assert (topic["type_description_hash"], topic["offered_qos_profiles"]) == ("RIHS01_abc", "- history: 1")


def test_a_bag_without_topics_keeps_what_is_said_of_it(tmp_path: Path) -> None:
    writer = Ros2Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_custom_data("robot", "r2d2")
    with writer:
        pass
    with Recording(convert(tmp_path / "bag", tmp_path / "run")) as recording:
        assert list(recording.topics) == []
        assert "r2d2" in dict(recording.metadata)["ml_dash.bag"]["metadata.yaml"]
