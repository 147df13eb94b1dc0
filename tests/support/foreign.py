"""MCAP files as other people's libraries write them, and their messages as other people's decoders see them."""

from __future__ import annotations

import array
import dataclasses
import functools
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan
from google.protobuf.message import Message as ProtobufMessage
from mcap.reader import NonSeekingReader
from mcap.records import Channel, Message, Schema
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory as ProtobufFactory
from mcap_protobuf.schema import register_schema
from mcap_ros1.decoder import DecoderFactory as Ros1Factory
from mcap_ros2.decoder import DecoderFactory as Ros2Factory
from rosbags.typesys import Stores, get_typestore

Row = dict[str, Any]

COUNT = 30
"""Messages a topic."""

START_NS = 1_700_000_000_000_000_000
ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS2 = get_typestore(Stores.ROS2_JAZZY)
JOINTS = "sensor_msgs/msg/JointState"
IMAGE = "sensor_msgs/msg/Image"


def time_ns(number: int) -> int:
    """The log time of a message: not in the order of writing, so that chunks overlap, and some at one time."""
    return START_NS + (number * 7 % COUNT) // 2 * 1_000_000_000 + 123_456_789


def joints(store: Any, number: int) -> Any:
    """A ROS message, of either generation."""
    time = store.types["builtin_interfaces/msg/Time"](number, 5)
    header = store.types["std_msgs/msg/Header"]
    of = header(number, time, "base") if store is ROS1 else header(time, "base")
    values = np.arange(7) * 0.1 + number
    return store.types[JOINTS](of, [f"joint_{n}" for n in range(7)], values, -values, values[:0])


def image(number: int) -> Any:
    """A ROS 2 message with many bytes."""
    header = joints(ROS2, number).header
    pixels = np.full(300, number, np.uint8)
    return ROS2.types[IMAGE](header, 10, 10, "rgb8", 0, 30, pixels)


def scan(number: int) -> LaserScan:
    """A protobuf message."""
    found = LaserScan(frame_id="lidar", start_angle=-1.0, ranges=[number / 4, 0.5])
    found.timestamp.FromNanoseconds(START_NS + number)
    return found


def write(path: Path, *, profile: str = "", **options: Any) -> Path:
    """Write a file with a topic of each encoding, one of several channels, and one that nobody decodes.

    Args:
        path: Where to.
        profile: For the header.
        options: Of `mcap.writer.Writer`.
    """
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start(profile, "tests")
        channels = _channels(writer)
        for number in range(COUNT):
            for channel, payload in channels.values():
                which = channel[number % len(channel)]
                time = time_ns(number)
                writer.add_message(which, time, payload(number), time + 1, number)
        for number in range(2):
            writer.add_metadata(f"note {number}", {"number": str(number)})
        writer.add_attachment(START_NS, START_NS, "a.txt", "text/plain", b"hello")
        writer.finish()
    return path


def _channels(writer: Writer) -> dict[str, tuple[list[int], Any]]:
    """Topic to its channels and what makes the payload of its n-th message."""
    anything = writer.register_schema("thing", "jsonschema", b'{"type": "object"}')
    ros1 = writer.register_schema("sensor_msgs/JointState", "ros1msg", _definition(ROS1, JOINTS, 1))
    ros2 = writer.register_schema(JOINTS, "ros2msg", _definition(ROS2, JOINTS, 2))
    pictures = writer.register_schema(IMAGE, "ros2msg", _definition(ROS2, IMAGE, 2))
    scans = register_schema(writer, LaserScan)

    def channel(topic: str, encoding: str, schema: int) -> int:
        return writer.register_channel(topic, encoding, schema, {"made": "here"})

    return {
        "/json": ([channel("/json", "json", anything)], _json),
        "/protobuf": ([channel("/protobuf", "protobuf", scans)], _scan),
        "/ros1": ([channel("/ros1", "ros1", ros1)], _ros1_joints),
        "/cdr": ([channel("/cdr", "cdr", ros2)], _ros2_joints),
        "/image": ([channel("/image", "cdr", pictures)], _image),
        "/several": ([channel("/several", "json", schema) for schema in (anything, 0, anything)], _json),
        "/raw": ([channel("/raw", "secret", 0)], lambda n: struct.pack("<I", n)),
    }


TOPICS = ["/cdr", "/image", "/json", "/protobuf", "/raw", "/ros1", "/several"]


@functools.cache
def _definition(store: Any, name: str, generation: int) -> bytes:
    text, _ = store.generate_msgdef(name, ros_version=generation)
    return str(text).encode()


@functools.cache
def _scan(number: int) -> bytes:
    return scan(number).SerializeToString()


@functools.cache
def _ros1_joints(number: int) -> bytes:
    return bytes(ROS1.serialize_ros1(joints(ROS1, number), JOINTS))


@functools.cache
def _ros2_joints(number: int) -> bytes:
    return bytes(ROS2.serialize_cdr(joints(ROS2, number), JOINTS))


@functools.cache
def _image(number: int) -> bytes:
    return bytes(ROS2.serialize_cdr(image(number), IMAGE))


def _json(number: int) -> bytes:
    return json.dumps({"n": number, "nested": {"x": number / 3, "names": ["a", "b"]}}).encode()


def seen_by_others(path: Path) -> dict[str, list[Row]]:
    """Each topic's messages in time order, as the decoders of the mcap project and its friends have them."""
    factories = [ProtobufFactory(), Ros1Factory(), Ros2Factory()]
    found: dict[str, list[tuple[int, Row]]] = {}
    with path.open("rb") as file:
        for schema, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
            row = {**_seen(factories, schema, channel, message), "_ts": message.log_time / 10**9}
            found.setdefault(channel.topic, []).append((message.log_time, row))
    return {topic: [row for _, row in sorted(rows, key=lambda one: one[0])] for topic, rows in found.items()}


def _seen(factories: list[Any], schema: Schema | None, channel: Channel, message: Message) -> Row:
    if channel.message_encoding == "json":
        row: Row = json.loads(message.data)
        return row
    for factory in factories:
        decode = factory.decoder_for(channel.message_encoding, schema)
        if decode is not None:
            plain: Row = as_plain(decode(message.data))
            return plain
    return {"data": message.data}


def as_plain(value: Any) -> Any:
    """What another library decoded as dicts, lists and Python's own values."""
    if isinstance(value, ProtobufMessage):
        return {
            field.name: as_plain(getattr(value, field.name))
            for field in value.DESCRIPTOR.fields
            if _is_there(value, field)
        }
    if isinstance(value, np.ndarray):
        return value.tobytes() if value.dtype == np.uint8 else value.tolist()
    if isinstance(value, array.array):
        return value.tobytes() if value.typecode == "B" else value.tolist()
    if isinstance(value, (str, bytes, int, float)):
        return value
    if hasattr(value, "secs"):  # a time of ROS 1
        return {"secs": value.secs, "nsecs": value.nsecs}
    if dataclasses.is_dataclass(value):
        names = [field.name for field in dataclasses.fields(value) if field.name.islower() and field.name[0] != "_"]
    else:
        names = list(getattr(type(value), "__slots__", ()))
    if names:
        return {name.removesuffix("_"): as_plain(getattr(value, name)) for name in names}
    return [as_plain(one) for one in value]


def _is_there(message: Any, field: Any) -> bool:
    return not field.has_presence or bool(message.HasField(field.name))
