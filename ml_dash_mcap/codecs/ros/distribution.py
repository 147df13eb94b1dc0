"""Finds the distribution of ROS 2 that a file's metadata or folder states, for messages that it does not define."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from ...mcap.records import Channel, Metadata
from . import distros
from .distros import Likely

CHANNEL_KEY = "ros_distro"
"""The key of a channel's metadata that may name the distribution."""

_YAML_BYTES = 1024 * 1024


def likely(channel: Channel, records: Iterable[Metadata], path: Path) -> Likely:
    """Return the distributions that a channel may come from.

    Its own metadata says it, or else the file's, or the `metadata.yaml` of its folder.

    Args:
        channel: Of messages.
        records: The file's metadata records.
        path: Where the file is.
    """
    name, version = channel.metadata.get(CHANNEL_KEY), None
    for values in (record.values for record in records if name is None and record.name == distros.RECORD):
        stated, stated_version = distros.in_metadata(values.get(distros.TEXT_KEY, ""))
        name, version = values.get(distros.DISTRO_KEY) or stated or name, stated_version or version
    if name is None and version is None:
        name, version = distros.in_metadata(_beside(path))
    return distros.likely(name, version)


def _beside(path: Path) -> str:
    try:
        with (path.parent / distros.METADATA_FILE).open("rb") as file:
            return file.read(_YAML_BYTES).decode(errors="replace")
    except OSError:
        return ""
