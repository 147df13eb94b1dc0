"""Interpolates between two samples: along a line, and for quaternions along the shortest arc."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


def linear(before: Floats, after: Floats, weight: Floats) -> Floats:
    """Return the values on the straight line between two, element by element, and never beyond them.

    Args:
        before: [N, ...].
        after: [N, ...].
        weight: How far on the way, [N]: 0 gives `before`, bit for bit, and 1 `after`.
    """
    along = weight.reshape(-1, *[1] * (before.ndim - 1))
    with np.errstate(invalid="ignore", over="ignore"):
        step = after - before
        between = before + step * along  # of two equal values, exactly that value
        weighed = before * (1 - along) + after * along  # where the step is infinite
    between = np.where(np.isfinite(step), between, weighed)
    between = np.clip(between, np.minimum(before, after), np.maximum(before, after))  # rounding may lead beyond
    return np.where(along == 0, before, np.where(along == 1, after, between))


def slerp(before: Floats, after: Floats, weight: Floats) -> Floats:
    """Return the rotations on the shortest way between two, at a steady angular speed.

    A quaternion and its negative are the same rotation: where two point away from each other, the second one is
    negated, so that the way is the short one. It makes no difference whether the real part comes first or last.
    (Shoemake, Animating rotation with quaternion curves, 1985.)

    Args:
        before: Quaternions, [N, 4], of any length above 0.
        after: The same.
        weight: How far on the way, [N], from 0 to 1.

    Returns:
        Unit quaternions, [N, 4]; at weight 0 `before` and at weight 1 `after` as they were given. NaN where one of the
        two has no direction: length 0, or an element that is not finite.
    """
    first, second = _unit(before), _unit(after)
    second = np.where(np.sum(first * second, axis=1, keepdims=True) < 0, -second, second)
    angle = 2 * np.arctan2(_length(second - first), _length(second + first))  # exact where arccos(dot) is not
    is_close = angle < 1e-8  # there, the sines are the angles themselves
    sine = np.where(is_close, 1.0, np.sin(angle))
    along = weight[:, None]
    from_first = np.where(is_close, 1 - along, np.sin((1 - along) * angle) / sine)
    from_second = np.where(is_close, along, np.sin(along * angle) / sine)
    between = _unit(from_first * first + from_second * second)
    return np.where(along == 0, before, np.where(along == 1, after, between))


def _unit(quaternions: Floats) -> Floats:
    with np.errstate(all="ignore"):
        scaled = quaternions / np.max(np.abs(quaternions), axis=1, keepdims=True)  # or squares would overflow
        unit: Floats = scaled / _length(scaled)
        return unit


def _length(vectors: Floats) -> Floats:
    length: Floats = np.sqrt(np.sum(vectors * vectors, axis=1, keepdims=True))
    return length
