"""Tells how a block of code ended, by the exception that left it."""

from __future__ import annotations

from typing import Literal

Status = Literal["running", "completed", "failed", "cancelled"]
"""How a run stands."""


def status_by(error: BaseException | None) -> Status:
    """Return how a run ended whose body an exception left; None stands for no exception."""
    if error is None or (isinstance(error, SystemExit) and error.code in (None, 0)):
        return "completed"
    if isinstance(error, (Exception, SystemExit)):
        return "failed"
    return "cancelled"  # KeyboardInterrupt, asyncio's CancelledError, GeneratorExit: requests, not faults
