"""What the points and channels of a foreign C3D file are: markers, model outputs, bodies, analog signals."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ....meaning.units import length_unit
from ...foreign_names import distinct
from .. import stated_units
from ..placement import Placement
from ..point_fields import marker
from . import layout
from .file_parameters import Head
from .frame_data import Data

OUTPUTS_TOPIC = "model_outputs"
ANALOG_TOPIC = "analog"
_OUTPUTS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")
"""Parameters of POINT that list the points that are no positions."""


@dataclass(slots=True)
class C3dFields:
    """Where the numbers of a file go."""

    points: list[Placement] = field(default_factory=list)
    """Columns are x y z of each point."""
    lengths: list[int] = field(default_factory=list)
    """Those of these columns that are lengths."""
    bodies: list[Placement] = field(default_factory=list)
    """Columns are the quaternions of all bodies, then their positions."""
    rotation_unit: str = "m"
    channels: list[Placement] = field(default_factory=list)
    channel_shifts: list[int] = field(default_factory=list)
    metadata: dict[str, dict[str, Any]] = field(default_factory=dict)


def lay_out(head: Head, data: Data, bodies: int, unit: str, topic: str) -> C3dFields:
    """Return where the numbers of a foreign file go.

    Args:
        head: What the file says of itself.
        data: What a frame has.
        bodies: How many rotations a frame has.
        unit: Of the file's lengths.
        topic: Of markers that belong to no set.
    """
    found = C3dFields(rotation_unit=_rotation_unit(head, unit))
    outputs = _outputs(head)
    about: dict[str, Any] = {
        "c3d": {"first_frame": head.first, "rate": head.one(layout.POINT, layout.RATE) or head.rate}
    }
    for at, label in enumerate(_labels(head, layout.POINT, head.points, "point")):
        columns = tuple(range(3 * at, 3 * at + 3))
        kind = outputs.get(label) or outputs.get(label.rpartition(":")[2])
        if kind is None:
            one = marker(label, columns, topic)
            found.lengths += columns
            units = stated_units.converted([unit])
            _say(found, one, "m", {**about, "length_units": "m", "quat_order": "xyzw", **units})
        else:
            one = Placement(OUTPUTS_TOPIC, (kind[0], label), (3,), columns)
            _say(found, one, kind[1], about)
        found.points.append(one)
    for at, name in enumerate(_labels(head, layout.ROTATION, bodies, "body")):
        first = 4 * bodies + 3 * at
        placed = Placement(name, ("pos",), (3,), tuple(range(first, first + 3)))
        found.bodies += [placed, Placement(name, ("quat",), (4,), tuple(range(4 * at, 4 * at + 4)))]
        more = stated_units.converted([found.rotation_unit])
        _say(found, placed, "m", {**about, "length_units": "m", "quat_order": "xyzw", **more})
    channels = _labels(head, layout.ANALOG, data.channels, "channel")
    stated = head.text(layout.ANALOG, layout.UNITS)
    stated += [""] * (len(channels) - len(stated))
    for at, (name, own) in enumerate(zip(channels, stated, strict=False)):
        one = Placement(ANALOG_TOPIC, (name,), (), (at,))
        found.channels.append(one)
        found.channel_shifts.append(stated_units.shift(own))
        _say(found, one, "m" if stated_units.is_length(own) else own, {**about, **stated_units.converted(stated)})
    for said in found.metadata.values():
        if "units" in said:
            said["units"] = stated_units.of_parents(said["units"])
    return found


def _say(fields: C3dFields, one: Placement, unit: str, about: dict[str, Any]) -> None:
    said = fields.metadata.setdefault(one.topic, {})
    said.update(about)
    if unit:
        said.setdefault("units", {})[".".join(one.path)] = unit


def _outputs(head: Head) -> dict[str, tuple[str, str]]:
    """Return the points that are no positions, by label: what kind they are of, and their unit."""
    said = head.parameters.get(layout.POINT, {})
    groups = dict.fromkeys((*_OUTPUTS, *head.text(layout.POINT, "TYPE_GROUPS")))
    groups.update((f"{key.removesuffix('_UNITS')}S", None) for key in said if key.endswith("_UNITS"))
    found: dict[str, tuple[str, str]] = {}
    for group in groups:
        name = group.strip().upper()
        unit = next(
            iter(
                head.text(layout.POINT, f"{name.removesuffix('S')}_UNITS") or head.text(layout.POINT, f"{name}_UNITS")
            ),
            "",
        )
        for label in head.text(layout.POINT, name):
            if label and name not in (layout.LABELS, "DESCRIPTIONS", layout.UNITS, "TYPE_GROUPS"):
                found.setdefault(label, (name.lower(), unit))
    return found


def _rotation_unit(head: Head, unit: str) -> str:
    stated = next(iter(head.text(layout.ROTATION, layout.UNITS)), "").lower()
    return length_unit(stated) or unit


def _labels(head: Head, group: str, count: int, word: str) -> list[str]:
    """Return the names of points or channels; those that the file does not name are numbered."""
    names = [name or f"{word} {at}" for at, name in enumerate(head.text(group, layout.LABELS)[:count], 1)]
    return distinct(names + [f"{word} {at + 1}" for at in range(len(names), count)])
