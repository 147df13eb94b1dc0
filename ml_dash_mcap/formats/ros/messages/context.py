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
    """What a field says of a detail."""

    is_there: npt.NDArray[np.bool_]
    """Which of the rows have it, [N]."""
    values: Any
    """Of the rows, [N]; anything where it is not there."""


class Context(NamedTuple):
    """What the columns of a message are made with."""

    derived: Derived
    rows: Indices
    """Which of the rows have all fields, [N]."""
    times: npt.NDArray[np.float64]
    """Time stamps of all rows, in s, for the error messages."""
    header: Mapping[str, Column]
    """Of the messages, [N]."""
    load: Load | None = None
    """Where images are embedded."""
    details: Mapping[str, Stated] = {}
    """What fields say of the message's details."""


class BadRows(NamedTuple):
    """Rows whose values a standard message cannot say."""

    which: npt.NDArray[np.bool_]
    """Of those that have all fields, [N]."""
    what: str
    """Of the first one."""
    is_other: bool = False
    """Whether they are of another kind altogether, so that a convention was wrong about the field."""
