"""Units that people log in, to those that ROS's messages are in (https://www.ros.org/reps/rep-0103.html)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple


class Scale(NamedTuple):
    """How to come to ROS's unit: multiply, then add."""

    factor: float
    offset: float = 0.0


_SAME = Scale(1.0)
_DEGREE = Scale(math.pi / 180)

UNITS: Mapping[str, Mapping[str, Scale]] = {
    "angle": {"rad": _SAME, "deg": _DEGREE, "\u00b0": _DEGREE, "m": _SAME, "mm": Scale(1e-3)},
    "angular velocity": {
        "rad/s": _SAME,
        "deg/s": _DEGREE,
        "rpm": Scale(math.pi / 30),
        "m/s": _SAME,
        "mm/s": Scale(1e-3),
    },
    "torque": {"Nm": _SAME, "N m": _SAME, "N*m": _SAME, "N\u00b7m": _SAME, "N": _SAME, "mNm": Scale(1e-3)},
    "force": {"N": _SAME, "kN": Scale(1e3), "mN": Scale(1e-3)},
    "length": {"m": _SAME, "mm": Scale(1e-3), "cm": Scale(1e-2)},
    "velocity": {"m/s": _SAME, "mm/s": Scale(1e-3), "cm/s": Scale(1e-2)},
    "acceleration": {"m/s^2": _SAME, "m/s2": _SAME, "m/s\u00b2": _SAME, "g": Scale(9.80665)},
    "magnetic field": {"T": _SAME, "uT": Scale(1e-6), "\u00b5T": Scale(1e-6), "mT": Scale(1e-3), "G": Scale(1e-4)},
    "temperature": {"degC": _SAME, "C": _SAME, "\u00b0C": _SAME, "K": Scale(1.0, -273.15)},
}
"""Quantities, to the units that are known. A joint may be a linear one: then its angle is a length."""

USUAL: Mapping[str, str] = {"magnetic field": "uT"}
"""What a field is in that no unit was given for, where that is not ROS's own unit: ml-dash's documentation says so."""


def said(units: object, way: Sequence[str]) -> object:
    """Return what a topic's `units` say of a field; None if nothing.

    Args:
        units: By dotted name, or dicts like those of the rows.
        way: The keys from the row to the field.
    """
    if isinstance(units, Mapping) and ".".join(way) in units:
        return units[".".join(way)]
    at: object = units
    for key in way:
        at = at.get(key) if isinstance(at, Mapping) else None
    return at


def halves(first: str, second: str, unit: object) -> tuple[Scale, Scale] | None:
    """Return how the two halves of a field come to ROS's units; None if the unit is of neither.

    Args:
        first: The quantity of its first three values.
        second: That of the others.
        unit: One of either, such as "mm/s", or both, such as "mm/s, deg/s".
    """
    given = [one.strip() for one in unit.split(",")] if isinstance(unit, str) else unit
    if given is None:
        return _SAME, _SAME
    if isinstance(given, (list, tuple)) and len(given) == 2:
        found = scale(first, given[0]), scale(second, given[1])
        return found if found[0] is not None and found[1] is not None else None  # type: ignore[return-value]
    if isinstance(given, (list, tuple)) and len(given) == 1:
        one = scale(first, given[0])
        if one is not None:
            return one, _SAME
        one = scale(second, given[0])
        return (_SAME, one) if one is not None else None
    return None


def scale(quantity: str | None, unit: object) -> Scale | None:
    """Return how a field's values come to ROS's unit; None if the unit is not one of the quantity's.

    Args:
        quantity: One of `UNITS`; None for what has no unit.
        unit: As the topic's metadata has it; None if it has none.
    """
    if quantity is None:
        return _SAME
    if unit is None:
        unit = USUAL.get(quantity)
        if unit is None:
            return _SAME
    return UNITS[quantity].get(unit) if isinstance(unit, str) else None
