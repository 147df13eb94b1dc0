"""The `metadata.yaml` of a rosbag2 folder (rosbag2_storage's `metadata_io.cpp` and `yaml.hpp`).

What is written is YAML that is nearly JSON: texts in double quotes with JSON's escapes, which YAML has too.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..errors import OptionError
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


def qos(version: int) -> list[dict[str, Any]]:
    """Return the profile that topics are offered with: keep the last 10, reliable, volatile."""
    history, reliability, durability, liveliness = (
        (1, 1, 2, 1) if version < 9 else (*("keep_last", "reliable", "volatile", "automatic"),)
    )
    return [
        {
            "history": history,
            "depth": 10,
            "reliability": reliability,
            "durability": durability,
            "deadline": _FOREVER,
            "lifespan": _FOREVER,
            "liveliness": liveliness,
            "liveliness_lease_duration": _FOREVER,
            "avoid_ros_namespace_conventions": False,
        }
    ]


def qos_text(version: int) -> str:
    """Return the profile as a storage file says it."""
    return "\n".join(_lines(qos(version), 0))


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
    offered = qos_text(version) if version < 9 else qos(version)
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
                    "offered_qos_profiles": offered,
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
            name = key if key.isidentifier() else json.dumps(key)
            if isinstance(inner, (Mapping, list)) and inner:
                lines += [f"{blanks}{name}:", *_lines(inner, depth + 1)]
            else:
                lines.append(f"{blanks}{name}: {_scalar(inner)}")
        return lines
    for inner in value:
        if isinstance(inner, Mapping):
            first, *rest = _lines(inner, depth + 1)
            lines += [f"{blanks}- {first.lstrip()}", *rest]
        else:
            lines.append(f"{blanks}- {_scalar(inner)}")
    return lines


def _scalar(value: Any) -> str:
    if value is None:
        return "~"
    return json.dumps(value, ensure_ascii=True)
