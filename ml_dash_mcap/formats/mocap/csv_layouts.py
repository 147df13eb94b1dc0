"""Motion capture CSV files: as OptiTrack's Motive lays them out, or as one wide table."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from ..export_job import Job
from .motive import write as motive
from .take_clock import Rate
from .take_options import TakeOptions, check, check_decimals
from .wide import write as wide


def export(
    job: Job,
    *,
    layout: Literal["motive", "wide"] = "motive",
    format_version: Literal["1.23", "1.25"] = "1.23",
    rate: Rate = None,
    length_units: Literal["m", "cm", "mm"] = "m",
    up: Literal["z", "y"] | None = None,
    decimals: int | None = None,
    joints: Literal["sto", "columns"] | None = "sto",
    canonical: bool = True,
    quat_order: Literal["xyzw", "wxyz"] | None = None,
    on_bad: Literal["raise", "missing"] = "raise",
) -> Path:
    """Write topics into one CSV file, on one clock.

    Args:
        job: What to export; its destination is the file.
        layout: "motive" has rigid bodies and markers, for whatever reads Motive's exports. "wide" has one column a
            number, for topics of any numbers, and `_ts` as its time.
        format_version: Of Motive; "1.25" has a row of parents.
        rate: Frames a second, or "median", to resample to. None for the rows as they are: they must be evenly spaced
            in Motive's layout.
        length_units: Of Motive's layout.
        up: Which axis points up in Motive's layout: "z" or "y". A topic is turned if another one does there, which its
            metadata says (`up`; "z" if it does not say). None turns nothing: what was recorded without a word of axes
            has z up in the file, and what came from a file with y up has y up again.
        decimals: How many each number has; None for as many as it needs to come back the same.
        joints: In Motive's layout, joint angles are in an OpenSim file `<name>.joints.sto` beside it, or columns (which
            strict readers refuse), or left out.
        canonical: Whether quaternions are negated to follow each other without jumps.
        quat_order: Of the recording's quaternions, if its metadata does not say it.
        on_bad: Whether a quaternion that is no rotation is an error, or a missing one.
    """
    check("layout", layout, ("motive", "wide"))
    check_decimals(decimals)
    if layout == "wide":
        return wide.write(job, rate, decimals)
    options = TakeOptions(rate, up, canonical, quat_order, on_bad)
    return motive.write(job, options, motive.Form(format_version, length_units, decimals, joints))
