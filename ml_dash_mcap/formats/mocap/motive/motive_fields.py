"""Maps the columns of a foreign file of Motive's to topics, fields and units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ....meaning.mocap_objects import MARKERS_TOPIC
from ...foreign_names import distinct
from .. import stated_units
from ..placement import Placement
from . import column_header, layout
from .column_header import HeaderColumn, slug

_KEPT = (
    layout.TAKE_NAME,
    layout.TAKE_NOTES,
    layout.START_TIME,
    layout.COORDINATE_SPACE,
    layout.CAPTURE_RATE,
    layout.EXPORT_RATE,
)
"""Keys of the first line that become the topic's metadata."""


def foreign(
    columns: Sequence[HeaderColumn], pairs: Mapping[str, str], unit: str
) -> tuple[list[Placement], dict[str, dict[str, Any]]]:
    """Return where the fields of a foreign file's topics stand, and the metadata of the topics.

    Args:
        columns: Of the file, without those of frame and time.
        pairs: Of its first line.
        unit: Of its lengths.
    """
    groups = column_header.by_object(columns)
    bodies = [group for group in groups if columns[group[0]].type in layout.BODIES]
    names = distinct([columns[group[0]].name or "body" for group in bodies])
    placements: list[Placement] = []
    for name, group in zip(names, bodies, strict=True):
        placements += _body(name, columns, group)
    for group in groups:
        first = columns[group[0]]
        if first.type in layout.MARKERS:
            placements += _marker(columns, group, names)
        elif first.type == layout.JOINT:
            placements.append(Placement("joints", (first.name,), (), (group[0],)))
        elif first.type not in layout.BODIES:
            placements += _others(columns, group, slug(first.type), (first.name,) if first.name else ())
    about = {key: pairs[key] for key in _KEPT if pairs.get(key)}
    of_columns = [unit if column.group in layout.LENGTHS else "" for column in columns]
    fields = stated_units.by_topic(placements, of_columns)
    metadata = {"quat_order": "xyzw", "length_units": "m", "up": "y", "motive": about, **stated_units.converted([unit])}
    return placements, {  # Motive's exports have y up unless the user changed it
        placement.topic: {**metadata, "units": stated_units.of_parents(fields.get(placement.topic, {}))}
        for placement in placements
    }


def _body(name: str, columns: Sequence[HeaderColumn], group: Sequence[int]) -> list[Placement]:
    position = column_header.axes_of(columns, group, layout.POSITION, layout.POSITION_AXES)
    rotation = column_header.axes_of(columns, group, layout.ROTATION, layout.ROTATION_AXES)
    placements = [Placement(name, ("pos",), (3,), position), Placement(name, ("quat",), (4,), rotation)]
    errors = [at for at in group if columns[at].group in layout.ERRORS]
    if errors:
        placements.append(Placement(name, ("mean_marker_error",), (), (errors[0],)))
    rest = [at for at in group if at not in (*position, *rotation, *errors[:1])]
    return [*placements, *_others(columns, rest, name, ())]


def _marker(columns: Sequence[HeaderColumn], group: Sequence[int], bodies: Sequence[str]) -> list[Placement]:
    first = columns[group[0]]
    topic, name = _topic_of(first, bodies)
    position = column_header.axes_of(columns, group, layout.POSITION, layout.POSITION_AXES)
    placements = [Placement(topic, (layout.MARKERS[first.type], name), (3,), position)]
    for at in group:
        if at not in position:
            axis = (columns[at].axis,) if columns[at].axis else ()
            placements.append(Placement(topic, (slug(columns[at].group), name, *axis), (), (at,)))
    return placements


def _others(
    columns: Sequence[HeaderColumn], group: Sequence[int], topic: str, path: tuple[str, ...]
) -> list[Placement]:
    """Return a field for each column of a kind that is not known."""
    placements = []
    for at in group:
        axis = (columns[at].axis,) if columns[at].axis else ()
        placements.append(Placement(topic, (*path, slug(columns[at].group), *axis), (), (at,)))
    return placements


def _topic_of(column: HeaderColumn, bodies: Sequence[str]) -> tuple[str, str]:
    """Return a marker's topic and its name there: the body that its name or its ID belongs to, or its set."""
    before, colon, behind = column.name.partition(":")
    if colon and before and behind:
        return before, behind
    # The longest name first: markers of `hand_left` would also fit a body `hand`.
    for body in sorted(bodies, key=len, reverse=True):
        if column.name.startswith(f"{body}_"):
            return body, column.name[len(body) + 1 :]
    return MARKERS_TOPIC, column.name or "marker"
