"""Motion capture CSV files: as OptiTrack's Motive lays them out, or as one wide table."""

from __future__ import annotations

from pathlib import Path

from ..export_job import Job
from .motive import write as motive
from .take_options import MocapWriteOptions
from .wide import write as wide


def export(job: Job, options: MocapWriteOptions) -> Path:
    """Write topics into one CSV file, on one clock.

    Args:
        job: What to export; its destination is the file.
        options: How to write it.
    """
    if options.layout == "wide":
        return wide.write(job, options)
    return motive.write(job, options)
