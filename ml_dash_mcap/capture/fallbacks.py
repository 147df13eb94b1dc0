"""Counts how often the writer took a slower way because the fast way failed."""

from __future__ import annotations

import logging
from pathlib import Path

_log = logging.getLogger("ml_dash_mcap")


class Fallbacks:
    """Counts the failures that cost time but no row. Written by the writer thread, read by any."""

    def __init__(self, folder: Path) -> None:
        """Begin with none.

        Args:
            folder: The run's folder, for the log.
        """
        self.counts: dict[str, int] = {}
        """The number of failures of each fast way."""
        self._folder = folder

    def note(self, what: str, error: Exception, instead: str = "is done a slower way") -> None:
        """Count a failure of a fast way, and log the first failure of each kind. None of them may stop the writer.

        Args:
            what: The work that failed.
            error: Why.
            instead: How the work is done now.
        """
        if what not in self.counts:
            _log.warning(
                "%s failed in %s, and %s; stats()['fallbacks'] counts how often",
                *(what, self._folder, instead),
                exc_info=error,
            )
        self.counts[what] = self.counts.get(what, 0) + 1
