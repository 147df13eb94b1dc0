"""How OpenSim's storage files are laid out (opensim-org, "Storage (.sto) File Format")."""

from __future__ import annotations

TIME = "time"
"""The first column; times need not be evenly spaced."""

VERSION, ROWS, COLUMNS, IN_DEGREES = "version", "nRows", "nColumns", "inDegrees"
NOTE = "ml_dash_note"
"""Keys of the header's lines, `key=value`; `NOTE` is this library's. Files of others may have other capitals."""

END = "endheader"
TOPIC = "joints"
"""What the topic of a file of joints is called, where nothing else says it."""
