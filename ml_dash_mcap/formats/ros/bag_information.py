"""What rosbag2 says of a bag: its `metadata.yaml`, or the part of it that a file of the bag repeats."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

ROOT = "rosbag2_bagfile_information"

RECORD = "rosbag2"
"""An MCAP metadata record of rosbag2 files: `ROS_DISTRO`, and `serialized_metadata`, which is YAML."""


def parse(text: str) -> dict[str, Any]:
    """Return what is said of a bag.

    Raises:
        ValueError: It is no metadata of a bag.
    """
    parsed = load(text)
    found = parsed.get(ROOT, parsed) if isinstance(parsed, dict) else None
    if not isinstance(found, dict):
        raise ValueError("there is no mapping in it")
    return found


def lenient(text: str) -> Mapping[str, Any]:
    """Return what is said of a bag; nothing where that cannot be read."""
    try:
        return parse(text) if text else {}
    except ValueError:
        return {}


def version(information: Mapping[str, Any]) -> int:
    """Return the version of a bag's metadata; 0 without metadata."""
    found = information.get("version")
    return found if isinstance(found, int) else 0


def custom(information: Mapping[str, Any]) -> Mapping[str, str]:
    """Return what somebody wrote about the bag, by key."""
    found = information.get("custom_data")
    return found if isinstance(found, dict) else {}


def digests(information: Mapping[str, Any]) -> dict[str, str]:
    """Return the hashes of types that are said, by topic."""
    topics = _topics(information)
    return {name: str(one["type_description_hash"]) for name, one in topics.items() if one.get("type_description_hash")}


def profiles(information: Mapping[str, Any]) -> dict[str, str]:
    """Return the QoS profiles that are said, by topic, as YAML."""
    found = {}
    for name, one in _topics(information).items():
        offered = one.get("offered_qos_profiles")
        if isinstance(offered, str):
            found[name] = offered
        elif isinstance(offered, list):  # since version 9 of the metadata; JSON is YAML
            found[name] = "\n".join(f"- {json.dumps(profile, default=str)}" for profile in offered)
    return found


def _topics(information: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    listed = information.get("topics_with_message_count")
    topics = [one.get("topic_metadata") for one in listed if isinstance(one, dict)] if isinstance(listed, list) else []
    return {str(one["name"]): one for one in topics if isinstance(one, dict) and one.get("name")}


def load(text: str) -> Any:
    """Read YAML.

    Raises:
        ValueError: It is none.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        return YAML(typ="safe", pure=True).load(text)
    except YAMLError as error:
        raise ValueError(str(error).splitlines()[0]) from error
