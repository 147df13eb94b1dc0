"""Writes a bag with ROS 1's own `rosbag`; run with the system's Python.

    python3 write_bag.py BAG COMPRESSION

It has 100 messages on each of two topics, not in the order of time, in several chunks. Prints an empty JSON object.
"""

import sys

import genpy
import rosbag
from sensor_msgs.msg import Image, JointState


def main() -> None:
    with rosbag.Bag(sys.argv[1], "w", compression=sys.argv[2], chunk_threshold=2000) as bag:
        for number in range(100):
            late = number ^ 1  # every other message comes before the one that it follows
            time = genpy.Time(100 + late, 5)
            joints = JointState(name=["a", "\u00e4"], position=[0.5, late])
            joints.header.stamp = genpy.Time(late, 7)
            bag.write("/joints", joints, time)
            bag.write("/image", Image(height=1, width=2, encoding="mono8", step=2, data=bytes([late, 255])), time)
    print("{}")


main()
