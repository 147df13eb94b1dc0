"""The points of files of others as fields: markers by name, in metres."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from . import stated_units
from .placement import Placement


def marker(name: str, columns: tuple[int, ...], topic: str) -> Placement:
    """Return where a marker's numbers go: `set:name` into the topic `set`."""
    before, colon, behind = name.partition(":")
    if colon and before and behind:
        return Placement(before, ("markers", behind), (3,), columns)
    return Placement(topic, ("markers", name), (3,), columns)


def about_points(placements: Sequence[Placement], unit: str, more: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the metadata of topics of points that the file has in some unit of length."""
    metadata = {"length_units": "m", "units": {"markers": "m"}, **stated_units.converted([unit]), **more}
    return {placement.topic: metadata for placement in placements}
