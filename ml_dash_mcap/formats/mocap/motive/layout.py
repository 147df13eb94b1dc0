"""The layout of Motive's CSV files (docs.optitrack.com, Data Export: CSV): a line of pairs, then rows by column.

The rows above the numbers differ by version; 1.23 and later label them.
"""

from __future__ import annotations

from collections.abc import Mapping

from ....meaning.mocap_objects import MARKER_KINDS

VERSIONS = ("1.2", "1.20", "1.21", "1.22", "1.23", "1.24", "1.25")

FORMAT_VERSION, ROTATION_TYPE, LENGTH_UNITS = "Format Version", "Rotation Type", "Length Units"
TAKE_NAME, START_TIME, EXPORT_RATE = "Take Name", "Capture Start Time", "Export Frame Rate"
TAKE_NOTES, COORDINATE_SPACE, CAPTURE_RATE = "Take Notes", "Coordinate Space", "Capture Frame Rate"
"""Keys of the first line's pairs."""

QUATERNION = "Quaternion"
"""The rotation type of which the columns are x y z w."""

UNIT_WORDS: Mapping[str, str] = {"m": "Meters", "cm": "Centimeters", "mm": "Millimeters"}

TYPE, NAME, IDENTITY, PARENT = "Type", "Name", "ID", "Parent"
"""Labels of the rows above the axes; the row of groups has none."""

FRAME, TIME = "Frame", "Time (Seconds)"
"""The first columns. A time code may stand before or behind the time."""

RIGID_BODY, BONE, MARKER, JOINT = "Rigid Body", "Bone", "Marker", "Joint"
"""Types of objects; joints are this library's own."""

BODIES = (RIGID_BODY, BONE)
MARKERS: Mapping[str, str] = {MARKER: "markers", **{kind: field for field, kind in MARKER_KINDS.items()}}
"""Types of markers, to the fields that hold them."""

ROTATION, POSITION, MARKER_ERROR, ANGLE = "Rotation", "Position", "Mean Marker Error", "Angle"
"""Groups of an object's columns."""

ROTATION_AXES, POSITION_AXES = "XYZW", "XYZ"
ERRORS = (MARKER_ERROR, "Error Per Marker")
LENGTHS = (POSITION, *ERRORS)
"""Groups that are lengths."""
