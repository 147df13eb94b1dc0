"""How OpenSim's marker files are laid out (opensim-org, "Marker (.trc) Files")."""

from __future__ import annotations

FIRST_WORD = "PathFileType"
"""Begins the first line, which ends with the file's name. What this library notes stands behind that, where other
readers do not look."""

RATE, MARKERS, UNITS, START_FRAME = "DataRate", "NumMarkers", "Units", "OrigDataStartFrame"
KEYS = (RATE, "CameraRate", "NumFrames", MARKERS, UNITS, "OrigDataRate", START_FRAME, "OrigNumFrames")
"""The cells of the second line; the third has their values. Files of others may spell them in small letters."""

COLUMNS = ("Frame#", "Time")
"""Before those of markers, which are three each."""
