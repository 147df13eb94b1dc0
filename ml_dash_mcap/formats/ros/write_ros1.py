"""A recording as a ROS 1 bag, with the package that defines our messages in a folder beside it."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from ...errors import ConversionWarning, OptionError
from ..destination import fresh_file, fresh_folder, refuse_existing
from ..export_job import Job, Steps
from . import carry_out
from .bag_plan import Settings
from .bag_ros1.write import COMPRESSORS, Storage
from .rows_out import MisfitError, Outgoing, packed, write_package


def export(
    job: Job,
    *,
    profile: str = "std+lossless",
    mapping: Mapping[str, Any] | None = None,
    time_offset: float = 0.0,
    compression: str = "none",
    package: str = "ml_dash_msgs",
    frame_id: str = "",
    tf: bool = False,
    on_bad: str = "raise",
    embed_images: bool | str | Path = False,
) -> Path:
    """Write a ROS 1 bag, and `<name>_interfaces/<package>` beside it.

    Args:
        job: What, and where to.
        profile: "std+lossless": a message of its own for each topic, and standard messages where they fit; "std" and
            "lossless": only these; "json": each row as JSON.
        mapping: Topic to what its standard messages are, see docs/guides/ros.md; None for the conventions.
        time_offset: Added to all times, in s; rows come back with their own.
        compression: Of the bag's chunks: "none", "bz2" or "lz4".
        package: What the package of our messages is called.
        frame_id: Of topics whose metadata has none.
        tf: Whether to send the first pose of each topic on `/tf` too.
        on_bad: What a row does that a standard message cannot say: "raise", or "lossless" to leave it out of that
            message with a warning.
        embed_images: Whether a field that holds the path of a JPEG or PNG file becomes a message with the image, or
            the folder that its paths begin at; False leaves paths alone.

    Raises:
        OptionError: An option has a value that it cannot have.
        ConversionError: A row cannot be said; the message names it.
    """
    if compression not in COMPRESSORS:
        raise OptionError(f"compression={compression!r}: it must be one of {', '.join(map(repr, COMPRESSORS))}")
    settings = Settings(
        profile, mapping, time_offset, package, frame_id, tf, on_bad, True, Storage.room, True, embed_images
    )
    beside = job.dest.with_name(f"{job.dest.stem}_interfaces")
    if settings.profile != "std":
        refuse_existing(beside)
    with ExitStack() as stack:
        path = stack.enter_context(fresh_file(job.dest))
        names = carry_out.topics(job)
        carried = carry_out.Carried(job, names, carry_out.Origin(), is_ros1=True, time_offset=time_offset)
        carry_out.warn_of_beside(carried.files, "bags of ROS 1")
        outgoing = Outgoing(job.without(names), settings, carried)
        steps = Steps(job.counter())
        while True:
            try:
                _write(path, outgoing, compression, steps)
            except MisfitError:
                path.unlink(missing_ok=True)
                outgoing.widen()
                continue
            break
        if outgoing.own_messages:
            write_package(stack.enter_context(fresh_folder(beside)) / package, outgoing)
        steps.finish()
    return job.dest


def _has_time_0(sent: Any) -> bool:
    times = [one.times_ns for one in sent] if isinstance(sent, list) else [sent.times_ns]
    return any(bool((one == 0).any()) for one in times)


def _write(path: Path, outgoing: Outgoing, compression: str, steps: Steps) -> None:
    steps.begin()
    is_warned = False
    bag = Storage(path, outgoing.outlets, compression)
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
