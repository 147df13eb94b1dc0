"""Tells which distribution of ROS 2 probably recorded a bag, for messages that the bag does not define."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

METADATA_FILE = "metadata.yaml"
"""The file in a bag's folder in which rosbag2 describes the bag."""

RECORD = "rosbag2"
"""The metadata record of an MCAP file in which rosbag2 describes the bag, with these keys:"""
DISTRO_KEY, TEXT_KEY = "ROS_DISTRO", "serialized_metadata"

METADATA_KEY = "rosbag2_bagfile_information"
"""The key in `metadata.yaml` below which everything else stands."""

NAMES = ("dashing", "eloquent", "foxy", "galactic", "humble", "iron", "jazzy", "kilted", "lyrical")
"""The oldest first."""

OF_VERSION: Mapping[int, tuple[str, ...]] = {
    1: ("dashing",),
    2: ("dashing", "eloquent"),
    3: ("eloquent", "foxy"),
    4: ("foxy", "galactic"),
    5: ("humble",),
    6: ("iron",),
    7: ("iron",),
    8: ("iron", "jazzy"),
    9: ("jazzy", "kilted", "lyrical"),
}
"""Versions of rosbag2's metadata to the distributions that write them, the likeliest first."""

_UNKNOWN = "humble"
"""Bags have the definitions of their messages since Iron, so one that lacks them is likely from before."""

# Regular expressions instead of a YAML parser: reading YAML takes long, and broken text must not fail here.
_DISTRO = re.compile(r"^[ \t]*ros_distro:[ \t]*[\"']?(\w+)", re.MULTILINE)
_VERSION = re.compile(r"^[ \t]*version:[ \t]*([0-9]{1,3})[ \t]*\r?$", re.MULTILINE)


class Likely(NamedTuple):
    """Distributions that a bag may come from."""

    names: tuple[str, ...]
    """All distributions, the likeliest first."""
    certain: int
    """How many of the first names are possible: 1 if the distribution is certain."""


def likely(name: str | None = None, version: int | None = None) -> Likely:
    """Return the distributions that a bag may come from.

    Args:
        name: What the bag says, such as "humble". One that is no release, such as "rolling", counts for nothing.
        version: Of the bag's metadata, where it says no name.
    """
    stated = (name or "").lower()
    first = (stated,) if stated in NAMES else OF_VERSION.get(version or 0, ())
    at = NAMES.index(first[-1] if first else _UNKNOWN)
    # The nearest distribution first. Of two equally near ones the newer comes first.
    near = sorted(NAMES, key=lambda distro: (abs(NAMES.index(distro) - at), -NAMES.index(distro)))
    return Likely((*first, *(distro for distro in near if distro not in first)), len(first) or len(NAMES))


def in_metadata(text: str) -> tuple[str | None, int | None]:
    """Return the distribution and the version that rosbag2's metadata states: the text of a `metadata.yaml`."""
    name, version = _DISTRO.search(text), _VERSION.search(text)
    return name[1] if name else None, int(version[1]) if version else None
