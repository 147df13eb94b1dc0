"""Maps the columns of a foreign section of Vicon's to topics, fields and units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ...foreign_names import distinct
from .. import stated_units
from ..placement import Placement
from ..point_fields import marker
from . import layout
from .sections import Section


def placed(section: Section, topic: str) -> list[Placement]:
    """Return where a section's numbers go.

    Args:
        section: The section.
        topic: Of markers without a subject.
    """
    placements: list[Placement] = []
    for name, columns in _objects(section).items():
        by_axis = {section.axes[at].upper(): at for at in columns}
        where = _slug(section.title)
        prefix: tuple[str, ...] = (name,) if name else ()
        taken: tuple[int, ...] = ()
        if set(layout.POINT_AXES) <= set(by_axis) and section.title == layout.TRAJECTORIES:
            taken = tuple(by_axis[axis] for axis in layout.POINT_AXES)
            placement = marker(name or "marker", taken, topic)
            placements.append(placement)
            where, prefix = placement.topic, placement.path[1:]
        elif set(layout.PLACE_AXES) <= set(by_axis):
            where, prefix = name.replace(":", "/") or section.title.lower(), ()
            taken = tuple(by_axis[axis] for axis in layout.PLACE_AXES)
            placements.append(Placement(where, ("pos",), (3,), taken))
            turns = tuple(by_axis[axis] for axis in layout.ROTATION_AXES if axis in by_axis)
            if len(turns) > 2:
                placements.append(Placement(where, ("quat" if len(turns) == 4 else "rotation",), (len(turns),), turns))
                taken += turns
        for at in columns:  # each other column is a field of its own
            if at not in taken:
                path = tuple(filter(None, (*prefix, section.axes[at]))) or ("value",)
                placements.append(Placement(where, path, (), (at,)))
    return placements


def about(section: Section, placements: Sequence[Placement]) -> dict[str, dict[str, Any]]:
    """Return the metadata of a section's topics."""
    fields = stated_units.by_topic(placements, section.units)
    metadata_by_topic: dict[str, dict[str, Any]] = {}
    for placement in placements:
        metadata = metadata_by_topic.setdefault(
            placement.topic, {"quat_order": "xyzw", "vicon": {"section": section.title}}
        )
        own = {section.units[at] for at in placement.columns}
        if any(stated_units.is_length(unit) for unit in own):
            metadata["length_units"] = "m"
            metadata.update(stated_units.converted(section.units))
        if placement.topic in fields:
            metadata["units"] = stated_units.of_parents(fields[placement.topic])
    return metadata_by_topic


def merged(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, Any]:
    """Return the metadata of a topic that has fields of two sections."""
    both = {**first, **second}
    for key in ("units",):
        if key in first and key in second:
            both[key] = {**first[key], **second[key]}
    if first and first.get("vicon") != second.get("vicon"):
        both["vicon"] = (
            {"section": f"{first['vicon']['section']}, {second['vicon']['section']}"} if "vicon" in first else {}
        )
    return both


def _objects(section: Section) -> dict[str, list[int]]:
    """Return the columns of each object: a name's, up to the next name, or to where its axes begin again."""
    starts: list[tuple[str, list[int]]] = []
    for at, name in enumerate(section.names):
        if not starts or starts[-1][0] != name or section.axes[at] in [section.axes[place] for place in starts[-1][1]]:
            starts.append((name, []))
        starts[-1][1].append(at)
    names = distinct([name for name, _ in starts])
    return {name: columns for name, (_, columns) in zip(names, starts, strict=True)}


def _slug(title: str) -> str:
    return title.lower().replace(" ", "_")
