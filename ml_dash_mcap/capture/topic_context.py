"""What all topics of a recorder share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from ..codecs.given.given_schema import GivenSchema
from ..timestamps import Stamper
from .channels import ChannelInfo
from .journal import Journal


class TopicOwner(Protocol):
    """The part of a recorder that its topics use. A topic keeps its recorder alive."""

    path: Path

    @property
    def closed(self) -> bool:
        """Whether the recorder takes no more rows."""

    def time(self) -> float:
        """Return the recording's time now, in seconds."""

    def flush(self) -> None:
        """Wait until every row taken so far is in the file."""


@dataclass(frozen=True, slots=True)
class TopicContext:
    """The recorder, journal and time rule that all topics of a recorder share."""

    recorder: TopicOwner
    journal: Journal
    """Where the rows go."""
    stamper: Stamper
    """The rule for missing and inherited time stamps."""
    give_schema: Callable[[ChannelInfo, GivenSchema], ChannelInfo]
    """Registers a channel with a schema in the place of one without rows."""
