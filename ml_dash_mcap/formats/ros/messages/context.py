"""The input of the functions that make messages of rows, and the rows of which no message can be made."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ....codecs.ros.message_columns import Column, Indices
from .standard import Derived

Load = Callable[[str], bytes]
"""Returns the file at a path; raises a `ValueError` that says why there is none."""


class Stated(NamedTuple):
    """The values that a field states for a detail."""

    is_there: npt.NDArray[np.bool_]
    """Which of the rows have it, [N]."""
    values: Any
    """The values of the rows, [N]; undefined where `is_there` is False."""


class Context(NamedTuple):
    """The input for the columns of a message."""

    derived: Derived
    rows: Indices
    """Which of the rows have all fields, [N]."""
    times: npt.NDArray[np.float64]
    """Time stamps of all rows, in s, for the error messages."""
    header: Mapping[str, Column]
    """The header of the messages, [N]."""
    load: Load | None = None
    """Where images are embedded."""
    details: Mapping[str, Stated] = {}
    """The details of the message that fields state."""


class BadRows(NamedTuple):
    """Rows whose values a standard message cannot say."""

    which: npt.NDArray[np.bool_]
    """A mask over the rows that have all fields, [N]."""
    what: str
    """A description of the first bad row."""
    is_other: bool = False
    """Whether they are of another kind altogether, so that a convention was wrong about the field."""
