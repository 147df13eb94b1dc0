"""The version of rosbag2's metadata that a bag for a distribution of ROS 2 has."""

from __future__ import annotations

from collections.abc import Mapping

from ....errors import OptionError

DISTROS: Mapping[str, int] = {
    **dict.fromkeys(("humble", "iron"), 8),
    **dict.fromkeys(("jazzy", "kilted", "lyrical", "rolling"), 9),
}
"""Distributions of ROS 2 to the version of the metadata that they, and all later ones up to the next entry, can
read."""


def check_distro(distro: str) -> int:
    """Return the version of the metadata for a distribution.

    Raises:
        OptionError: There is no such distribution, or none that is supported.
    """
    if distro not in DISTROS:
        raise OptionError(f"distro={distro!r}: it must be one of {', '.join(map(repr, DISTROS))}")
    return DISTROS[distro]


def distro_of(name: str, version: int) -> tuple[str, int]:
    """Return the distribution, and the version of the metadata, for a bag that goes out as it came in.

    Args:
        name: The distribution that recorded it, which may be an unknown name; empty if it is not stated.
        version: The version of the metadata that it came with; 0 without metadata.
    """
    if not name:
        return ("jazzy", DISTROS["jazzy"]) if not version or version >= 9 else ("humble", DISTROS["humble"])
    return name, DISTROS.get(name, 8 if 0 < version < 9 else 9)
