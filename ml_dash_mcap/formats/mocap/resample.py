"""Resamples values at other times: linearly, along the shortest arc, or held."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from ...rows.interpolate import linear, slerp

Floats = npt.NDArray[np.float64]

How = Literal["linear", "slerp", "hold"]


def at(times: Floats, values: Floats, wanted: Floats, longest_gap_s: float, how: How) -> Floats:
    """Return values at other times; NaN where a gap is too long, and outside the samples.

    A sample with a number missing does not count; what lies around it is one gap.

    Args:
        times: Of the samples, ascending, [N], s.
        values: [N, k]; NaN where a number is missing.
        wanted: Where to, ascending, [M], s.
        longest_gap_s: Samples that are farther apart are not interpolated between, and not held longer.
        how: "slerp" takes quaternions, [N, 4].

    Returns:
        [M, k].
    """
    present = ~np.isnan(values).any(axis=1)
    times, values = times[present], values[present]
    placed = np.full((len(wanted), values.shape[1]), np.nan)
    if not len(times):
        return placed
    before = np.searchsorted(times, wanted, side="right") - 1
    after = np.minimum(before + 1, len(times) - 1)
    clipped = np.maximum(before, 0)
    # A sample at the wanted time is copied and not computed, so that it keeps all its bits.
    exact = (before >= 0) & (times[clipped] == wanted)
    placed[exact] = values[before[exact]]
    if how == "hold":
        near = (before >= 0) & (wanted - times[clipped] <= longest_gap_s)
        placed[near] = values[before[near]]
        return placed
    inside = ~exact & (before >= 0) & (after > before) & (times[after] - times[clipped] <= longest_gap_s)
    first, second = before[inside], after[inside]
    weights = (wanted[inside] - times[first]) / (times[second] - times[first])
    between = linear if how == "linear" else slerp
    placed[inside] = between(values[first], values[second], weights)
    return placed
