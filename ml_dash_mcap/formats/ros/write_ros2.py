"""Writes a recording as a rosbag2 folder, with the package that defines our messages.

The folder holds MCAP or SQLite files and `metadata.yaml`.
"""

from __future__ import annotations

import functools
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

from ...codecs.ros.distros import METADATA_FILE
from ...file_names import SEGMENT_SUFFIX
from ...mcap.message import MessageBlock
from ..destination import fresh_folder
from ..export_job import Job, RestartableCounter
from . import carry_out
from .bag_mcap import write as bag_mcap
from .bag_metadata import qos_profiles, versions
from .bag_metadata.information import Description, FileContents
from .bag_options import Rosbag2WriteOptions
from .bag_plan import Outlet, Settings
from .bag_sqlite import write as bag_sqlite
from .bag_sqlite.layout import SUFFIX as SQLITE_SUFFIX
from .rows_out import MisfitError, Outgoing, Sent, packed, to_text, write_package

CUSTOM_KEY = "ml_dash"
"""The key of the metadata's `custom_data` under which an export describes itself for a later import."""


class _BagWriter(Protocol):
    @property
    def counts(self) -> dict[int, int]:
        """Messages so far, by the number of their outlet."""

    @property
    def start_ns(self) -> int:
        """Time of the first message, ns; 0 without messages."""

    @property
    def end_ns(self) -> int:
        """Time of the last message, ns; 0 without messages."""

    @property
    def size(self) -> int:
        """Bytes so far."""

    def write(self, sent: Sequence[Sent]) -> None:
        """Write messages."""

    def pack(self, block: MessageBlock) -> Any:
        """Prepare messages that are carried; threads may do this while others are written."""

    def write_packed(self, packed: Any) -> None:
        """Write what `pack` returned."""

    def finish(self, information: str) -> None:
        """Write the file's end."""

    def close(self) -> None:
        """Close the file, finished or not."""


def export(job: Job, options: Rosbag2WriteOptions) -> Path:
    """Write a rosbag2 folder.

    Args:
        job: What, and where to.
        options: How to write it.

    Raises:
        OptionError: An option has a value that it cannot have.
        ConversionError: A message cannot hold what a row has; the error names the row.
    """
    origin = carry_out.origin(job)
    storage, distro, split_bytes = options.storage, options.distro, options.split_bytes
    if distro is not None:
        version = versions.check_distro(distro)
    else:
        distro, version = versions.distro_of(origin.distro, origin.version)
    room = bag_mcap.McapBagWriter.room if storage == "mcap" else bag_sqlite.SqliteBagWriter.room
    settings = Settings.of(options, is_ros1=False, room=room, is_in_order=split_bytes is not None)
    qos = functools.partial(qos_profiles.offered, version=version)
    begin: Callable[[Path, Sequence[Outlet]], _BagWriter]
    if storage == "mcap":
        begin = functools.partial(
            bag_mcap.McapBagWriter, qos=qos, distro=distro, compression=options.compression or "zstd"
        )
    else:
        begin = functools.partial(bag_sqlite.SqliteBagWriter, qos=qos, distro=distro, version=version)
    with fresh_folder(job.dest) as folder:
        names = carry_out.topics(job)
        carried = carry_out.Carried(job, names, origin, time_offset=options.time_offset)
        if storage != "mcap":
            carry_out.warn_of_beside(carried.files, "SQLite; storage='mcap' keeps them")
        outgoing = Outgoing(job.without(names), settings, carried)
        steps = RestartableCounter(job.counter())
        while True:
            custom = {**origin.custom, **({CUSTOM_KEY: to_text(outgoing.about())} if outgoing.plans else {})}
            description = Description(version, storage, distro, custom)
            bag = _Bag(folder, job.dest.name, description, split_bytes, begin, outgoing)
            try:
                bag.fill(steps)
            except MisfitError:
                # The plan comes from the first block of each topic. A later row that does not fit means: plan from
                # all rows, write again.
                shutil.rmtree(folder)
                folder.mkdir()
                outgoing.widen()
                continue
            break
        steps.finish()
        write_package(folder / options.package, outgoing)
    return job.dest


class _Bag:
    """The files of one bag."""

    def __init__(
        self,
        folder: Path,
        name: str,
        description: Description,
        split_bytes: int | None,
        begin: Callable[[Path, Sequence[Outlet]], _BagWriter],
        outgoing: Outgoing,
    ) -> None:
        self._folder = folder
        self._name = name
        self._description = description
        self._suffix = SEGMENT_SUFFIX if description.storage == "mcap" else SQLITE_SUFFIX
        self._split_bytes = split_bytes
        self._begin = begin
        self._outgoing = outgoing
        self._files: list[FileContents] = []

    def fill(self, steps: RestartableCounter) -> None:
        """Write all messages, and the metadata."""
        steps.begin()
        file = self._next()
        try:
            for rows, sent in packed(self._outgoing.messages(), file.pack, is_split=self._split_bytes is not None):
                if not rows:
                    self._finish(file)
                    file = self._next()
                    continue
                if isinstance(sent, list):
                    file.write(sent)
                else:
                    file.write_packed(sent)
                steps.add(rows)
                if self._split_bytes is not None and file.size >= self._split_bytes:
                    self._outgoing.finish_up()
            if isinstance(file, bag_mcap.McapBagWriter):
                file.add_beside(self._outgoing.carried_files)
            self._finish(file)
        finally:
            file.close()
        text = self._description.text(self._outgoing.outlets, self._files)
        (self._folder / METADATA_FILE).write_text(text, encoding="utf-8")

    def _next(self) -> _BagWriter:
        return self._begin(self._folder / self._file_name(), self._outgoing.outlets)

    def _file_name(self) -> str:
        return f"{self._name}_{len(self._files)}{self._suffix}"

    def _finish(self, file: _BagWriter) -> None:
        contents = FileContents(self._file_name(), dict(file.counts), file.start_ns, file.end_ns)
        file.finish(self._description.text_of_file(self._outgoing.outlets, contents))
        self._files.append(contents)
