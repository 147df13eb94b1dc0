"""The straightforward loops that the ROS benchmark measures beside: what a user of rosbags would write."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

OWN_TYPE = "bench_msgs/msg/Robot"
OWN_TEXT = """\
std_msgs/Header header
float64 ts
float64[7] q
float64[7] qd
float64[7] tau
float64[3] ee_pos
float64[4] ee_quat
float64 gripper
"""
JOINTS, POSE = "sensor_msgs/msg/JointState", "geometry_msgs/msg/PoseStamped"
NAMES = [f"joint{number}" for number in range(1, 8)]
NS = 1_000_000_000


def typestore() -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(OWN_TEXT, OWN_TYPE))
    return store


def to_bag(source: Path, dest: Path) -> int:
    """Read with mcap and json, fill the same four messages a row, serialise and write with rosbags."""
    import numpy as np
    from mcap.reader import make_reader
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    store = typestore()
    types = store.types
    joint_state, pose_stamped, own = types[JOINTS], types[POSE], types[OWN_TYPE]
    header_type, time_type, pose_type = (
        types[name] for name in ("std_msgs/msg/Header", "builtin_interfaces/msg/Time", "geometry_msgs/msg/Pose")
    )
    point, quaternion = types["geometry_msgs/msg/Point"], types["geometry_msgs/msg/Quaternion"]
    nothing = np.zeros(0)
    writer = Writer(dest, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    count = 0
    with writer:
        robot, joints, gripper, pose = (
            writer.add_connection(topic, type_, typestore=store)
            for topic, type_ in (
                ("/robot", OWN_TYPE),
                ("/robot/joint_states", JOINTS),
                ("/robot/gripper", JOINTS),
                ("/robot/ee_pose", POSE),
            )
        )
        for path in sorted(source.glob("*.mcap")):
            with path.open("rb") as file:
                for _, _, message in make_reader(file).iter_messages(topics=["robot"]):
                    row = json.loads(message.data)
                    time_ns = message.log_time
                    header = header_type(time_type(time_ns // NS, time_ns % NS), "")
                    q, qd, tau = np.array(row["q"]), np.array(row["qd"]), np.array(row["tau"])
                    ee_pos, ee_quat = row["ee_pos"], row["ee_quat"]
                    said = (
                        (
                            robot,
                            own(header, row["_ts"], q, qd, tau, np.array(ee_pos), np.array(ee_quat), row["gripper"]),
                        ),
                        (joints, joint_state(header, NAMES, q, qd, tau)),
                        (gripper, joint_state(header, ["gripper"], np.array([row["gripper"]]), nothing, nothing)),
                        (pose, pose_stamped(header, pose_type(point(*ee_pos), quaternion(*ee_quat)))),
                    )
                    for connection, filled in said:
                        writer.write(connection, time_ns, store.serialize_cdr(filled, connection.msgtype))
                    count += 1
    return count


def from_bag(bag: Path, dest: Path) -> int:
    """Read and deserialise with rosbags, make dicts, encode with json and write with mcap."""
    from mcap.writer import Writer
    from rosbags.highlevel import AnyReader

    fields = ("q", "qd", "tau", "ee_pos", "ee_quat")
    count = 0
    with dest.open("wb") as file, AnyReader([bag]) as reader:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("robot", "jsonschema", b'{"type": "object"}')
        channel = writer.register_channel("robot", "json", schema)
        wanted = [connection for connection in reader.connections if connection.topic == "/robot"]
        for connection, time_ns, data in reader.messages(connections=wanted):
            message: Any = reader.deserialize(data, connection.msgtype)
            row = {name: getattr(message, name).tolist() for name in fields}
            row.update(gripper=message.gripper, _ts=message.ts)
            writer.add_message(channel, time_ns, json.dumps(row).encode(), time_ns)
            count += 1
        writer.finish()
    return count


JOINTS_TOPIC = "/joint_states"


def write_bags(folder: Path, count: int) -> None:
    """Write the same joint states with rosbags as three bags: rosbag2 in MCAP (zstd) and in SQLite, and ROS 1."""
    import numpy as np
    from rosbags.rosbag1 import Writer as Ros1Writer
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    newer, older = get_typestore(Stores.ROS2_JAZZY), get_typestore(Stores.ROS1_NOETIC)
    mcap = Writer(folder / "mcap", version=9, storage_plugin=StoragePlugin.MCAP)
    mcap.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    sqlite = Writer(folder / "sqlite3", version=9, storage_plugin=StoragePlugin.SQLITE3)
    rng = np.random.default_rng(7)
    with mcap, sqlite, Ros1Writer(folder / "ros1.bag") as ros1:
        outlets = [(one, one.add_connection(JOINTS_TOPIC, JOINTS, typestore=newer)) for one in (mcap, sqlite)]
        connection = ros1.add_connection(JOINTS_TOPIC, JOINTS, typestore=older)
        for number in range(count):
            angle = np.sin(number / 1000 + np.arange(7)) + rng.normal(scale=1e-4, size=7)
            time_ns = 1_700_000_000 * NS + number * 1_000_000
            for store, head in ((newer, ()), (older, (number,))):
                types = store.types
                stamp = types["builtin_interfaces/msg/Time"](time_ns // NS, time_ns % NS)
                header = types["std_msgs/msg/Header"](*head, stamp, "base")
                message = types[JOINTS](header, NAMES, angle, 2 * angle, 3 * angle)
                if store is older:
                    ros1.write(connection, time_ns, older.serialize_ros1(message, JOINTS))
                    continue
                data = newer.serialize_cdr(message, JOINTS)
                for writer, topic in outlets:
                    writer.write(topic, time_ns, data)


def decode_and_encode(bag: Path, dest: Path) -> int:
    """Read each message with rosbags, decode it, encode it again and write it to a rosbag2 in MCAP."""
    from rosbags.highlevel import AnyReader
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    header = store.types["std_msgs/msg/Header"]
    count = 0
    writer = Writer(dest, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with AnyReader([bag]) as reader, writer:
        connection = writer.add_connection(JOINTS_TOPIC, JOINTS, typestore=store)
        for one, time_ns, data in reader.messages():
            message: Any = reader.deserialize(data, one.msgtype)
            if not reader.is2:
                message.header = header(message.header.stamp, message.header.frame_id)
            writer.write(connection, time_ns, store.serialize_cdr(message, JOINTS))
            count += 1
    return count


def copy_compressed(bag: Path, dest: Path) -> None:
    """Send a bag's content, unpacked, through the compressor that recordings have, a MiB at a time."""
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, get_chunk_data_stream

    from ml_dash_mcap import RecorderOptions
    from ml_dash_mcap.mcap.chunk_writer import compressor

    compress = compressor(RecorderOptions())
    (file,) = [bag] if bag.is_file() else [one for one in bag.iterdir() if one.suffix in (".mcap", ".db3")]
    with file.open("rb") as source, dest.open("wb") as out:
        if file.suffix == ".mcap":
            for record in StreamReader(source, emit_chunks=True).records:
                if isinstance(record, Chunk):
                    stream, size = get_chunk_data_stream(record)
                    out.write(compress(memoryview(stream.read(size))))
            return
        while piece := source.read(1 << 20):
            out.write(compress(memoryview(piece)))
