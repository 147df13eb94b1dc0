"""Where the columns of a foreign section of Vicon's go: topics, fields, units."""

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
            one = marker(name or "marker", taken, topic)
            placements.append(one)
            where, prefix = one.topic, one.path[1:]
        elif set(layout.PLACE_AXES) <= set(by_axis):
            where, prefix = name.replace(":", "/") or section.title.lower(), ()
            taken = tuple(by_axis[axis] for axis in layout.PLACE_AXES)
            placements.append(Placement(where, ("pos",), (3,), taken))
            turns = tuple(by_axis[axis] for axis in layout.ROTATION_AXES if axis in by_axis)
            if len(turns) > 2:
                placements.append(Placement(where, ("quat" if len(turns) == 4 else "rotation",), (len(turns),), turns))
                taken += turns
        for at in columns:  # what is none of these is a field of its own
            if at not in taken:
                path = tuple(filter(None, (*prefix, section.axes[at]))) or ("value",)
                placements.append(Placement(where, path, (), (at,)))
    return placements


def about(section: Section, placements: Sequence[Placement]) -> dict[str, dict[str, Any]]:
    """Return the metadata of a section's topics."""
    fields = stated_units.by_topic(placements, section.units)
    found: dict[str, dict[str, Any]] = {}
    for one in placements:
        said = found.setdefault(one.topic, {"quat_order": "xyzw", "vicon": {"section": section.title}})
        own = {section.units[at] for at in one.columns}
        if any(stated_units.is_length(unit) for unit in own):
            said["length_units"] = "m"
            said.update(stated_units.converted(section.units))
        if one.topic in fields:
            said["units"] = stated_units.of_parents(fields[one.topic])
    return found


def merged(one: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    """Return the metadata of a topic that has fields of two sections."""
    both = {**one, **other}
    for key in ("units",):
        if key in one and key in other:
            both[key] = {**one[key], **other[key]}
    if one and one.get("vicon") != other.get("vicon"):
        both["vicon"] = {"section": f"{one['vicon']['section']}, {other['vicon']['section']}"} if "vicon" in one else {}
    return both


def _objects(section: Section) -> dict[str, list[int]]:
    """Return the columns of each object: a name's, up to the next name, or to where its axes begin again."""
    starts: list[tuple[str, list[int]]] = []
    for at, name in enumerate(section.names):
        if not starts or starts[-1][0] != name or section.axes[at] in [section.axes[one] for one in starts[-1][1]]:
            starts.append((name, []))
        starts[-1][1].append(at)
    names = distinct([name for name, _ in starts])
    return {name: columns for name, (_, columns) in zip(names, starts, strict=True)}


def _slug(title: str) -> str:
    return title.lower().replace(" ", "_")
