"""Accepts arguments under earlier names, with a warning that states the new name."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

from .errors import UsageError

Value = TypeVar("Value")

_FOLDER = str(Path(__file__).parent)


def take(call: str, old: Mapping[str, Value], now: Mapping[str, str]) -> dict[str, Value]:
    """Return arguments under the names that they have now.

    Args:
        call: What was called, such as "read()".
        old: Arguments under names that the call does not have.
        now: Old name to new name.

    Raises:
        UsageError: An argument never had that name; also a TypeError.
    """
    for name in old:
        if name not in now:
            raise UsageError(f"{call} got an unexpected keyword argument {name!r}")
        warnings.warn(f"{call}: {name}= is called {now[name]}= now", DeprecationWarning, stacklevel=_caller())
    return {now[name]: value for name, value in old.items()}


def _caller() -> int:
    """Return how many calls the user's own code lies above `take`, for `stacklevel`."""
    # How many calls of ours lie between differs by entry point, so the frames are counted until one outside the
    # package.
    level, frame = 2, sys._getframe(2)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_FOLDER):
        level, frame = level + 1, frame.f_back
    return level
