"""What the latest run in a folder says to the next one."""

from __future__ import annotations

from pathlib import Path

from .. import clock
from ..errors import RecorderError
from ..layout import SEGMENT_SUFFIX
from . import about, written
from .file import File


def simulated_until(folder: Path) -> float | None:
    """Return where the times of the latest run in a folder end, in s, if they are near 0; looks at its last file.

    The times of a simulation are likely to begin there again in the next run. Wall-clock times do not come again.
    """
    latest = max(folder.glob(f"*{SEGMENT_SUFFIX}"), default=None, key=lambda path: path.name)
    if latest is None:
        return None
    try:
        file = File(latest)
        try:
            ends = [end_ns for _, end_ns in about.spans([file])] if written.run_of(file) else []
        finally:
            file.close()
    except (RecorderError, OSError):  # whoever reads the file is told
        return None
    end_s = clock.to_seconds(max(ends, default=0))
    return end_s if ends and not clock.is_epoch_like(end_s) else None
