"""What damage took from a file."""

from __future__ import annotations

import threading
from collections.abc import Hashable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Loss:
    """Something that could not be read."""

    path: Path
    """The file."""
    offset: int
    """Where in it the trouble was found, in bytes from its start."""
    what: str
    """What is wrong, in words."""
    messages: int | None
    """How many messages are known to be lost; None where nobody knows."""


class Losses:
    """What was found lost in one file so far. Any thread may add."""

    def __init__(self) -> None:
        """Begin with nothing lost."""
        self._lock = threading.Lock()
        """Guards `_found`."""
        self._found: dict[Hashable, Loss] = {}

    def add(self, key: Hashable, loss: Loss) -> None:
        """Note a loss once.

        Args:
            key: Tells it from the others, however often it is met.
            loss: What is lost.
        """
        with self._lock:
            self._found.setdefault(key, loss)

    def all(self) -> list[Loss]:
        """Return what was noted, by where it lies."""
        with self._lock:
            return sorted(self._found.values(), key=lambda loss: loss.offset)

    def clear(self) -> None:
        """Forget everything: the file is another one now."""
        with self._lock:
            self._found.clear()
