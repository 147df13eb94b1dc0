"""The names, shapes and types by which fields of a row fill the parts of standard messages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ....meaning import field_kinds as kinds
from ....meaning.field_kinds import FieldMeaning
from .lossless import MessageField

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

_M33 = (3, 3)
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
    """The quantity that it measures, for its units, or the quantities of its two halves: see `units`."""


def _role(kind: FieldMeaning) -> Role:
    return Role(kind.shapes, kind.quantity)


ROLES: Mapping[str, Mapping[str, Role]] = {
    JOINT_STATE: {
        "position": Role(((), _ANY_VECTOR), kinds.JOINT_POSITION.quantity),
        "velocity": Role(((), _ANY_VECTOR), kinds.JOINT_VELOCITY.quantity),
        "effort": Role(((), _ANY_VECTOR), kinds.JOINT_EFFORT.quantity),
    },
    POSE: {
        "position": _role(kinds.POSITION),
        "orientation": _role(kinds.ORIENTATION),
        "pose": _role(kinds.POSE),
    },
    TWIST: {
        "linear": _role(kinds.LINEAR_VELOCITY),
        "angular": _role(kinds.ANGULAR_VELOCITY),
        "twist": _role(kinds.TWIST),
    },
    WRENCH: {
        "force": _role(kinds.FORCE),
        "torque": _role(kinds.TORQUE),
        "wrench": _role(kinds.WRENCH),
    },
    IMU: {
        "linear_acceleration": _role(kinds.ACCELERATION),
        "angular_velocity": _role(kinds.ANGULAR_RATE),
        "orientation": _role(kinds.ORIENTATION),
    },
    MAGNETIC: {"magnetic_field": _role(kinds.MAGNETIC_FIELD)},
    TEMPERATURE: {"temperature": _role(kinds.TEMPERATURE)},
    CAMERA_INFO: {
        "k": _role(kinds.CAMERA_MATRIX),
        "d": Role((_ANY_VECTOR,)),
        "width": _role(kinds.IMAGE_WIDTH),
        "height": _role(kinds.IMAGE_HEIGHT),
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
"""The keys of a mapping that replace the topic's metadata; all its other keys are roles."""


@dataclass(frozen=True, slots=True)
class Convention:
    """MessageField names that mean a standard message."""

    suffix: str
    type: str
    names: Mapping[str, tuple[str, ...]]
    """Role, to the names that a field for it has, the likeliest first."""
    shape: Shape | None = None
    """The only shape that it takes of those of its roles; None for all."""
    is_named: bool = False
    """Whether it must say the names of joints, because its fields may mean something else."""


GRIPPER = "gripper"
"""The topic, and the name, of a joint that is none of the arm's."""

CONVENTIONS = (
    Convention(
        "joint_states",
        JOINT_STATE,
        {
            "position": (*kinds.NAMED_POSITION.names, *kinds.JOINT_POSITION.names),
            "velocity": (*kinds.NAMED_VELOCITY.names, *kinds.JOINT_VELOCITY.names),
            "effort": (*kinds.NAMED_EFFORT.names, *kinds.JOINT_EFFORT.names),
        },
        is_named=True,
    ),
    Convention(
        "joint_states",
        JOINT_STATE,
        {
            "position": kinds.JOINT_POSITION.names,
            "velocity": kinds.JOINT_VELOCITY.names,
            "effort": kinds.JOINT_EFFORT.names,
        },
    ),
    Convention("joint_command", JOINT_STATE, {"position": kinds.JOINT_COMMAND.names}),
    Convention(GRIPPER, JOINT_STATE, {"position": kinds.GRIPPER.names}),
    Convention("ee_pose", POSE, {"position": kinds.POSITION.of("ee"), "orientation": kinds.ORIENTATION.of("ee")}),
    Convention("ee_pose", POSE, {"pose": ("ee_pose", "T_ee", "ee_T", "ee_transform")}),
    Convention("pose", POSE, {"position": kinds.POSITION.names, "orientation": kinds.ORIENTATION.names}),
    Convention("pose", POSE, {"pose": ("pose", "T_*", "transform")}),
    Convention("twist", TWIST, {"linear": kinds.LINEAR_VELOCITY.names, "angular": kinds.ANGULAR_VELOCITY.names}),
    Convention("twist", TWIST, {"twist": kinds.TWIST.names}),
    Convention("wrench", WRENCH, {"force": kinds.FORCE.names, "torque": kinds.TORQUE.names}),
    Convention("wrench", WRENCH, {"wrench": kinds.WRENCH.names}),
    Convention(
        "imu",
        IMU,
        {
            "linear_acceleration": kinds.ACCELERATION.names,
            "angular_velocity": kinds.ANGULAR_RATE.names,
            "orientation": kinds.ORIENTATION.names,
        },
    ),
    Convention("mag", MAGNETIC, {"magnetic_field": kinds.MAGNETIC_FIELD.names}),
    Convention("temp", TEMPERATURE, {"temperature": kinds.TEMPERATURE.names}),
    Convention(
        "camera_info",
        CAMERA_INFO,
        {
            "k": kinds.CAMERA_MATRIX.names,
            "d": kinds.DISTORTION.names,
            "width": kinds.IMAGE_WIDTH.names,
            "height": kinds.IMAGE_HEIGHT.names,
        },
    ),
    Convention("image", IMAGE, {"data": kinds.COLOURS.names}, _COLORS),
    Convention("depth", IMAGE, {"data": kinds.DEPTHS.names}, _DEPTH),
    Convention("image/compressed", COMPRESSED, {"data": kinds.ENCODED_IMAGE.names}),
)
"""The messages that fields of one dict make. `field_kinds.poses` adds the poses of other owners than `ee`."""


def vector_shape(field: MessageField) -> tuple[int, ...] | None:
    """Return the shape that a field has as a vector: a dict of the numbers x y z is [3], one of x y z w is [4].

    None for a field that is neither a number, nor a list of numbers of one shape, nor such a dict.
    """
    if field.message is None:
        is_number = field.is_array or field.kind in ("float64", "int64", "uint64")
        return field.shape if is_number and field.kind != "bool" else None
    letters = "".join(sorted(inner.key for inner in field.message.fields))
    is_vector = letters in ("xyz", "wxyz") and all(vector_shape(inner) == () for inner in field.message.fields)
    return (len(letters),) if is_vector and field.shape == () else None


def fits(field: MessageField, role: Role, *, embeds: bool = False) -> bool:
    """Whether a field can fill a role; with `embeds`, a text that is the path of an image is the image."""
    if field.message is not None:
        return vector_shape(field) in role.shapes
    if _BYTES in role.shapes:
        return field.shape == () and (field.kind == "bytes" or (embeds and field.kind == "string"))
    if field.kind == "bool" or not (field.is_array or field.kind in ("float64", "int64", "uint64")):
        return False
    if field.shape is None:  # `underivable` names it in its error
        return _COLORS not in role.shapes and _DEPTH not in role.shapes and role.shapes != ((),)
    return (
        _is_picture(field, role) or field.shape in role.shapes or (_ANY_VECTOR in role.shapes and len(field.shape) == 1)
    )


def _is_picture(field: MessageField, role: Role) -> bool:
    """Whether a field has the shape of the images that a role takes."""
    shape = field.shape or ()
    is_color = _COLORS in role.shapes and len(shape) == 3 and shape[2] in (1, 3, 4)
    return is_color or (_DEPTH in role.shapes and len(shape) == 2)


def says(field: MessageField, detail: Detail) -> bool:
    """Whether a field can say a detail."""
    if _TEXTS in detail.shapes:
        return field.kind == "string" and field.shape is None
    if _TEXT in detail.shapes:
        return field.kind == "string" and field.shape == ()
    return field.message is None and field.kind in ("float64", "int64", "uint64") and field.shape in detail.shapes


def is_ragged(field: MessageField) -> bool:
    """Whether a field's values are lists of numbers of various lengths."""
    return field.shape is None and field.kind in ("float64", "int64", "uint64")
