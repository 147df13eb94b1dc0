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
    """What the `ml_dash` metadata record of each segment holds: `prefix`, `run`, `run_start`, `host`, `library`."""


class Sink(Protocol):
    """Takes the rows of a recording while it is made, a block at a time.

    The file is a sink, and so is whatever is passed as `Recorder(sinks=[...])`: a live view, an uploader, a counter.
    Each of the latter has a thread of its own, on which its three methods are called one after the other. It may be as
    slow as it likes and may raise: neither holds up the control loop, the file, or the other sinks. Blocks that it has
    no time for are left out and counted in `Recorder.stats()`.

    What it computes in Python shares the interpreter with the control loop, as everything in this process does. What
    needs much of it belongs in a process of its own.
    """

    def open(self, session: SessionInfo) -> None:
        """Begin. If this raises, the sink gets no block, and is not closed."""

    def write(self, block: PreparedBlock) -> None:
        """Take a block, whose rows are in the file already. The block is valid until this returns."""

    def close(self) -> None:
        """End: the recorder is closed. It waits for this, but not for long."""
