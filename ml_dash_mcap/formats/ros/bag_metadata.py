"""The `metadata.yaml` of a rosbag2 folder (rosbag2_storage's `metadata_io.cpp` and `yaml.hpp`).

What is written is YAML that is nearly JSON: texts in double quotes with JSON's escapes, which YAML has too.
"""

from __future__ import annotations

import base64
import datetime
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from ...errors import OptionError
from . import bag_information as read
from .bag_plan import Outlet

DISTROS: Mapping[str, int] = {
    **dict.fromkeys(("humble", "iron"), 8),
    **dict.fromkeys(("jazzy", "kilted", "lyrical", "rolling"), 9),
}
"""Names of ROS 2 distributions, to the version of the metadata that all before the next one read."""

_FOREVER = {"sec": 9223372036, "nsec": 854775807}


@dataclass(frozen=True, slots=True)
class Contents:
    """What a file of the bag holds."""

    name: str
    counts: Mapping[int, int]
    """Messages, by the number of their outlet."""
    start_ns: int
    """Of the first message; 0 without messages."""
    end_ns: int

    @property
    def count(self) -> int:
        """Messages in all."""
        return sum(self.counts.values())


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
        name: Of the distribution that recorded it, which may be none that is known; empty if nobody says.
        version: Of the metadata that it came with; 0 without metadata.
    """
    if not name:
        return ("jazzy", DISTROS["jazzy"]) if not version or version >= 9 else ("humble", DISTROS["humble"])
    return name, DISTROS.get(name, 8 if 0 < version < 9 else 9)


_POLICIES: Mapping[str, tuple[str, ...]] = {
    "history": ("system_default", "keep_last", "keep_all", "unknown"),
    "reliability": ("system_default", "reliable", "best_effort", "unknown", "best_available"),
    "durability": ("system_default", "transient_local", "volatile", "unknown", "best_available"),
    "liveliness": ("system_default", "automatic", "manual_by_node", "manual_by_topic", "unknown", "best_available"),
}
"""Names of the policies since version 9 of the metadata, by the numbers that they were before (rmw/types.h)."""

OFFERED = "offered_qos_profiles"


def qos(version: int, durability: str = "volatile") -> list[dict[str, Any]]:
    """Return the profile that topics of ours are offered with: keep the last 10, reliable, volatile."""
    profile = {
        "history": "keep_last",
        "depth": 10,
        "reliability": "reliable",
        "durability": durability,
        "deadline": _FOREVER,
        "lifespan": _FOREVER,
        "liveliness": "automatic",
        "liveliness_lease_duration": _FOREVER,
        "avoid_ros_namespace_conventions": False,
    }
    return [_spelled(profile, version)]


def offered(outlet: Outlet, version: int) -> str:
    """Return the profiles that a topic was offered with, as YAML: as they came, but in the spelling of a version."""
    if outlet.carried is None:
        return _text(qos(version))
    metadata = dict(outlet.carried.metadata)
    if OFFERED not in metadata:  # it comes from ROS 1
        return _text(qos(version, "transient_local" if metadata.get("latching") == "1" else "volatile"))
    profiles = _profiles(metadata[OFFERED])
    if all(isinstance(one.get("history"), int) == (version < 9) for one in profiles):
        return metadata[OFFERED]
    return _text([_spelled(one, version) for one in profiles])


def joined(text: str, more: str) -> str:
    """Return the profiles of two files of a bag, each once, as YAML."""
    profiles = _profiles(text)
    others = [one for one in _profiles(more) if one not in profiles]
    return _text([*profiles, *others]) if others else text


def is_latched(text: str) -> bool:
    """Whether a topic that is offered so gives late subscribers its last message, as latched ones of ROS 1 do."""
    return any(_spelled(one, 9).get("durability") == "transient_local" for one in _profiles(text))


@cache
def _profiles(text: str) -> list[dict[str, Any]]:
    """Return profiles from their YAML. Most topics have the same ones, and reading YAML takes long."""
    try:
        found = read.load(text) if text else []
    except ValueError:
        return []
    return [one for one in found if isinstance(one, dict)] if isinstance(found, list) else []


def _spelled(profile: Mapping[str, Any], version: int) -> dict[str, Any]:
    """Return a profile with its policies as numbers, before version 9, or as names."""
    found = dict(profile)
    for key, names in _POLICIES.items():
        value = found.get(key)
        if version < 9 and value in names:
            found[key] = names.index(value)
        elif version >= 9 and isinstance(value, int) and 0 <= value < len(names):
            found[key] = names[value]
    return found


def _text(profiles: list[dict[str, Any]]) -> str:
    return "\n".join(_lines(profiles, 0))


def information(
    version: int,
    storage: str,
    distro: str,
    outlets: Sequence[Outlet],
    files: Sequence[Contents],
    custom: Mapping[str, str],
) -> dict[str, Any]:
    """Return what is said of a bag, or of one file of it."""
    having = [one for one in files if one.count]
    start = min((one.start_ns for one in having), default=0)
    end = max((one.end_ns for one in having), default=0)
    return {
        "version": version,
        "storage_identifier": storage,
        "duration": {"nanoseconds": end - start},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": sum(one.count for one in files),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": outlet.topic,
                    "type": outlet.type,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": offered(outlet, version)
                    if version < 9
                    else _profiles(offered(outlet, version)),
                    "type_description_hash": outlet.digest,
                },
                "message_count": sum(one.counts.get(outlet.number, 0) for one in files),
            }
            for outlet in outlets
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [one.name for one in files],
        "files": [
            {
                "path": one.name,
                "starting_time": {"nanoseconds_since_epoch": one.start_ns},
                "duration": {"nanoseconds": one.end_ns - one.start_ns},
                "message_count": one.count,
            }
            for one in files
        ],
        "custom_data": dict(custom) or None,
        "ros_distro": distro,
    }


def to_yaml(value: Any) -> str:
    """Spell dicts, lists, texts, numbers and booleans as YAML."""
    return "\n".join(_lines(value, 0)) + "\n"


def _lines(value: Any, depth: int) -> list[str]:
    blanks = "  " * depth
    lines: list[str] = []
    if isinstance(value, Mapping):
        for key, inner in value.items():
            is_plain = isinstance(key, str) and key.isidentifier() and key.lower() not in _WORDS
            name = key if is_plain else _scalar(key)
            if isinstance(inner, (Mapping, list)) and inner:
                lines += [f"{blanks}{name}:", *_lines(inner, depth + 1)]
            else:
                lines.append(f"{blanks}{name}: {_scalar(inner)}")
        return lines
    for inner in value:
        if isinstance(inner, Mapping) and inner:
            first, *rest = _lines(inner, depth + 1)
            lines += [f"{blanks}- {first.lstrip()}", *rest]
        else:
            lines.append(f"{blanks}- {_scalar(inner)}")
    return lines


_WORDS = frozenset({"true", "false", "null", "yes", "no", "on", "off", "y", "n"})
"""Texts that YAML takes for something else without quotes."""


def _scalar(value: Any) -> str:
    """Spell a value in one line: what YAML reads as anything but a list, dict or text as what it is."""
    if value is None:
        return "~"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_scalar(key)}: {_scalar(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_scalar, value)) + "]"
    if isinstance(value, float) and not math.isfinite(value):
        return ".nan" if math.isnan(value) else ".inf" if value > 0 else "-.inf"
    if isinstance(value, datetime.date):  # or a datetime, which is one
        return value.isoformat()
    if isinstance(value, bytes):
        return f"!!binary {json.dumps(base64.b64encode(value).decode())}"
    return json.dumps(value if isinstance(value, (str, int, float)) else str(value), ensure_ascii=True)
