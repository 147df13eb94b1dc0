"""How C3D files are laid out (The C3D File Format, User Guide, c3d.org), as far as both directions know it."""

from __future__ import annotations

POINT, ANALOG, ROTATION = "POINT", "ANALOG", "ROTATION"
"""Groups of parameters; each has `LABELS`, `UNITS` and a `RATE` in Hz."""

LABELS, UNITS, RATE = "LABELS", "UNITS", "RATE"

NOTES = "ML_DASH"
"""The group of this library: `RATE` as text, for the others have it as float32, and `NOTE` in pieces."""
NOTE = "NOTE"
NOTE_PIECE = 120
"""How long a piece is; a parameter's text has at most 255 letters."""

MOST_FRAMES = 65_535
"""Frames are counted in 16 bits."""
