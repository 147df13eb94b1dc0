"""The names of the segments of one session: `<stamp>_<number>.mcap`, so that names sort in the order of writing."""

from __future__ import annotations

import datetime
from pathlib import Path

from ..file_names import ACTIVE_SUFFIX, SEGMENT_SUFFIX

STAMP = "stamp"
"""The key under which a session file has the first part of the names of its session's segments."""


def segment_path(folder: Path, stamp: str, number: int) -> Path:
    """Return the path of a session's segment of a number, from 1."""
    return folder / f"{stamp}_{number:06d}{SEGMENT_SUFFIX}"


def stamp_after(folder: Path) -> str:
    """Return now, in UTC, as the first part of a segment's name; never before a name that the folder has already.

    Segments are read in the order of their names, and a robot's clock may have been reset since the last run.
    """
    now = datetime.datetime.now(datetime.timezone.utc).strftime("%Y%m%dT%H%M%S.%fZ")
    names = [
        path.name
        for pattern in (f"*{SEGMENT_SUFFIX}", f"*{SEGMENT_SUFFIX}{ACTIVE_SUFFIX}")
        for path in folder.glob(pattern)
    ]
    stamps = [name.split("_")[0] for name in names if name.split("_")[0].endswith("Z")]
    return max([now, *stamps])
