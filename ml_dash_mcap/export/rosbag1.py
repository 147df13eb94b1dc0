"""A recording as a ROS 1 bag, with the package that defines our messages in a folder beside it."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import lz4.frame
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Writer

from ..errors import ConversionWarning, OptionError
from .bag_plan import Settings
from .bag_topics import MisfitError, Outgoing, Sent, write_package
from .destination import fresh_file, fresh_folder, refuse_existing
from .job import Job, Steps

COMPRESSIONS = ("none", "bz2", "lz4")


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
    if compression not in COMPRESSIONS:
        raise OptionError(f"compression={compression!r}: it must be one of {', '.join(map(repr, COMPRESSIONS))}")
    settings = Settings(
        profile, mapping, time_offset, package, frame_id, tf, on_bad, is_ros1=True, embed_images=embed_images
    )
    beside = job.dest.with_name(f"{job.dest.stem}_interfaces")
    if settings.profile != "std":
        refuse_existing(beside)
    with ExitStack() as stack:
        path = stack.enter_context(fresh_file(job.dest))
        outgoing = Outgoing(job, settings)
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


def _write(path: Path, outgoing: Outgoing, compression: str, steps: Steps) -> None:
    writer = Writer(path)
    if compression != "none":
        writer.set_compression(Writer.CompressionFormat[compression.upper()])
    if compression == "lz4":
        writer.compressor = _lz4
    steps.begin()
    is_warned = False
    with writer:
        connections = {
            outlet.number: writer.add_connection(outlet.topic, outlet.type, msgdef=outlet.text, md5sum=outlet.digest)
            for outlet in outgoing.outlets
        }
        for rows, sent in outgoing.messages():
            _put(writer, connections, sent)
            steps.add(rows)
            if not is_warned and any(one.times_ns[0] == 0 for one in sent if len(one.times_ns)):
                is_warned = True
                warnings.warn(
                    "there are messages at time 0, which roscpp takes for no time; pass time_offset= to move them",
                    ConversionWarning,
                    stacklevel=2,
                )


def _put(writer: Writer, connections: Mapping[int, Connection], sent: Sequence[Sent]) -> None:
    found = [
        (time, one.outlet.number, data)
        for one in sent
        for time, data in zip(one.times_ns.tolist(), one.packed.messages(), strict=True)
    ]
    if len(sent) > 1:
        found.sort(key=lambda message: message[:2])
    for time, number, data in found:
        writer.write(connections[number], time, data)


def _lz4(data: bytes) -> bytes:
    """Compress a chunk as ROS 1 reads it: without its size, in blocks that do not need each other, with a checksum."""
    return bytes(lz4.frame.compress(data, store_size=False, block_linked=False, content_checksum=True))
