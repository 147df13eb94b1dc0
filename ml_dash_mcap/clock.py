"""Converts seconds (a double, as users give them) to nanoseconds (an integer, as MCAP stores them) and back."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

NS_PER_S = 1_000_000_000

END_S = 9_223_372_036.0
"""The first time stamp that is refused, in seconds (year 2262): nanoseconds that a signed 64-bit integer holds, as most
readers of MCAP take them."""

EPOCH_LIKE_S = 100_000_000.0
"""Time stamps from here on (March 1973, in seconds) are taken for wall-clock time, earlier ones for a clock that starts
near 0."""


def to_nanoseconds(seconds: float) -> int:
    """Round a time stamp to nanoseconds.

    The whole seconds are split off first: `seconds * 1e9` would be off by up to 128 ns at today's epoch times.

    Args:
        seconds: A finite time stamp with 0 <= seconds < `END_S`.
    """
    whole = int(seconds)
    return whole * NS_PER_S + int((seconds - whole) * 1e9 + 0.5)


def to_nanoseconds_each(seconds: npt.NDArray[np.float64]) -> npt.NDArray[np.uint64]:
    """Round time stamps to nanoseconds as `to_nanoseconds` does, [N].

    Args:
        seconds: Each a finite time stamp with 0 <= seconds < 2**64 / 1e9.
    """
    whole = seconds.astype("uint64")
    part = (seconds - whole) * 1e9 + 0.5
    nanoseconds: npt.NDArray[np.uint64] = whole * whole.dtype.type(NS_PER_S) + part.astype("uint64")
    return nanoseconds


def to_seconds(nanoseconds: int) -> float:
    """Return the double nearest to a time in nanoseconds."""
    return nanoseconds / NS_PER_S


def to_seconds_each(nanoseconds: Iterable[int]) -> list[float]:
    """Return the doubles nearest to times in nanoseconds; numpy would round twice beyond 2**53 ns (104 days)."""
    return [time / NS_PER_S for time in nanoseconds]


def sec_nsec(nanoseconds: int) -> dict[str, int]:
    """Split a time into the `{"sec", "nsec"}` pair that Foxglove's JSON schemas use for times."""
    sec, nsec = divmod(nanoseconds, NS_PER_S)
    return {"sec": sec, "nsec": nsec}


def is_epoch_like(seconds: float) -> bool:
    """Whether a time stamp looks like wall-clock time rather than a clock that starts near 0."""
    return seconds >= EPOCH_LIKE_S
