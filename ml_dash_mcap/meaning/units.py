"""Units that people log in, by quantity, and their conversion to the SI units of ROS's messages (REP 103)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple


class Scale(NamedTuple):
    """The conversion to the SI unit: multiply by the factor, then add the offset."""

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

SPELLINGS: Mapping[str, str] = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), "cm"),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
    **dict.fromkeys(("rad", "radian", "radians"), "rad"),
    **dict.fromkeys(("deg", "degree", "degrees"), "deg"),
}
"""Other spellings of units, in lower case. Capitals are accepted as well."""

DECIMALS: Mapping[str, int] = {"m": 0, "cm": 2, "mm": 3}
"""Units of length that files of others have, to how many decimals the point moves to the right from metres.

Moving the point of a number's text is exact, which multiplying a double by `UNITS` is not."""

USUAL: Mapping[str, str] = {"magnetic field": "uT"}
"""The units of fields without a stated unit, where they are not ROS's own units. The source is ml-dash's
documentation."""


def of_field(units: object, way: Sequence[str]) -> object:
    """Return the unit of a field in a topic's `units`; None if it has none.

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
    """Return how the two halves of a field come to SI units; None if the unit is of neither.

    Args:
        first: The quantity of its first three values.
        second: That of the others.
        unit: One of either, such as "mm/s", or both, such as "mm/s, deg/s".
    """
    given = [part.strip() for part in unit.split(",")] if isinstance(unit, str) else unit
    if given is None:
        return _SAME, _SAME
    if not isinstance(given, (list, tuple)) or len(given) not in (1, 2):
        return None
    scales = scale(first, given[0]), scale(second, given[-1])
    if len(given) == 1:
        scales = (scales[0], _SAME) if scales[0] is not None else (_SAME, scales[1])
    return scales if scales[0] is not None and scales[1] is not None else None  # type: ignore[return-value]


def scale(quantity: str | None, unit: object) -> Scale | None:
    """Return how a field's values come to the SI unit; None if the unit is not one of the quantity's.

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
    if not isinstance(unit, str):
        return None
    scales = UNITS[quantity]
    return scales.get(unit) or scales.get(SPELLINGS.get(unit.strip().lower(), unit))


def length_unit(text: str) -> str | None:
    """Return the unit of length that a text spells: "m", "cm" or "mm"; None for any other text."""
    unit = SPELLINGS.get(text.strip().lower())
    return unit if unit in DECIMALS else None


def angle_unit(text: str) -> str | None:
    """Return the unit of angles that a text spells: "deg" or "rad"; None for any other text."""
    unit = SPELLINGS.get(text.strip().lower())
    return unit if unit in ("deg", "rad") else None
