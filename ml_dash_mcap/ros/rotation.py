"""Rotations as ROS has them: unit quaternions x y z w."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

NORM_TOLERANCE = 1e-2
ORTHONORMAL_TOLERANCE = 1e-3


def to_xyzw(quaternions: Floats, order: str) -> Floats:
    """Return quaternions, [N, 4], in the order x y z w.

    Args:
        quaternions: In the other order, or the same.
        order: "xyzw" or "wxyz".
    """
    return quaternions if order == "xyzw" else quaternions[:, [1, 2, 3, 0]]


def of_matrices(matrices: Floats) -> Floats:
    """Return the quaternions, [N, 4], x y z w with w >= 0, of rotation matrices, [N, 3, 3].

    The largest of the four components is found first, as in Shepperd 1978, so that no division is by a small number.
    """
    m = matrices
    trace = m[:, 0, 0] + m[:, 1, 1] + m[:, 2, 2]
    squares = np.stack([2 * m[:, 0, 0] - trace, 2 * m[:, 1, 1] - trace, 2 * m[:, 2, 2] - trace, trace], 1)
    largest = np.argmax(squares, 1)
    x, y, z = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]
    xy, xz, yz = m[:, 0, 1] + m[:, 1, 0], m[:, 0, 2] + m[:, 2, 0], m[:, 1, 2] + m[:, 2, 1]
    one = 1 + np.take_along_axis(squares, largest[:, None], 1)[:, 0]
    rows = np.stack(
        [
            np.stack([one, xy, xz, x], 1),
            np.stack([xy, one, yz, y], 1),
            np.stack([xz, yz, one, z], 1),
            np.stack([x, y, z, one], 1),
        ],
        1,
    )
    found: Floats = rows[np.arange(len(m)), largest]
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    found[found[:, 3] < 0] *= -1
    return found


def not_unit(quaternions: Floats) -> npt.NDArray[np.bool_]:
    """Tell which quaternions are no unit quaternions, [N]."""
    norms = np.sqrt((quaternions * quaternions).sum(1))
    bad: npt.NDArray[np.bool_] = ~(np.abs(norms - 1) <= NORM_TOLERANCE)
    return bad


def not_rotations(matrices: Floats) -> npt.NDArray[np.bool_]:
    """Tell which matrices, [N, 3, 3], are no rotations, [N]."""
    errors = np.abs(matrices @ matrices.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    with np.errstate(invalid="ignore"):
        bad: npt.NDArray[np.bool_] = ~((errors <= ORTHONORMAL_TOLERANCE) & (np.linalg.det(matrices) > 0))
    return bad
