"""Bags with odd parts go out whole, or the error names what the other format cannot say."""

from __future__ import annotations

import bz2
import sqlite3
import struct
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

from ml_dash_mcap import Recording, convert
from ml_dash_mcap.errors import ConversionError, ConversionWarning, DamagedFileError
from tests.support import system_python

NOETIC = get_typestore(Stores.ROS1_NOETIC)
JAZZY = get_typestore(Stores.ROS2_JAZZY)
STRING_MD5 = "992ce8a1687cec8c8bd883ec73ca41d1"
WHEELS = ("int32 left\nint32 right\n", "int32 right\nint32 left\n")


def mcap(
    path: Path,
    channels: Sequence[tuple[str, str, str, bytes]],
    metadata: Mapping[str, str] | None = None,
    time_ns: int = 5,
) -> Path:
    """Write a file of rosbag2: topics, their types, definitions, and a message of each."""
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start("ros2", "a test")
        for topic, name, text, payload in channels:
            schema = writer.register_schema(name, "ros2msg", text.encode())
            channel = writer.register_channel(topic, "cdr", schema, dict(metadata or {}))
            writer.add_message(channel, time_ns, payload, time_ns, 1)
        writer.finish()
    return path


def ros1(bag: Path, program: str = "read_bag.py") -> Any:
    needs = ("rosbag", "roslz4", "sensor_msgs.msg")
    return system_python.run(program, bag, needs=needs, package="python3-rosbag")


def string(text: str) -> bytes:
    return bytes(JAZZY.serialize_cdr(JAZZY.types["std_msgs/msg/String"](text), "std_msgs/msg/String"))


# -- SQLite ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("topics", [("/w", "/w"), ("/a", "/b")])
def test_sqlite_refuses_two_definitions_of_a_type_and_mcap_keeps_both(tmp_path: Path, topics: tuple[str, str]) -> None:
    with Ros1Writer(tmp_path / "in.bag") as writer:
        for number, (topic, text) in enumerate(zip(topics, WHEELS, strict=True)):
            connection = writer.add_connection(topic, "p/msg/W", msgdef=text, md5sum=str(number) * 32)
            writer.write(connection, 5 + number, b"\1\0\0\0\2\0\0\0")
    with pytest.raises(ConversionError, match=r"'p/msg/W'.*storage='mcap'") as caught:
        convert(tmp_path / "in.bag", tmp_path / "db", format="rosbag2", storage="sqlite3")
    assert all(repr(topic) in str(caught.value) for topic in topics)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in.bag"]
    convert(tmp_path / "in.bag", tmp_path / "mcap", format="rosbag2")
    with Recording(tmp_path / "mcap") as recording:
        found = {(row["left"], row["right"]) for topic in recording for row in recording[topic].rows()}
    assert found == {(1, 2), (2, 1)}


def test_sqlite_takes_definitions_that_differ_in_comments(tmp_path: Path) -> None:
    texts = ("int32 a\n", "# What it is.\nint32   a # here\n\n")
    channels = [(f"/t{number}", "p/msg/A", text, b"\0\1\0\0\7\0\0\0") for number, text in enumerate(texts)]
    convert(mcap(tmp_path / "in.mcap", channels), tmp_path / "db", format="rosbag2", storage="sqlite3")
    base = sqlite3.connect(tmp_path / "db/db_0.db3")
    assert base.execute("SELECT count(*) FROM messages").fetchone() == (2,)
    base.close()


# -- metadata.yaml -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("distro", ["humble", "jazzy"])
def test_odd_values_in_a_qos_profile_come_out_as_they_came(tmp_path: Path, distro: str) -> None:
    qos = "- {history: 1, depth: 2021-01-01, 5: x, a: .nan, b: [[1, 2], {}], c: !!binary aGk=, true: 1, 'no': -.inf}\n- {}"
    mcap(
        tmp_path / "in.mcap",
        [("/s", "std_msgs/msg/String", "string data\n", string("a"))],
        {"offered_qos_profiles": qos},
    )
    convert(tmp_path / "in.mcap", tmp_path / "out", format="rosbag2", distro=distro)
    yaml = YAML(typ="safe", pure=True)
    (topic,) = yaml.load((tmp_path / "out/metadata.yaml").read_text())["rosbag2_bagfile_information"][
        "topics_with_message_count"
    ]
    found = topic["topic_metadata"]["offered_qos_profiles"]
    found = yaml.load(found) if distro == "humble" else found
    said = yaml.load(qos)
    if distro == "jazzy":
        said[0]["history"] = "keep_last"
    assert repr(found) == repr(said)  # NaN is not equal to itself


def test_custom_data_of_any_keys_and_values_comes_out_as_it_came(tmp_path: Path) -> None:
    custom = "{a: 1, 2: [3, [4, {b: 2021-01-01}]], c: true, 'true': 'x', 1.5: {}, '5': []}"
    (tmp_path / "in").mkdir()
    mcap(tmp_path / "in/in_0.mcap", [("/s", "std_msgs/msg/String", "string data\n", string("a"))])
    head = "rosbag2_bagfile_information:\n  version: 9\n  relative_file_paths: [in_0.mcap]\n"
    (tmp_path / "in/metadata.yaml").write_text(f"{head}  custom_data: {custom}\n")
    convert(tmp_path / "in", tmp_path / "run")
    with Recording(tmp_path / "run") as recording:
        recording.export(tmp_path / "out", format="rosbag2")
    yaml = YAML(typ="safe", pure=True)
    found = yaml.load((tmp_path / "out/metadata.yaml").read_text())["rosbag2_bagfile_information"]["custom_data"]
    assert found == yaml.load(custom)


# -- ROS 1 -------------------------------------------------------------------------------------------------------------


def test_a_time_that_ros_1_has_no_room_for_names_its_topic(tmp_path: Path) -> None:
    channels = [("/late", "std_msgs/msg/String", "string data\n", string("a"))]
    mcap(tmp_path / "in.mcap", channels, time_ns=2**32 * 10**9)
    with pytest.raises(ConversionError, match=r"'/late'.*4294967296\.0 s"):
        convert(tmp_path / "in.mcap", tmp_path / "out.bag", format="rosbag1")
    assert not (tmp_path / "out.bag").exists()
    mcap(tmp_path / "last.mcap", channels, time_ns=2**32 * 10**9 - 1)
    convert(tmp_path / "last.mcap", tmp_path / "last.bag", format="rosbag1")
    with Ros1Reader(tmp_path / "last.bag") as reader:
        assert [time for _, time, _ in reader.messages()] == [2**32 * 10**9 - 1]


# -- From one generation of ROS to the other ---------------------------------------------------------------------------


def test_bounds_defaults_and_constants_are_said_as_ros_1_reads_them(tmp_path: Path) -> None:
    text = (
        'string<=3 s\nint32[<=2] v\nstring<=4[<=2] t\np/B[<=1] b\nint32 X=0x10\nbool YES=true\nstring S="a b"\n'
        "int32 d 7\n" + "=" * 80 + "\nMSG: p/B\nint16[<=2] w [1, 2]\n"
    )
    payload = bytes.fromhex(
        "00010000" "03000000" "6162" "0000" "01000000" "09000000" "01000000" "02000000" "6300" "0000"
        "01000000" "01000000" "0500" "0000" "07000000"
    )  # fmt: skip
    mcap(tmp_path / "in.mcap", [("/c", "p/msg/C", text, payload)])
    with warnings.catch_warnings():
        warnings.simplefilter("error", ConversionWarning)
        convert(tmp_path / "in.mcap", tmp_path / "out.bag", format="rosbag1")
    found = ros1(tmp_path / "out.bag")["topics"]["/c"]
    assert (found["type"], found["read"], found["valid"]) == ("p/C", 1, True)
    assert found["first"] == {"s": "ab", "v": [9], "t": ["c"], "b": [{"w": [5]}], "d": 7}
    with Ros1Reader(tmp_path / "out.bag") as reader:
        (connection,) = reader.connections
        lines = connection.msgdef.data.splitlines()
    assert {"string s", "int32[] v", "string[] t", "p/B[] b", "int32 X=16", "bool YES=True", "string S=a b"} < set(
        lines
    )


def test_a_message_and_parts_of_a_service_and_an_action_keep_names_of_their_own_in_ros_1(tmp_path: Path) -> None:
    nested = "p/srv/Foo_Request[<=1] request\n" + "=" * 80 + "\nMSG: p/srv/Foo_Request\nint32 a\n"
    seven = b"\0\1\0\0\7\0\0\0"
    channels = [
        ("/service", "p/srv/Foo_Request", "int32 a\n", seven),
        ("/message", "p/msg/Foo_Request", "int32 b\n", seven),
        ("/action", "p/action/Foo_Request", "int32 c\n", seven),
        ("/event", "p/srv/Foo_Event", nested, b"\0\1\0\0\1\0\0\0\7\0\0\0"),
    ]
    convert(mcap(tmp_path / "in.mcap", channels), tmp_path / "out.bag", format="rosbag1")
    found = ros1(tmp_path / "out.bag")["topics"]
    assert {topic: (one["type"], one["first"], one["valid"]) for topic, one in found.items()} == {
        "/service": ("p/srv_Foo_Request", {"a": 7}, True),
        "/message": ("p/Foo_Request", {"b": 7}, True),
        "/action": ("p/action_Foo_Request", {"c": 7}, True),
        "/event": ("p/srv_Foo_Event", {"request": [{"a": 7}]}, True),
    }


@pytest.mark.parametrize("sizes", [(3, 3), (3, 4, 5)])
def test_elements_are_only_said_to_be_cut_off_where_they_are(tmp_path: Path, sizes: tuple[int, ...]) -> None:
    name = "shape_msgs/msg/SolidPrimitive"
    with Ros1Writer(tmp_path / "in.bag") as writer:
        connection = writer.add_connection("/s", name, typestore=NOETIC)
        for time, size in enumerate(sizes, start=1):
            message = NOETIC.types[name](1, np.arange(float(size)))
            writer.write(connection, time, NOETIC.serialize_ros1(message, name))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        convert(tmp_path / "in.bag", tmp_path / "out", format="rosbag2")
    about = [str(one.message) for one in caught if "dimensions" in str(one.message)]
    assert len(about) == (max(sizes) > 3)
    assert all("has 4 elements, and ROS 2 has room for 3: the last 1" in one for one in about)
    with Ros2Reader(tmp_path / "out") as reader:
        found = [JAZZY.deserialize_cdr(data, name).dimensions.tolist() for _, _, data in reader.messages()]
    assert found == [[0.0, 1.0, 2.0]] * len(sizes)


# -- ROS 1 bags with odd parts, in and out -----------------------------------------------------------------------------

STRING = {"type": b"std_msgs/String", "md5sum": STRING_MD5.encode(), "message_definition": b"string data\n"}


def u32(*values: int) -> bytes:
    return struct.pack(f"<{len(values)}I", *values)


def fields(said: Mapping[str, bytes]) -> bytes:
    whole = [name.encode() + b"=" + value for name, value in said.items()]
    return b"".join(u32(len(one)) + one for one in whole)


def record(op: int, data: bytes, **said: bytes) -> bytes:
    head = fields({"op": bytes([op]), **said})
    return u32(len(head)) + head + u32(len(data)) + data


def connection(number: int, topic: bytes, **said: bytes) -> bytes:
    return record(7, fields({"topic": topic, **STRING, **said}), conn=u32(number), topic=topic)


def chunk(
    connections: Mapping[int, bytes],
    messages: Sequence[tuple[int, str]],
    *,
    compression: str = "none",
    harm: bool = False,
    counted: int = 0,
) -> tuple[bytes, list[tuple[int, int]]]:
    """Return a chunk with its indexes, and how many messages it has of which connections.

    Args:
        connections: To introduce.
        messages: Connections and texts.
        compression: "none" or "bz2".
        harm: Whether its content is broken.
        counted: What its indexes say too much.
    """
    content, places = b"".join(connections.values()), dict[int, list[tuple[int, int]]]()
    for time, (number, text) in enumerate(messages):
        places.setdefault(number, []).append((time, len(content)))
        content += record(2, u32(len(text)) + text.encode(), conn=u32(number), time=u32(1, time))
    packed = bz2.compress(content) if compression == "bz2" else content
    if harm:
        packed = b"\xff" * 30 + packed[30:]
    out = record(5, packed, compression=compression.encode(), size=u32(len(content)))
    for number, those in places.items():
        entries = b"".join(u32(1, time, place) for time, place in those)
        out += record(4, entries, ver=u32(1), conn=u32(number), count=u32(len(those) + counted))
    return out, [(number, len(those)) for number, those in places.items()]


def bag(
    path: Path,
    connections: Mapping[int, bytes],
    chunks: Sequence[tuple[bytes, list[tuple[int, int]]]],
    *,
    has_index: bool = True,
    counted: int = 0,
) -> Path:
    """Write a bag; `counted` is what its index of chunks says too much of their connections."""
    out, infos = b"", b""
    for data, pairs in chunks:
        at = {"chunk_pos": struct.pack("<Q", 4109 + len(out)), "start_time": u32(1, 0), "end_time": u32(1, 9)}
        counts = b"".join(u32(*pair) for pair in pairs)
        infos += record(6, counts, ver=u32(1), count=u32(len(pairs) + counted), **at)
        out += data
    about = {"conn_count": u32(len(connections)), "chunk_count": u32(len(chunks))} if has_index else None
    place = struct.pack("<Q", 4109 + len(out) if has_index else 0)
    head = fields({"op": b"\3", "index_pos": place, **(about or {"conn_count": u32(0), "chunk_count": u32(0)})})
    padding = 4096 - 8 - len(head)
    start = b"#ROSBAG V2.0\n" + u32(len(head)) + head + u32(padding) + b" " * padding
    path.write_bytes(start + out + (b"".join(connections.values()) + infos if has_index else b""))
    return path


def texts(recording: Path) -> dict[str, list[str]]:
    with Recording(recording) as opened:
        return {topic: [row["data"] for row in opened[topic].rows()] for topic in opened}


def back(recording: Path, dest: Path) -> Path:
    with Recording(recording) as opened:
        opened.export(dest, format="rosbag1")
    return dest


def test_all_fields_of_a_connections_header_come_back(tmp_path: Path) -> None:
    said = {"callerid": b"/n", "latching": b"1", "tcp_nodelay": b"1", "x": b"", "\u00fc": b"a=b"}
    connections = {0: connection(0, b"/s", **said)}
    bag(tmp_path / "in.bag", connections, [chunk(connections, [(0, "a")])])
    convert(tmp_path / "in.bag", tmp_path / "run")
    there, here = (
        ros1(path, "read_raw_bag.py") for path in (tmp_path / "in.bag", back(tmp_path / "run", tmp_path / "out.bag"))
    )
    assert here == there
    assert {"tcp_nodelay", "x", "\u00fc"} < {name for name, _ in here["connections"][0]}


@pytest.mark.parametrize("on_damage", ["raise", "skip"])
def test_what_is_no_utf_8_in_a_connection_costs_nothing_and_is_said(tmp_path: Path, on_damage: str) -> None:
    connections = {0: connection(0, b"/s", callerid=b"/n\xff"), 1: connection(1, b"/\xfe"), 2: connection(2, b"/t")}
    bag(tmp_path / "in.bag", connections, [chunk(connections, [(0, "a"), (1, "b"), (2, "c")])])
    with pytest.warns(ConversionWarning) as caught:
        convert(tmp_path / "in.bag", tmp_path / "run", on_damage=on_damage)
    said = [str(one.message) for one in caught]
    assert len(said) == 2
    assert "'callerid'" in said[0] and "'topic'" in said[1] and all("U+FFFD" in one for one in said)
    assert texts(tmp_path / "run") == {"/s": ["a"], "/\ufffd": ["b"], "/t": ["c"]}
    back(tmp_path / "run", tmp_path / "out.bag")
    with Ros1Reader(tmp_path / "out.bag") as reader:
        assert [bytes(data)[4:] for _, _, data in reader.messages()] == [b"a", b"b", b"c"]


def test_a_connection_that_cannot_be_read_costs_its_own_messages(tmp_path: Path) -> None:
    broken = record(7, u32(99) + b"topic=/b", conn=u32(1), topic=b"/b")
    connections = {0: connection(0, b"/s"), 1: broken}
    bag(tmp_path / "in.bag", connections, [chunk(connections, [(0, "a"), (1, "b"), (0, "c")])])
    with pytest.raises(DamagedFileError, match="header is broken"):
        convert(tmp_path / "in.bag", tmp_path / "no")
    with pytest.warns(ConversionWarning, match="connection 1 cannot be read"):
        convert(tmp_path / "in.bag", tmp_path / "run", on_damage="skip")
    assert texts(tmp_path / "run") == {"/s": ["a", "c"]}


@pytest.mark.parametrize("compression", ["none", "bz2"])
def test_a_bad_chunk_of_a_bag_without_an_index_costs_no_other(tmp_path: Path, compression: str) -> None:
    connections = {0: connection(0, b"/s")}
    parts = [
        chunk(connections if number == 0 else {}, [(0, f"m{number}")], compression=compression, harm=number == 1)
        for number in range(3)
    ]
    bag(tmp_path / "in.bag", connections, parts, has_index=False)
    with pytest.warns(ConversionWarning) as caught:
        convert(tmp_path / "in.bag", tmp_path / "run", on_damage="skip")
    assert sum(f"byte {4109 + len(parts[0][0])}:" in str(one.message) for one in caught) == 1
    assert texts(tmp_path / "run") == {"/s": ["m0", "m2"]}


@pytest.mark.parametrize("where", ["chunks", "messages"])
@pytest.mark.parametrize("counted", [-1, 1])
def test_an_index_that_contradicts_itself_costs_no_message(tmp_path: Path, where: str, counted: int) -> None:
    connections = {0: connection(0, b"/s"), 1: connection(1, b"/t")}
    part = chunk(connections, [(0, "a"), (1, "b"), (0, "c")], counted=counted if where == "messages" else 0)
    bag(tmp_path / "in.bag", connections, [part], counted=counted if where == "chunks" else 0)
    with pytest.raises(DamagedFileError, match=r"contradicts itself|do not agree"):
        convert(tmp_path / "in.bag", tmp_path / "no")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConversionWarning)
        convert(tmp_path / "in.bag", tmp_path / "run", on_damage="skip")
    assert texts(tmp_path / "run") == {"/s": ["a", "c"], "/t": ["b"]}


@pytest.mark.parametrize("pairs", [[(0, 2)], [(0, 1), (1, 1)], [(0, 2), (7, 1)]])
def test_an_index_of_chunks_that_their_own_indexes_contradict_costs_no_message(
    tmp_path: Path, pairs: list[tuple[int, int]]
) -> None:
    connections = {0: connection(0, b"/s"), 1: connection(1, b"/t")}
    data, _ = chunk(connections, [(0, "a"), (1, "b"), (0, "c")])
    bag(tmp_path / "in.bag", connections, [(data, pairs)])
    with pytest.raises(DamagedFileError):
        convert(tmp_path / "in.bag", tmp_path / "no")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConversionWarning)
        convert(tmp_path / "in.bag", tmp_path / "run", on_damage="skip")
    assert texts(tmp_path / "run") == {"/s": ["a", "c"], "/t": ["b"]}


def test_connections_may_have_any_numbers(tmp_path: Path) -> None:
    connections = {0: connection(0, b"/s"), 4_000_000_000: connection(4_000_000_000, b"/big")}
    bag(tmp_path / "in.bag", connections, [chunk(connections, [(0, "a"), (4_000_000_000, "b")])])
    convert(tmp_path / "in.bag", tmp_path / "run")
    assert texts(tmp_path / "run") == {"/s": ["a"], "/big": ["b"]}
    messages = [
        ros1(path, "read_raw_bag.py")["messages"]
        for path in (tmp_path / "in.bag", back(tmp_path / "run", tmp_path / "out.bag"))
    ]
    assert messages[0] == messages[1]
