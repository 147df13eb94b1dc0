"""Maps the points and channels of a foreign C3D file to fields: markers, model outputs, bodies, analog signals."""

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
        head: The header and the parameters of the file.
        data: What a frame has.
        bodies: How many rotations a frame has.
        unit: Of the file's lengths.
        topic: Of markers that belong to no set.
    """
    fields = C3dFields(rotation_unit=_rotation_unit(head, unit))
    outputs = _outputs(head)
    about: dict[str, Any] = {
        "c3d": {"first_frame": head.first, "rate": head.first_number(layout.POINT, layout.RATE) or head.rate}
    }
    for at, label in enumerate(_labels(head, layout.POINT, head.points, "point")):
        columns = tuple(range(3 * at, 3 * at + 3))
        kind = outputs.get(label) or outputs.get(label.rpartition(":")[2])
        if kind is None:
            placement = marker(label, columns, topic)
            fields.lengths += columns
            units = stated_units.converted([unit])
            _note_unit(fields, placement, "m", {**about, "length_units": "m", "quat_order": "xyzw", **units})
        else:
            placement = Placement(OUTPUTS_TOPIC, (kind[0], label), (3,), columns)
            _note_unit(fields, placement, kind[1], about)
        fields.points.append(placement)
    for at, name in enumerate(_labels(head, layout.ROTATION, bodies, "body")):
        first = 4 * bodies + 3 * at
        placed = Placement(name, ("pos",), (3,), tuple(range(first, first + 3)))
        fields.bodies += [placed, Placement(name, ("quat",), (4,), tuple(range(4 * at, 4 * at + 4)))]
        more = stated_units.converted([fields.rotation_unit])
        _note_unit(fields, placed, "m", {**about, "length_units": "m", "quat_order": "xyzw", **more})
    channels = _labels(head, layout.ANALOG, data.channels, "channel")
    stated = head.text(layout.ANALOG, layout.UNITS)
    # Files may name fewer units than channels.
    stated += [""] * (len(channels) - len(stated))
    for at, (name, own) in enumerate(zip(channels, stated, strict=False)):
        placement = Placement(ANALOG_TOPIC, (name,), (), (at,))
        fields.channels.append(placement)
        fields.channel_shifts.append(stated_units.shift(own))
        _note_unit(
            fields, placement, "m" if stated_units.is_length(own) else own, {**about, **stated_units.converted(stated)}
        )
    for metadata in fields.metadata.values():
        if "units" in metadata:
            metadata["units"] = stated_units.of_parents(metadata["units"])
    return fields


def _note_unit(fields: C3dFields, placement: Placement, unit: str, about: dict[str, Any]) -> None:
    metadata = fields.metadata.setdefault(placement.topic, {})
    metadata.update(about)
    if unit:
        metadata.setdefault("units", {})[".".join(placement.path)] = unit


def _outputs(head: Head) -> dict[str, tuple[str, str]]:
    """Return the points that are no positions, by label: what kind they are of, and their unit."""
    point_parameters = head.parameters.get(layout.POINT, {})
    groups = dict.fromkeys((*_OUTPUTS, *head.text(layout.POINT, "TYPE_GROUPS")))
    groups.update((f"{key.removesuffix('_UNITS')}S", None) for key in point_parameters if key.endswith("_UNITS"))
    outputs: dict[str, tuple[str, str]] = {}
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
                outputs.setdefault(label, (name.lower(), unit))
    return outputs


def _rotation_unit(head: Head, unit: str) -> str:
    stated = next(iter(head.text(layout.ROTATION, layout.UNITS)), "").lower()
    return length_unit(stated) or unit


def _labels(head: Head, group: str, count: int, word: str) -> list[str]:
    """Return the names of points or channels; those that the file does not name are numbered."""
    names = [name or f"{word} {at}" for at, name in enumerate(head.text(group, layout.LABELS)[:count], 1)]
    return distinct(names + [f"{word} {at + 1}" for at in range(len(names), count)])
