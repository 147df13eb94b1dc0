"""Writes OpenSim storage files: joint angles and other numbers by time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ....errors import ConversionError
from ....meaning.mocap_objects import Joint
from ....meaning.units import angle_unit
from ...destination import fresh_file, refuse_existing
from ...export_job import Job
from .. import take_clock as rates
from ..placement import Note, Placing, to_text
from ..table_text import TableText
from ..take import OutgoingTake
from ..take_contents import every_number, found_in
from ..take_options import StoWriteOptions, TakeOptions
from . import layout


def export(job: Job, options: StoWriteOptions) -> Path:
    """Write joint angles, speeds, efforts and grippers into one .sto file.

    Rows without a number that others have are left out, for OpenSim stops reading there. Angles are in radians, unless
    the topic's metadata says degrees.

    Args:
        job: What to export; its destination is the file.
        options: How to write it.
    """
    refuse_existing(job.dest)
    if options.what == "all":
        joints = [number for topic in job.topics for number in every_number(job, topic)]
    else:
        joints = [joint for objects in found_in(job, None).values() for joint in objects.joints]
    if not joints:
        names = ", ".join(map(repr, job.topics)) or "none"
        raise ConversionError(f"no joints in the topics ({names}): none has q, dq, tau or the like; pass what='all'")
    with fresh_file(job.dest) as path:
        write(job, joints, options, path, decimals=options.decimals)
    return job.dest


def write(
    job: Job,
    joints: Sequence[Joint],
    options: TakeOptions,
    path: Path,
    *,
    with_origin: Iterable[str] = (),
    decimals: int | None = None,
) -> None:
    """Write numbers to a path.

    Args:
        job: Where they come from.
        joints: The columns.
        options: At which rate.
        path: Where to.
        with_origin: Topics that are written to another file with the same origin.
        decimals: Of each number.
    """
    topics = dict.fromkeys(joint.topic for joint in joints)
    clock = rates.find(job, topics, options.rate, needs_even=False, with_origin=with_origin)
    take = OutgoingTake(job, options, list(joints), clock)
    labels = [f"{joint.topic}/{joint.name}" if len(topics) > 1 else joint.name for joint in joints]
    labels = [label.replace("\t", " ").replace("\n", " ") for label in labels]
    in_degrees = "yes" if _are_degrees(job, joints) else "no"
    placing = Placing()
    for at, joint in enumerate(joints):
        placing.add(joint, {"value": [at]})
    metadata = {topic: job.topics[topic].metadata for topic in topics}
    note = to_text(Note(clock.origin, placements=placing.placements(), metadata=metadata))
    text = TableText(separator="\t", end="\n", decimals=decimals, time_decimals=clock.time_decimals(decimals))
    count = 0
    with path.open("w+b") as file:
        file.write(f"Coordinates\n{layout.VERSION}=1\n{layout.ROWS}=".encode())
        at_count = file.tell()
        pairs = {layout.COLUMNS: len(joints) + 1, layout.IN_DEGREES: in_degrees, layout.NOTE: note}
        # The number of rows comes first and is known last: room for 20 digits is overwritten at the end.
        lines = [f"{0:20d}", *(f"{key}={value}" for key, value in pairs.items()), layout.END]
        file.write("\n".join([*lines, "\t".join((layout.TIME, *labels)), ""]).encode())
        for window in take.windows():
            whole = ~np.isnan(window.values).any(axis=1)
            count += int(whole.sum())
            file.write(text.rows(text.times(window.times[whole]), window.values[whole]))
        file.seek(at_count)
        file.write(b"%-20d" % count)


def _are_degrees(job: Job, joints: Sequence[Joint]) -> bool:
    """Whether angles are in degrees, as the topics' metadata says them; in radians if it does not.

    Raises:
        ConversionError: Some are in degrees, others in radians.
    """
    units = {_angle_unit(job.topics[joint.topic].metadata, joint.value.columns[0]) for joint in joints} - {None}
    if len(units) > 1:
        raise ConversionError("some joints are in degrees and some in radians; export them into files of their own")
    return units == {"deg"}


def _angle_unit(metadata: Mapping[str, Any], column: str) -> str | None:
    """Return "deg" or "rad" as a topic's metadata says a field's unit; None if it says neither."""
    stated = metadata.get("units")
    return angle_unit(str(stated.get(column) if isinstance(stated, Mapping) else stated))
