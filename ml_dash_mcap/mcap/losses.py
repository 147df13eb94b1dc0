"""The losses of one file: what could not be read because of damage."""

from __future__ import annotations

import threading
from collections.abc import Hashable
from dataclasses import dataclass, replace
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Loss:
    """Something that could not be read."""

    path: Path
    """The file; in a store, its name as a PurePosixPath."""
    offset: int
    """The place of the damage in the file, in bytes from its start."""
    what: str
    """The damage, in words."""
    messages: int | None
    """How many messages are known to be lost; None where that is not known."""
    corrected: bool = False
    """Whether nothing is lost: an index or the statistics were wrong, and were corrected by the data."""

    def __str__(self) -> str:
        """Return the file, the place in it and what is wrong there."""
        return f"{self.path}, byte {self.offset}: {self.what}"


class Losses:
    """The losses of one file so far. Any thread may add."""

    def __init__(self) -> None:
        """Begin with nothing lost."""
        self._lock = threading.Lock()
        """Guards `_found`."""
        self._found: dict[Hashable, Loss] = {}
        self._members: dict[Hashable, set[int]] = {}
        """For losses that are counted message by message, the keys of the messages."""

    def add(self, key: Hashable, loss: Loss) -> None:
        """Note a loss once.

        Args:
            key: Tells it from the others, however often it is met.
            loss: The loss.
        """
        with self._lock:
            self._found.setdefault(key, loss)

    def note(self, path: str | Path, offset: int, what: str, key: Hashable = None) -> None:
        """Note a fault of an index or of the statistics once: nothing is lost.

        Args:
            path: The file.
            offset: The place of the fault, or of the record that it is about.
            what: The fault, in words.
            key: A key that no other fault at the same place has; `what` by default.
        """
        self.add((offset, key or what), Loss(Path(path), offset, what, 0, corrected=True))

    def add_message(self, key: Hashable, message: int, loss: Loss) -> None:
        """Note once that a message is lost. All messages of one key are one loss.

        Args:
            key: Tells the loss from others.
            message: Tells the message from others.
            loss: The loss; the description of the first message stays.
        """
        with self._lock:
            members = self._members.setdefault(key, set())
            members.add(message)
            self._found[key] = replace(self._found.get(key, loss), messages=len(members))

    def all(self) -> list[Loss]:
        """Return all losses, sorted by their places in the file."""
        with self._lock:
            return sorted(self._found.values(), key=lambda loss: loss.offset)

    def clear(self) -> None:
        """Forget everything: the file is another one now."""
        with self._lock:
            self._found.clear()
            self._members.clear()
