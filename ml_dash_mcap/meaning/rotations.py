"""Rotations as ROS and motion capture write them: quaternions x y z w, of length 1, without jumps of sign."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

ORDERS = {"xyzw": (0, 1, 2, 3), "wxyz": (1, 2, 3, 0)}
"""Where x, y, z and w stand in each order."""

ORTHONORMAL_TOLERANCE = 1e-3
"""A rotation matrix times its transpose differs from the unit matrix by no more, in any element."""

FAR_FROM_ONE = 1e-2
"""A quaternion whose length differs from 1 by more is no rotation."""

CLOSE_TO_ONE = 1e-6
"""A quaternion whose length differs from 1 by no more is left as it is: Motive itself writes six decimals."""


def to_xyzw(quaternions: Floats, order: str) -> Floats:
    """Return quaternions [N, 4] of an order of `ORDERS` as x y z w."""
    return quaternions[:, list(ORDERS[order])]


def not_unit(quaternions: Floats) -> npt.NDArray[np.bool_]:
    """Tell which quaternions [N, 4] are far from length 1, [N]; missing ones, NaN, are not."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.abs(_length(quaternions) - 1) > FAR_FROM_ONE


def normalised(quaternions: Floats) -> Floats:
    """Return quaternions [N, 4] of length 1; those that have it to six decimals as they are."""
    length = _length(quaternions)
    with np.errstate(invalid="ignore", divide="ignore"):
        is_off = np.abs(length - 1) > CLOSE_TO_ONE
        return np.where(is_off[:, None], quaternions / length[:, None], quaternions)


def continuous(quaternions: Floats, last: Floats | None) -> tuple[Floats, Floats | None]:
    """Negate quaternions so that each is on the same side as the one before it.

    Args:
        quaternions: [N, 4]; NaN where one is missing.
        last: The one before them, [4].

    Returns:
        The quaternions, and the last one that is not missing.
    """
    present = np.flatnonzero(~np.isnan(quaternions).any(axis=1))
    if not len(present):
        return quaternions, last
    there = quaternions[present]
    before = np.concatenate((there[:1] if last is None else last[None], there[:-1]))
    # A flipped quaternion changes the side of all later ones, so the signs multiply along the way.
    signs = np.cumprod(np.where(np.sum(there * before, axis=1) < 0, -1.0, 1.0))
    flipped = np.flatnonzero(signs < 0)
    if len(flipped):
        quaternions = quaternions.copy()
        quaternions[present[flipped]] *= -1
        there = quaternions[present]
    return quaternions, there[-1]


def of_matrices(matrices: Floats) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Return the quaternions, x y z w, [N, 4], of rotation matrices [N, 3, 3].

    The largest of the four numbers is computed first, from the diagonal, and the others are divided by it.
    (Shepperd, Quaternion from rotation matrix, 1978.)

    Returns:
        The quaternions, NaN for a missing matrix, and which are no rotations, [N]: not orthonormal, or mirrored.
    """
    m = matrices
    with np.errstate(invalid="ignore"):
        product = m @ m.transpose(0, 2, 1)
        is_bad = (np.abs(product - np.eye(3)).max(axis=(1, 2)) > ORTHONORMAL_TOLERANCE) | (_determinant(m) < 0)
        trace = m[:, 0, 0] + m[:, 1, 1] + m[:, 2, 2]
        diagonal = np.diagonal(m, axis1=1, axis2=2)
        # The squares of 2x, 2y, 2z and 2w. Dividing by the largest of them never divides by a number near 0.
        squares = np.concatenate((1 - trace[:, None] + 2 * diagonal, 1 + trace[:, None]), axis=1)
        largest = np.nan_to_num(squares).argmax(axis=1)
        twice = np.sqrt(np.maximum(squares[np.arange(len(m)), largest], 0))
    off = {
        (0, 1): m[:, 1, 0] + m[:, 0, 1],
        (0, 2): m[:, 0, 2] + m[:, 2, 0],
        (1, 2): m[:, 2, 1] + m[:, 1, 2],
        (0, 3): m[:, 2, 1] - m[:, 1, 2],
        (1, 3): m[:, 0, 2] - m[:, 2, 0],
        (2, 3): m[:, 1, 0] - m[:, 0, 1],
    }
    quaternions = np.empty((len(m), 4))
    for first in range(4):
        rows = largest == first
        for second in range(4):
            if first == second:
                quaternions[rows, second] = twice[rows] / 2
            else:
                with np.errstate(invalid="ignore", divide="ignore"):
                    quaternions[rows, second] = off[(min(first, second), max(first, second))][rows] / (2 * twice[rows])
    return normalised(quaternions), is_bad & ~np.isnan(m).any(axis=(1, 2))


def _determinant(m: Floats) -> Floats:
    determinant: Floats = np.sum(m[:, 0] * np.cross(m[:, 1], m[:, 2]), axis=1)
    return determinant


def _length(quaternions: Floats) -> Floats:
    length: Floats = np.sqrt(np.sum(quaternions * quaternions, axis=1))
    return length


def to_matrices(quaternions: Floats) -> Floats:
    """Return the rotation matrices, [N, 3, 3], of unit quaternions x y z w, [N, 4]."""
    x, y, z, w = quaternions.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)
