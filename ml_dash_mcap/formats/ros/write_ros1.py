"""Writes a recording as a ROS 1 bag, with the package that defines our messages in a folder beside it."""

from __future__ import annotations

import warnings
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from ...errors import ConversionWarning
from ..destination import fresh_file, fresh_folder, refuse_existing
from ..export_job import Job, RestartableCounter
from . import carry_out
from .bag_options import Rosbag1WriteOptions
from .bag_plan import Settings
from .bag_ros1.write import Ros1BagWriter
from .rows_out import MisfitError, Outgoing, packed, write_package


def export(job: Job, options: Rosbag1WriteOptions) -> Path:
    """Write a ROS 1 bag, and `<name>_interfaces/<package>` beside it.

    Args:
        job: What, and where to.
        options: How to write it.

    Raises:
        OptionError: An option has a value that it cannot have.
        ConversionError: A message cannot hold what a row has; the error names the row.
    """
    settings = Settings.of(options, is_ros1=True, room=Ros1BagWriter.room, is_in_order=True)
    beside = job.dest.with_name(f"{job.dest.stem}_interfaces")
    if settings.profile != "std":
        refuse_existing(beside)
    with ExitStack() as stack:
        path = stack.enter_context(fresh_file(job.dest))
        names = carry_out.topics(job)
        carried = carry_out.Carried(job, names, carry_out.BagOrigin(), is_ros1=True, time_offset=options.time_offset)
        carry_out.warn_of_beside(carried.files, "bags of ROS 1")
        outgoing = Outgoing(job.without(names), settings, carried)
        steps = RestartableCounter(job.counter())
        while True:
            try:
                _write(path, outgoing, options.compression, steps)
            except MisfitError:
                # The plan comes from the first block of each topic. A later row that does not fit means: plan from
                # all rows, write again.
                path.unlink(missing_ok=True)
                outgoing.widen()
                continue
            break
        if outgoing.own_messages:
            write_package(stack.enter_context(fresh_folder(beside)) / options.package, outgoing)
        steps.finish()
    return job.dest


def _has_time_0(sent: Any) -> bool:
    times = [messages.times_ns for messages in sent] if isinstance(sent, list) else [sent.times_ns]
    return any(bool((times_ns == 0).any()) for times_ns in times)


def _write(path: Path, outgoing: Outgoing, compression: str, steps: RestartableCounter) -> None:
    steps.begin()
    is_warned = False
    bag = Ros1BagWriter(path, outgoing.outlets, compression)
    try:
        for rows, sent in packed(outgoing.messages(), bag.pack):
            if isinstance(sent, list):
                bag.write(sent)
            else:
                bag.write_packed(sent)
            steps.add(rows)
            if not is_warned and _has_time_0(sent):
                is_warned = True
                warnings.warn(
                    "there are messages at time 0, which roscpp takes for no time; pass time_offset= to move them",
                    ConversionWarning,
                    stacklevel=2,
                )
        bag.finish()
    finally:
        bag.close()
