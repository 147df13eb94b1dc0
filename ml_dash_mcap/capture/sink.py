"""The protocol of a sink, which takes the rows of a recording beside its file, and what a sink is told."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from .prepared_block import PreparedBlock


@dataclass(frozen=True, slots=True)
class SessionInfo:
    """One opening of a recording by a recorder."""

    folder: Path
    """The run's folder."""
    about: Mapping[str, str]
    """The content of the `ml_dash` metadata record of each segment: `prefix`, `run`, `run_start`, `host`, `library`.
    And `stamp`, with which the names of the session's segments begin."""


class Sink(Protocol):
    """Takes the rows of a recording while it is made, a block at a time.

    The file is a sink, and so are the objects that are passed as `Recorder(sinks=[...])`: a live view, an uploader, a
    counter. Each of these objects has a thread of its own, which calls its three methods one after the other. It may be
    slow and may raise: neither holds up the control loop, the file, or the other sinks. Blocks that it has no time for
    are left out and counted in `Recorder.stats()`.

    A sink's Python code shares the interpreter with the control loop, as all code in this process does. Work that needs
    much of the interpreter belongs in a process of its own.
    """

    def open(self, session: SessionInfo) -> None:
        """Begin. If this method raises, the sink gets no block, and is not closed."""

    def write(self, block: PreparedBlock) -> None:
        """Take a block, whose rows are in the file already. The block is valid until this method returns."""

    def close(self) -> None:
        """End: the recorder is closed. It waits for this method, but not for long."""
