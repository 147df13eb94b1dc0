"""Annotations of a topic that other formats would have to guess: units, joints, frame, order of quaternions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..errors import FieldError

QUAT_ORDERS = ("xyzw", "wxyz")

NO_ANNOTATIONS = (None,) * 7
"""Description, tags, metadata, and the four below, where none is given."""


def collect(
    units: Mapping[str, str] | None = None,
    joint_names: Sequence[str] | None = None,
    frame_id: str | None = None,
    quat_order: str | None = None,
) -> dict[str, Any]:
    """Return those that are given, as a topic's metadata has them.

    Args:
        units: Dotted field name to its unit, such as `{"q": "rad", "mag": "uT"}`.
        joint_names: Of the elements of a topic's joint angles, velocities and torques, in their order.
        frame_id: The frame that the topic's positions, orientations and vectors are in.
        quat_order: "xyzw" or "wxyz": the order of all quaternions of the topic.

    Raises:
        FieldError: One of them is something else.
    """
    annotations: dict[str, Any] = {}
    if units is not None:
        if not isinstance(units, Mapping) or not all(isinstance(text, str) for pair in units.items() for text in pair):
            raise FieldError(f"units={units!r}: pass a dict of field names and units, such as {{'q': 'rad'}}")
        annotations["units"] = dict(units)
    if joint_names is not None:
        if isinstance(joint_names, str) or not all(isinstance(name, str) for name in joint_names):
            raise FieldError(f"joint_names={joint_names!r}: pass a list of names")
        annotations["joint_names"] = list(joint_names)
    if frame_id is not None:
        if not isinstance(frame_id, str):
            raise FieldError(f"frame_id={frame_id!r}: pass the name of a frame")
        annotations["frame_id"] = frame_id
    if quat_order is not None:
        if quat_order not in QUAT_ORDERS:
            raise FieldError(f"quat_order={quat_order!r}: it must be 'xyzw' or 'wxyz'")
        annotations["quat_order"] = quat_order
    return annotations
