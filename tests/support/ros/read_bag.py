"""Reads a bag with ROS 1's own `rosbag`; run with the system's Python.

    python3 read_bag.py BAG

Prints a JSON object: what `rosbag info` and `rosbag check` find, and of each topic the type, the number of messages and
the first one.
"""

import json
import sys

import rosbag


def main() -> None:
    with rosbag.Bag(sys.argv[1]) as bag:
        info = bag.get_type_and_topic_info()
        topics = {
            name: {"type": one.msg_type, "count": one.message_count, "md5sum": info.msg_types[one.msg_type]}
            for name, one in info.topics.items()
        }
        for topic, message, time in bag.read_messages():
            found = topics[topic]
            found["read"] = found.get("read", 0) + 1
            found.setdefault("first", plain(message))
            found.setdefault("times", []).append(time.to_nsec())
            found["valid"] = message._md5sum == found["md5sum"]
        compression = bag.get_compression_info().compression
    print(json.dumps({"topics": topics, "compression": str(compression)}))


def plain(value):
    if hasattr(value, "__slots__") and not isinstance(value, (str, bytes)):
        return {name: plain(getattr(value, name)) for name in value.__slots__}
    if isinstance(value, bytes):
        return list(value)
    return [plain(inner) for inner in value] if isinstance(value, (list, tuple)) else value


main()
