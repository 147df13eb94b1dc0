"""Recognises fields by name and shape: one table for ROS, motion capture and viewers.

The annotations of a topic (`units`, `quat_order`, `joint_names`, `frame_id`) say how its numbers are to be read. Names
say what they are: `tcp_pos` and `tcp_quat` are the pose of `tcp` in every format that has poses.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

Shape = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class FieldMeaning:
    """A kind of field: all fields that measure the same quantity."""

    names: tuple[str, ...]
    """The names of such fields in lower case, the likeliest first. Capitals in a field's name do not matter."""
    quantity: str | tuple[str, str] | None = None
    """The quantity that they measure, a key of `units.UNITS`; or the quantities of the two halves of the numbers."""
    shapes: tuple[Shape, ...] = ()
    """The shapes that they have; none where any list of numbers is one."""
    has_owner: bool = False
    """Whether the name of what they belong to may stand before theirs, as in `tcp_pos`."""

    def of(self, owner: str) -> tuple[str, ...]:
        """Return what the fields of an owner are called."""
        return tuple(f"{owner}_{name}" for name in self.names) if owner else self.names


POSITION = FieldMeaning(("pos", "position", "xyz", "translation", "trans"), "length", ((3,),), has_owner=True)
ORIENTATION = FieldMeaning(("quat", "orientation", "quaternion", "rotation", "rot"), None, ((4,),), has_owner=True)
POSE = FieldMeaning(("pose", "transform"), "length", ((4, 4), (16,), (7,)), has_owner=True)
"""A 4x4 matrix, also as 16 numbers row by row; or a position and a quaternion."""

JOINT_POSITION = FieldMeaning(
    ("q", "qpos", "joint_pos", "joint_position", "joint_positions", "joint_angle", "joint_angles", "joints"), "angle"
)
JOINT_VELOCITY = FieldMeaning(
    ("qd", "dq", "qvel", "joint_vel", "joint_velocity", "joint_velocities", "joint_speed", "joint_speeds"),
    "angular velocity",
)
JOINT_EFFORT = FieldMeaning(
    ("tau", "effort", "joint_torque", "joint_torques", "torques", "efforts", "joint_effort", "joint_efforts"), "torque"
)
NAMED_POSITION = FieldMeaning(("position", "positions"), "angle")
NAMED_VELOCITY = FieldMeaning(("velocity", "velocities"), "angular velocity")
NAMED_EFFORT = FieldMeaning(("effort", "efforts"), "torque")
"""Names that mean joints only if the joints' names are given, and something else without them."""
JOINT_COMMAND = FieldMeaning(("target_q", "q_des", "q_cmd"), "angle")
GRIPPER = FieldMeaning(("gripper", "gripper_pos", "gripper_width"), "angle")

LINEAR_VELOCITY = FieldMeaning(("linear", "lin_vel"), "velocity", ((3,),))
ANGULAR_VELOCITY = FieldMeaning(("angular", "ang_vel"), "angular velocity", ((3,),))
TWIST = FieldMeaning(("ee_vel", "ee_twist", "twist"), ("velocity", "angular velocity"), ((6,),))
FORCE = FieldMeaning(("force",), "force", ((3,),))
TORQUE = FieldMeaning(("torque",), "torque", ((3,),))
WRENCH = FieldMeaning(("wrench", "ee_wrench"), ("force", "torque"), ((6,),))

ACCELERATION = FieldMeaning(("accel", "acceleration", "linear_acceleration"), "acceleration", ((3,),))
ANGULAR_RATE = FieldMeaning(("gyro", "angular_velocity"), "angular velocity", ((3,),))
MAGNETIC_FIELD = FieldMeaning(("mag",), "magnetic field", ((3,),))
TEMPERATURE = FieldMeaning(("temp", "temperature"), "temperature", ((),))

CAMERA_MATRIX = FieldMeaning(("intrinsics", "k"), None, ((3, 3), (9,)))
DISTORTION = FieldMeaning(("dist", "d"))
IMAGE_WIDTH, IMAGE_HEIGHT = FieldMeaning(("width",), None, ((),)), FieldMeaning(("height",), None, ((),))
COLOURS = FieldMeaning(("rgb", "image"))
"""Pixels [H, W, 1], [H, W, 3] or [H, W, 4]."""
DEPTHS = FieldMeaning(("depth",), "length")
"""Pixels [H, W]."""
ENCODED_IMAGE = FieldMeaning(("rgb", "image", "img", "jpeg", "jpg", "png"))
"""The bytes of a JPEG or PNG file."""

_MATRIX = re.compile(r"(?:^|_)T(?:_|$)")
"""A matrix in the words of kinematics: `T_base_ee`, `ee_T`. A small letter is a time."""

_JOINT = re.compile(r"joint_?(?=.)(?!s$)")
_NO_BODY = re.compile(r"(?:^|_)(joints?|motors?|dofs?|fingers?|gripper)_?$", re.IGNORECASE)


class PoseFields(NamedTuple):
    """Fields that say where something is and how it is turned."""

    owner: str
    """The owner of the pose: "tcp" for `tcp_pos`, "T_base_ee" for such a matrix; "" if the names do not tell it."""
    position: str
    orientation: str | None
    """None if `position` is the whole pose."""


def spelled(name: str) -> str:
    """Return a field's name as the table spells it: in small letters, and `jointPos` as `joint_pos`."""
    return _JOINT.sub("joint_", name.lower(), count=1) if name[:5].lower() == "joint" else name.lower()


def owner_of(name: str, kind: FieldMeaning) -> str | None:
    """Return what a field of a kind belongs to by its name; "" if that does not say it, None for other fields."""
    lower = spelled(name)
    for word in kind.names:
        if lower == word:
            return ""
        if kind.has_owner and lower.endswith(f"_{word}"):
            return name[: -len(word)].strip("_")
    return None


def is_body(owner: str) -> bool:
    """Whether a position may be that of a body by what it belongs to: that of a motor is a number of it."""
    return not _NO_BODY.search(owner)


def is_matrix_name(name: str) -> bool:
    """Whether a field has the name of a transformation matrix, such as `T_base_ee`."""
    return _MATRIX.search(name) is not None


def poses(shapes: Mapping[str, Shape]) -> list[PoseFields]:
    """Return the poses among the fields of one dict, in their order.

    Args:
        shapes: Of fields of numbers, by name; dicts of x y z and of x y z w are [3] and [4].
    """
    orientations = {
        owner: name
        for name, shape in shapes.items()
        if shape in ORIENTATION.shapes and (owner := owner_of(name, ORIENTATION)) is not None
    }
    pose_fields: list[PoseFields] = []
    for name, shape in shapes.items():
        whole, position = owner_of(name, POSE), owner_of(name, POSITION)
        if shape in POSE.shapes and (whole is not None or is_matrix_name(name)):
            pose_fields.append(PoseFields(name if whole is None else whole, name, None))
        elif shape in POSITION.shapes and position in orientations:
            pose_fields.append(PoseFields(position or "", name, orientations[position or ""]))
    return pose_fields
