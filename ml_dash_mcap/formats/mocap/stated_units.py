"""The units that a file states, field by field, and how its lengths were converted."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ...meaning.units import DECIMALS, length_unit
from .placement import Placement


def by_topic(placements: Sequence[Placement], units: Sequence[str]) -> dict[str, dict[str, str]]:
    """Return the unit of each field by its dotted name, topic by topic; a length that was converted is in m.

    Args:
        placements: Of the fields.
        units: Of each column, as the file spells it; "" for none.
    """
    units_by_topic: dict[str, dict[str, str]] = {}
    for placement in placements:
        stated = {units[at] for at in placement.columns} - {""}
        if len(stated) == 1:
            unit = stated.pop()
            units_by_topic.setdefault(placement.topic, {})[".".join(placement.path)] = "m" if is_length(unit) else unit
    return units_by_topic


def is_length(unit: str) -> bool:
    """Whether a unit is one of length that is converted to metres."""
    return length_unit(unit) is not None


def shift(unit: str) -> int:
    """Return by how many places the decimal point of a number moves to the right on its way into a recording."""
    length = length_unit(unit)
    return -DECIMALS[length] if length else 0


def converted(units: Iterable[str]) -> dict[str, Any]:
    """Return what was done with lengths of some units, for the metadata of topics; nothing if they are in metres."""
    lengths = sorted({length for unit in units if (length := length_unit(unit))} - {"m"})
    return {"converted": f"lengths from {' and '.join(lengths)} to m"} if lengths else {}


def of_parents(units: Mapping[str, str]) -> dict[str, str]:
    """Return the units of fields, those of all fields in one dict as one, such as `markers`.

    Example:
        >>> of_parents({"markers.a": "m", "markers.b": "m", "pos": "m"})
        {'markers': 'm', 'pos': 'm'}
    """
    groups: dict[str, set[str]] = {}
    for name, unit in units.items():
        groups.setdefault(name.partition(".")[0], set()).add(unit)
    of_parent: dict[str, str] = {}
    for name, unit in units.items():
        parent = name.partition(".")[0]
        of_parent[parent if len(groups[parent]) == 1 else name] = unit
    return of_parent
