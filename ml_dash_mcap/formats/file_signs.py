"""The signs by which files of each format are told apart."""

from __future__ import annotations

import re
from pathlib import Path

from ..codecs.ros.distros import METADATA_FILE, METADATA_KEY
from .file_start import FileStart, begins_with, both, either, first_line, named, tables

VICON_SECTIONS = (
    "Trajectories",
    "Devices",
    "Model Outputs",
    "Joints",
    "Segments",
    "Objects",
    "Bones",
    "Events",
)
"""The titles of sections in files of Vicon: the first line of each."""

QTM_FIRST_LINE = re.compile(r'[ \t"]*(FILE_VERSION|NO_OF_FRAMES|NO_OF_CAMERAS)"? *[\t,;]')
"""Ends with the separator."""

ROS2_PACKED = (".db3", ".db3.zstd", ".mcap.zstd")
"""Endings of the files that only bags of ROS 2 have."""

motive = first_line(re.compile(r'[ \t"]*Format Version[ "]*[,;\t]'))
trc = first_line(re.compile(r'[ \t"]*PathFileType'))
qtm = first_line(QTM_FIRST_LINE)
vicon = first_line(re.compile(rf'[ \t\r\n,;"]*({"|".join(VICON_SECTIONS)})[ \t\r\n,;"]*\Z'))
wide = first_line(re.compile(r'[ \t"]*frame[ \t"]*[,;\t][ \t"]*time[ \t"\r]*([,;\t]|$)', re.IGNORECASE))
sto = named(".sto", ".mot")
c3d = both(named(".c3d"), begins_with(rb".\x50"))
parquet = either(tables(".parquet", ".pq"), begins_with(rb"PAR1"))
jsonl = tables(".jsonl", ".ndjson")
csv = tables(".csv", ".tsv")

_is_ros1 = begins_with(rb"#ROSBAG V")
# The nine bytes are the opcode and the length of the header record; then comes the profile behind its own length.
_is_ros2_mcap = begins_with(rb"\x89MCAP0\r\n.{9}\x04\0\0\0ros2")
"""An MCAP file whose header, its first record, has the profile "ros2"."""


def rosbag1(start: FileStart) -> bool:
    """Whether a file is a bag of ROS 1."""
    return start.is_file and (start.path.suffix == ".bag" or _is_ros1(start))


def rosbag2(start: FileStart) -> bool:
    """Whether a folder is a bag of ROS 2, or a file is one of such a bag."""
    if start.is_file:
        return start.name.endswith(ROS2_PACKED) or _is_ros2_mcap(start)
    return _has_bag_metadata(start.path / METADATA_FILE) or any(map(_is_of_bag, start.inside))


def _has_bag_metadata(path: Path) -> bool:
    try:
        return path.is_file() and METADATA_KEY in path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False


def _is_of_bag(path: Path) -> bool:
    """Whether a file, in a folder without metadata, is one of a bag."""
    return path.name.endswith(ROS2_PACKED) or (path.suffix == ".mcap" and _is_ros2_mcap(FileStart(path)))
