"""Accepts arguments under earlier names, with a warning that states the new name."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

from .errors import UsageError

Value = TypeVar("Value")

_RANGE = {"start_timestamp": "start", "end_timestamp": "end"}
"""Earlier names to those of now."""

_FOLDER = str(Path(__file__).parent)


def take_range(call: str, start: Value, end: Value, others: Mapping[str, Value]) -> tuple[Value, Value]:
    """Return a range whose ends may be given under their earlier names.

    Args:
        call: The method that was called, such as "TopicReader.read".
        start: What was given under the name that it has now.
        end: The same of the end.
        others: Arguments under names that the method does not have.

    Raises:
        UsageError: An argument never had that name, or is given under both; also a TypeError.
    """
    given = {"start": start, "end": end}
    for name, value in others.items():
        if name not in _RANGE:
            raise UsageError(f"{call}() got an unexpected keyword argument {name!r}")
        now = _RANGE[name]
        if given[now] is not None:
            raise UsageError(f"{call}() got both {now}= and {name}=, which is its earlier name; pass {now}= alone")
        warnings.warn(f"{call}(): {name}= is called {now}= now", DeprecationWarning, stacklevel=_caller())
        given[now] = value
    return given["start"], given["end"]


def _caller() -> int:
    """Return how many calls the user's own code lies above `take_range`, for `stacklevel`."""
    # How many calls of ours lie between differs by entry point, so the frames are counted until one outside the
    # package.
    level, frame = 2, sys._getframe(2)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_FOLDER):
        level, frame = level + 1, frame.f_back
    return level
