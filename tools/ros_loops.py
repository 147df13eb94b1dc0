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
