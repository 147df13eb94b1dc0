"""How CSV files of Vicon are laid out: sections as Nexus has them, bodies as Tracker has them."""

from __future__ import annotations

from ...file_signs import VICON_SECTIONS as SECTIONS

TRAJECTORIES, OBJECTS, EVENTS = "Trajectories", "Objects", "Events"
"""Sections that have layouts of their own; others are read too if they are laid out like those in `SECTIONS`."""

COLUMNS = ("Frame", "Sub Frame")
"""Before the others."""
LEADING = len(COLUMNS)

POINT_AXES = ("X", "Y", "Z")
ROTATION_AXES = ("RX", "RY", "RZ", "RW")
PLACE_AXES = ("TX", "TY", "TZ")
BODY_AXES = (*ROTATION_AXES, *PLACE_AXES)
"""The columns of an object; its rotation is the quaternion x y z w."""

UNIT = "mm"
"""Of the lengths that this library writes, and of those in its files."""

__all__ = [
    "BODY_AXES",
    "COLUMNS",
    "EVENTS",
    "LEADING",
    "OBJECTS",
    "PLACE_AXES",
    "POINT_AXES",
    "ROTATION_AXES",
    "SECTIONS",
    "TRAJECTORIES",
    "UNIT",
]
