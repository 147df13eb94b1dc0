"""Finds gaps in a topic: places where the times of its rows are too far apart."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import clock
from ..errors import RangeError
from ..query.stored_topic import StoredTopic

USUAL_FACTOR = 1.5
"""A spacing above so many times the median is a gap."""


@dataclass(frozen=True, slots=True)
class Gap:
    """Two rows that follow each other too far apart."""

    start: float
    """Time of the row before it, in s, to the nanosecond."""
    end: float
    """Time of the row after it, in s."""
    missing: int
    """How many rows would have been between them at the median spacing, rounded."""

    @property
    def duration(self) -> float:
        """From the row before it to the row after it, in s."""
        return self.end - self.start


def find(topic: StoredTopic, longer_than_s: Any = None) -> list[Gap]:
    """Return a topic's gaps, in time order; looks at the message indexes only.

    Args:
        topic: The topic.
        longer_than_s: The longest spacing that is no gap, in s; 1.5 times the median spacing by default.

    Raises:
        RangeError: `longer_than_s` is not a number above 0.
    """
    longer_than_ns = None if longer_than_s is None else _check(longer_than_s) * clock.NS_PER_S
    times_ns = np.unique(topic.times())
    return among(times_ns, longer_than_ns)


def among(times_ns: npt.NDArray[np.uint64], longer_than_ns: float | None = None) -> list[Gap]:
    """Return the gaps among times, which are in order and each there once, [N]."""
    spacings = np.diff(times_ns)
    usual_ns = usual(spacings)
    limit = USUAL_FACTOR * usual_ns if longer_than_ns is None else longer_than_ns
    return [
        Gap(
            clock.to_seconds(int(times_ns[at])),
            clock.to_seconds(int(times_ns[at + 1])),
            max(round(int(spacings[at]) / usual_ns) - 1, 0),
        )
        for at in np.flatnonzero(spacings > limit).tolist()
    ]


def usual(spacings: npt.NDArray[np.uint64]) -> float:
    """Return the median of some spacings, in ns; 0 without any."""
    return float(np.median(spacings)) if len(spacings) else 0.0


def _check(longer_than_s: Any) -> float:
    try:
        seconds = float(longer_than_s)
    except (TypeError, ValueError) as error:
        raise RangeError(f"longer_than_s={longer_than_s!r} is not a number of seconds") from error
    if not seconds > 0:
        raise RangeError(f"longer_than_s={longer_than_s!r}: a gap is longer than some time above 0")
    return seconds
