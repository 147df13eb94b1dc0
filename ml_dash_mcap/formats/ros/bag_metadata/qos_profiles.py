"""The quality of service with which topics are offered, as profiles in the YAML of bags."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from ..bag_plan import Outlet
from . import yaml_text

OFFERED = "offered_qos_profiles"
"""The key of a connection's metadata that holds the profiles."""

LATCHING = "latching"
"""The key that a connection of ROS 1 has instead: "1" for a topic that gives late subscribers its last message."""

NAMES_VERSION = 9
"""The version of the metadata from which on policies have names, and profiles are a list instead of its YAML."""

# 2**63 - 1 ns, which ROS 2 takes for no limit (RMW_DURATION_INFINITE in rmw/time.h).
_FOREVER = {"sec": 9223372036, "nsec": 854775807}

_POLICIES: Mapping[str, tuple[str, ...]] = {
    "history": ("system_default", "keep_last", "keep_all", "unknown"),
    "reliability": ("system_default", "reliable", "best_effort", "unknown", "best_available"),
    "durability": ("system_default", "transient_local", "volatile", "unknown", "best_available"),
    "liveliness": ("system_default", "automatic", "manual_by_node", "manual_by_topic", "unknown", "best_available"),
}
"""Names of the policies since version 9 of the metadata, by the numbers that they were before (rmw/types.h)."""


def default(version: int, durability: str = "volatile") -> list[dict[str, Any]]:
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
        return _text(default(version))
    metadata = dict(outlet.carried.metadata)
    if OFFERED not in metadata:  # it comes from ROS 1
        return _text(default(version, "transient_local" if metadata.get(LATCHING) == "1" else "volatile"))
    profiles = parse(metadata[OFFERED])
    if all(isinstance(profile.get("history"), int) == (version < NAMES_VERSION) for profile in profiles):
        return metadata[OFFERED]
    return _text([_spelled(profile, version) for profile in profiles])


def joined(text: str, more: str) -> str:
    """Return the profiles of two files of a bag, each once, as YAML."""
    profiles = parse(text)
    others = [profile for profile in parse(more) if profile not in profiles]
    return _text([*profiles, *others]) if others else text


def is_latched(text: str) -> bool:
    """Whether a topic with these profiles gives late subscribers its last message, as a latched topic of ROS 1 does."""
    return any(_spelled(profile, NAMES_VERSION).get("durability") == "transient_local" for profile in parse(text))


@cache
def parse(text: str) -> list[dict[str, Any]]:
    """Return profiles from their YAML.

    The result is cached: most topics have the same text, and reading YAML takes long.
    """
    try:
        profiles = yaml_text.load(text) if text else []
    except ValueError:
        return []
    return [profile for profile in profiles if isinstance(profile, dict)] if isinstance(profiles, list) else []


def _spelled(profile: Mapping[str, Any], version: int) -> dict[str, Any]:
    """Return a profile with its policies as names, or as numbers before these were used."""
    spelled = dict(profile)
    for key, names in _POLICIES.items():
        value = spelled.get(key)
        if version < NAMES_VERSION and value in names:
            spelled[key] = names.index(value)
        elif version >= NAMES_VERSION and isinstance(value, int) and 0 <= value < len(names):
            spelled[key] = names[value]
    return spelled


def _text(profiles: list[dict[str, Any]]) -> str:
    return "\n".join(yaml_text.lines(profiles))
