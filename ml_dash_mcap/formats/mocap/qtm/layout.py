"""How TSV files of Qualisys Track Manager are laid out (docs.qualisys.com, Motion data)."""

from __future__ import annotations

FRAMES, FREQUENCY, START, INCLUDED = "NO_OF_FRAMES", "FREQUENCY", "TIME_STAMP", "DATA_INCLUDED"
MARKERS, BODIES = "MARKER_NAMES", "BODY_NAMES"
NOTE = "ML_DASH_NOTE"
"""Keys of the header, each in a line with its values; `NOTE` is this library's."""

UNIT = "mm"
"""Of all lengths."""

COLUMNS = ("Frame", "Time")
"""Before those of markers or bodies; a file of others may have neither."""

BODY_COLUMNS = 16
"""X Y Z, roll pitch yaw, residual, and the rotation matrix column by column."""

SHORT_BODY_COLUMNS = 7
"""The same without the matrix, which an export may leave out."""
