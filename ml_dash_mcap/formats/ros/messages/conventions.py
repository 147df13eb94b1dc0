"""Which fields of a row can say what in a standard message, by name, shape and type."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from .lossless import Field

JOINT_STATE = "sensor_msgs/msg/JointState"
POSE = "geometry_msgs/msg/PoseStamped"
TWIST = "geometry_msgs/msg/TwistStamped"
WRENCH = "geometry_msgs/msg/WrenchStamped"
IMU = "sensor_msgs/msg/Imu"
MAGNETIC = "sensor_msgs/msg/MagneticField"
TEMPERATURE = "sensor_msgs/msg/Temperature"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
TF = "tf2_msgs/msg/TFMessage"

Shape = tuple[int, ...] | str

_V3, _V4, _V6, _V7, _V16, _M33, _M44 = (3,), (4,), (6,), (7,), (16,), (3, 3), (4, 4)
_ANY_VECTOR = "vector"
_COLORS = "colors"
_DEPTH = "depth"
_BYTES = "bytes"
_PATH = "path"
"""A text that is the path of an image, where images are embedded."""
_TEXT = "text"
_TEXTS = "texts"
_COVARIANCE: tuple[Shape, ...] = ((9,), (3, 3))


@dataclass(frozen=True, slots=True)
class Role:
    """A part of a standard message that a field can fill."""

    shapes: tuple[Shape, ...]
    """Those that the field may have."""
    quantity: str | tuple[str, str] | None = None
    """What it measures, for the units, or what each half does: see `units`."""


ROLES: Mapping[str, Mapping[str, Role]] = {
    JOINT_STATE: {
        "position": Role(((), _ANY_VECTOR), "angle"),
        "velocity": Role(((), _ANY_VECTOR), "angular velocity"),
        "effort": Role(((), _ANY_VECTOR), "torque"),
    },
    POSE: {
        "position": Role((_V3,), "length"),
        "orientation": Role((_V4,)),
        "pose": Role((_M44, _V16, _V7), "length"),
    },
    TWIST: {
        "linear": Role((_V3,), "velocity"),
        "angular": Role((_V3,), "angular velocity"),
        "twist": Role((_V6,), ("velocity", "angular velocity")),
    },
    WRENCH: {
        "force": Role((_V3,), "force"),
        "torque": Role((_V3,), "torque"),
        "wrench": Role((_V6,), ("force", "torque")),
    },
    IMU: {
        "linear_acceleration": Role((_V3,), "acceleration"),
        "angular_velocity": Role((_V3,), "angular velocity"),
        "orientation": Role((_V4,)),
    },
    MAGNETIC: {"magnetic_field": Role((_V3,), "magnetic field")},
    TEMPERATURE: {"temperature": Role(((),), "temperature")},
    CAMERA_INFO: {
        "k": Role((_M33, (9,))),
        "d": Role((_ANY_VECTOR,)),
        "width": Role(((),)),
        "height": Role(((),)),
    },
    IMAGE: {"data": Role((_COLORS, _DEPTH))},
    COMPRESSED: {"data": Role((_BYTES, _PATH))},
}
ROLES = {**ROLES, TF: ROLES[POSE]}
"""Standard messages, to what fields can fill in them."""


@dataclass(frozen=True, slots=True)
class Detail:
    """A part of a standard message that has a default, which a field can say better."""

    names: tuple[str, ...]
    """Those that the field has, the likeliest first."""
    shapes: tuple[Shape, ...] = (_TEXT,)
    """Those that it may have."""
    of: str | None = None
    """The role whose unit, squared, it is in."""


FRAME, CHILD_FRAME = "frame_id", "child_frame_id"
FRAME_DETAIL = Detail((FRAME,))
HEADER = "header"
"""The key of a dict that may have a frame, as in ROS's own messages."""

DETAILS: Mapping[str, Mapping[str, Detail]] = {
    JOINT_STATE: {"name": Detail(("joint_names", "names", "name"), (_TEXTS,))},
    TF: {CHILD_FRAME: Detail((CHILD_FRAME,))},
    IMU: {
        f"{role}_covariance": Detail((f"{role}_covariance", *more), _COVARIANCE, role)
        for role, more in {
            "orientation": ("quat_covariance",),
            "angular_velocity": ("gyro_covariance",),
            "linear_acceleration": ("accel_covariance",),
        }.items()
    },
    MAGNETIC: {
        "magnetic_field_covariance": Detail(
            ("magnetic_field_covariance", "mag_covariance"), _COVARIANCE, "magnetic_field"
        )
    },
    TEMPERATURE: {"variance": Detail(("variance", "temperature_variance", "temp_variance"), ((),), "temperature")},
    CAMERA_INFO: {
        "distortion_model": Detail(("distortion_model",)),
        "r": Detail(("R", "r"), (_M33, (9,))),
        "p": Detail(("P", "p"), ((3, 4), (12,))),
    },
    IMAGE: {"encoding": Detail(("encoding",))},
    COMPRESSED: {"format": Detail(("format",))},
}
"""Standard messages, to their details; whatever has a header has a frame too."""

ENOUGH: Mapping[str, Sequence[Sequence[str]]] = {
    JOINT_STATE: (("position",), ("velocity",), ("effort",)),
    POSE: (("position", "orientation"), ("pose",)),
    TF: (("position", "orientation"), ("pose",)),
    TWIST: (("linear", "angular"), ("twist",)),
    WRENCH: (("force", "torque"), ("wrench",)),
    IMU: (("linear_acceleration",), ("angular_velocity",)),
    MAGNETIC: (("magnetic_field",),),
    TEMPERATURE: (("temperature",),),
    CAMERA_INFO: (("k",),),
    IMAGE: (("data",),),
    COMPRESSED: (("data",),),
}
"""Standard messages, to the roles of which one group must be filled."""


SAID = ("frame_id", "child_frame_id", "quat_order", "joint_names", "units")
"""What a mapping can say besides the roles, in place of the topic's metadata."""


@dataclass(frozen=True, slots=True)
class Convention:
    """Field names that mean a standard message."""

    suffix: str
    type: str
    names: Mapping[str, tuple[str, ...]]
    """Role, to the names that a field for it has, the likeliest first."""
    shape: Shape | None = None
    """Which of the shapes of its roles it takes, if not all."""
    is_named: bool = False
    """Whether it must say the names of joints, because its fields may mean something else."""


GRIPPER = "gripper"
"""The topic, and the name, of a joint that is none of the arm's."""

_POSITIONS = ("q", "qpos", "joint_pos", "joint_position", "joint_positions")
_VELOCITIES = ("qd", "dq", "qvel", "joint_vel", "joint_velocity", "joint_velocities")
_EFFORTS = ("tau", "effort", "joint_torque", "joint_torques")
CONVENTIONS = (
    Convention(
        "joint_states",
        JOINT_STATE,
        {
            "position": ("position", "positions", *_POSITIONS),
            "velocity": ("velocity", "velocities", *_VELOCITIES),
            "effort": ("effort", "efforts", *_EFFORTS),
        },
        is_named=True,
    ),
    Convention("joint_states", JOINT_STATE, {"position": _POSITIONS, "velocity": _VELOCITIES, "effort": _EFFORTS}),
    Convention("joint_command", JOINT_STATE, {"position": ("target_q", "q_des", "q_cmd")}),
    Convention(GRIPPER, JOINT_STATE, {"position": ("gripper", "gripper_pos", "gripper_width")}),
    Convention("ee_pose", POSE, {"position": ("ee_pos", "ee_position"), "orientation": ("ee_quat", "ee_orientation")}),
    Convention("ee_pose", POSE, {"pose": ("ee_pose", "T_ee", "ee_T")}),
    Convention("pose", POSE, {"position": ("pos", "position"), "orientation": ("quat", "orientation")}),
    Convention("pose", POSE, {"pose": ("pose", "T_*")}),
    Convention("twist", TWIST, {"linear": ("linear", "lin_vel"), "angular": ("angular", "ang_vel")}),
    Convention("twist", TWIST, {"twist": ("ee_vel", "ee_twist", "twist")}),
    Convention("wrench", WRENCH, {"force": ("force",), "torque": ("torque",)}),
    Convention("wrench", WRENCH, {"wrench": ("wrench", "ee_wrench")}),
    Convention(
        "imu",
        IMU,
        {
            "linear_acceleration": ("accel", "acceleration", "linear_acceleration"),
            "angular_velocity": ("gyro", "angular_velocity"),
            "orientation": ("quat", "orientation"),
        },
    ),
    Convention("mag", MAGNETIC, {"magnetic_field": ("mag",)}),
    Convention("temp", TEMPERATURE, {"temperature": ("temp", "temperature")}),
    Convention(
        "camera_info",
        CAMERA_INFO,
        {"k": ("intrinsics", "K", "k"), "d": ("dist", "D", "d"), "width": ("width",), "height": ("height",)},
    ),
    Convention("image", IMAGE, {"data": ("rgb", "image")}, _COLORS),
    Convention("depth", IMAGE, {"data": ("depth",)}, _DEPTH),
    Convention("image/compressed", COMPRESSED, {"data": ("rgb", "image", "img", "jpeg", "jpg", "png")}),
)


def fits(one: Field, role: Role, *, embeds: bool = False) -> bool:
    """Whether a field can fill a role; with `embeds`, a text that is the path of an image is the image."""
    if one.message is not None:
        return False
    if _BYTES in role.shapes:
        return one.shape == () and (one.kind == "bytes" or (embeds and one.kind == "string"))
    if one.kind == "bool" or not (one.is_array or one.kind in ("float64", "int64", "uint64")):
        return False
    if one.shape is None:  # which `checks` has a word for
        return _COLORS not in role.shapes and _DEPTH not in role.shapes and role.shapes != ((),)
    return _is_picture(one, role) or one.shape in role.shapes or (_ANY_VECTOR in role.shapes and len(one.shape) == 1)


def _is_picture(one: Field, role: Role) -> bool:
    """Whether a field has the shape of the images that a role takes."""
    shape = one.shape or ()
    is_color = _COLORS in role.shapes and len(shape) == 3 and shape[2] in (1, 3, 4)
    return is_color or (_DEPTH in role.shapes and len(shape) == 2)


def says(one: Field, detail: Detail) -> bool:
    """Whether a field can say a detail."""
    if _TEXTS in detail.shapes:
        return one.kind == "string" and one.shape is None
    if _TEXT in detail.shapes:
        return one.kind == "string" and one.shape == ()
    return one.message is None and one.kind in ("float64", "int64", "uint64") and one.shape in detail.shapes


def is_ragged(one: Field) -> bool:
    """Whether a field's values are lists of numbers of various lengths."""
    return one.shape is None and one.kind in ("float64", "int64", "uint64")
