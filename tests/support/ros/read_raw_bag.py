"""Reads a bag's raw messages and connections with ROS 1's own `rosbag`; run with the system's Python.

    python3 read_raw_bag.py BAG

Prints a JSON object: each message's topic, type, time (ns) and bytes, and each connection's header.
"""

import hashlib
import json
import sys

import rosbag


def main() -> None:
    with rosbag.Bag(sys.argv[1]) as bag:
        messages = [
            (topic, raw[0], raw[2], time.to_nsec(), hashlib.sha256(raw[1]).hexdigest())
            for topic, raw, time in bag.read_messages(raw=True)
        ]
        connections = sorted(
            sorted((name, value.decode() if isinstance(value, bytes) else value) for name, value in one.header.items())
            for one in bag._get_connections()
        )
    print(json.dumps({"messages": messages, "connections": connections}))


main()
