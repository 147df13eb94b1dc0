"""Axes and units of positions as a topic's metadata states them: z up or y up, metres or millimetres."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import ConversionError
from .units import length_unit

Floats = npt.NDArray[np.float64]

UPS = ("z", "y")


def turned(vectors: Floats, up_from: str, up_to: str) -> Floats:
    """Turn vectors, [N, 3], or the vector part of quaternions, so that what pointed up does so still.

    From z up to y up that is (x, y, z) -> (x, z, -y), a quarter turn about x; the other way its inverse. Both only
    change places and signs, so they undo each other bit for bit.
    """
    if up_from == up_to:
        return vectors
    x, y, z = vectors[:, 0], vectors[:, 1], vectors[:, 2]
    return np.stack([x, z, -y] if up_to == "y" else [x, -z, y], axis=1)


def turned_rotations(quaternions: Floats, up_from: str, up_to: str) -> Floats:
    """Turn the rotations of bodies, x y z w, [N, 4], like `turned`: the angle stays, the axis is turned."""
    if up_from == up_to:
        return quaternions
    return np.concatenate((turned(quaternions[:, :3], up_from, up_to), quaternions[:, 3:]), axis=1)


def unit_of(metadata: Mapping[str, Any], column: str) -> str:
    """Return the unit of length of a field as its topic's metadata says it; "m" if it does not.

    Args:
        metadata: Of the topic: `length_units`, or else `units`; one for all fields, or a dict of them by dotted name.
        column: The field's dotted name.

    Raises:
        ConversionError: It is a unit that is not known.
    """
    stated = metadata.get("length_units", metadata.get("units", "m"))
    is_of_field = "length_units" in metadata
    if isinstance(stated, Mapping):
        parents = [column[:at] for at, letter in enumerate(column) if letter == "."]
        stated = next((stated[name] for name in (column, *reversed(parents)) if name in stated), "m")
        is_of_field = True
    unit = length_unit(str(stated)) or (None if is_of_field else "m")  # `units="rad"` is about other fields
    if unit is None:
        raise ConversionError(f"field {column!r}: its topic's metadata says {stated!r}; m, cm and mm are known")
    return unit


def up_of(metadata: Mapping[str, Any]) -> str:
    """Return which axis points up as a topic's metadata says it; "z" if it does not.

    Raises:
        ConversionError: It says one that is not known.
    """
    up = str(metadata.get("up", "z")).lower()
    if up not in UPS:
        raise ConversionError(f"the topic's metadata says up={metadata['up']!r}; 'z' and 'y' are known")
    return up
