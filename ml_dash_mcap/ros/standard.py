"""Which standard messages say what a topic's fields hold.

A message is derived where a field's name, shape and type fit; what a topic's metadata and the caller's mapping say
comes before any convention. `messages` makes the messages.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ..errors import ConversionError
from . import names
from .lossless import Field, Message

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
_FRAME = Detail((FRAME,))
_HEADER = "header"

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

_ENOUGH: Mapping[str, Sequence[Sequence[str]]] = {
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
class _Convention:
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
    _Convention(
        "joint_states",
        JOINT_STATE,
        {
            "position": ("position", "positions", *_POSITIONS),
            "velocity": ("velocity", "velocities", *_VELOCITIES),
            "effort": ("effort", "efforts", *_EFFORTS),
        },
        is_named=True,
    ),
    _Convention("joint_states", JOINT_STATE, {"position": _POSITIONS, "velocity": _VELOCITIES, "effort": _EFFORTS}),
    _Convention("joint_command", JOINT_STATE, {"position": ("target_q", "q_des", "q_cmd")}),
    _Convention(GRIPPER, JOINT_STATE, {"position": ("gripper", "gripper_pos", "gripper_width")}),
    _Convention("ee_pose", POSE, {"position": ("ee_pos", "ee_position"), "orientation": ("ee_quat", "ee_orientation")}),
    _Convention("ee_pose", POSE, {"pose": ("ee_pose", "T_ee", "ee_T")}),
    _Convention("pose", POSE, {"position": ("pos", "position"), "orientation": ("quat", "orientation")}),
    _Convention("pose", POSE, {"pose": ("pose", "T_*")}),
    _Convention("twist", TWIST, {"linear": ("linear", "lin_vel"), "angular": ("angular", "ang_vel")}),
    _Convention("twist", TWIST, {"twist": ("ee_vel", "ee_twist", "twist")}),
    _Convention("wrench", WRENCH, {"force": ("force",), "torque": ("torque",)}),
    _Convention("wrench", WRENCH, {"wrench": ("wrench", "ee_wrench")}),
    _Convention(
        "imu",
        IMU,
        {
            "linear_acceleration": ("accel", "acceleration", "linear_acceleration"),
            "angular_velocity": ("gyro", "angular_velocity"),
            "orientation": ("quat", "orientation"),
        },
    ),
    _Convention("mag", MAGNETIC, {"magnetic_field": ("mag",)}),
    _Convention("temp", TEMPERATURE, {"temperature": ("temp", "temperature")}),
    _Convention(
        "camera_info",
        CAMERA_INFO,
        {"k": ("intrinsics", "K", "k"), "d": ("dist", "D", "d"), "width": ("width",), "height": ("height",)},
    ),
    _Convention("image", IMAGE, {"data": ("rgb", "image")}, _COLORS),
    _Convention("depth", IMAGE, {"data": ("depth",)}, _DEPTH),
    _Convention("image/compressed", COMPRESSED, {"data": ("rgb", "image", "img", "jpeg", "jpg", "png")}),
)


@dataclass(frozen=True, slots=True)
class Derived:
    """A topic of standard messages that is derived from fields of one of ours."""

    topic: str
    """In ROS."""
    type: str
    """Of its messages."""
    fields: Mapping[str, tuple[Field, ...]]
    """Role, to the field that fills it: the way to it, from the row's own field inwards."""
    message: Message
    """Of the rows."""
    details: Mapping[str, tuple[Field, ...]] = field(default_factory=dict)
    """Detail, to the field that says it; rows may lack it."""
    metadata: Mapping[str, Any] = field(default_factory=dict)
    """Of our topic: `frame_id`, `joint_names`, `quat_order`, `units`."""
    is_asked: bool = False
    """Whether the caller asked for it, rather than a convention."""
    child: str = ""
    """What a transform leads to where nobody says a frame."""

    def key(self, role: str) -> str:
        """Return the dotted name of a role's field."""
        return ".".join(one.key for one in (self.fields.get(role) or self.details[role]))


def derive(
    message: Message,
    topic: str,
    metadata: Mapping[str, Any],
    mapping: Mapping[str, Any] | None,
    *,
    tf: bool = False,
    embeds: bool = False,
) -> list[Derived]:
    """Return the standard messages that a topic's rows can be said with.

    Args:
        message: Of the rows.
        topic: Its name in ROS.
        metadata: What was said of it when it was recorded.
        mapping: What the caller says of it: suffix or topic to None, for no such message, or to a dict of the `type`
            and, by role, the dotted name of the field; None for the conventions.
        tf: Whether to send its poses on `/tf` as well.
        embeds: Whether a text that is the path of an image stands for the image.

    Raises:
        ConversionError: The mapping asks for what is not there or does not fit.
    """
    asked = dict(mapping or {})
    found = [
        _asked(message, topic, metadata, suffix, said, embeds) for suffix, said in asked.items() if said is not None
    ]
    taken = {_topic(topic, suffix) for suffix in asked}
    for path, fields in _levels(message.fields, ()):
        base = "/".join([topic, *(one.name for one in path)])
        for convention in CONVENTIONS:
            name = f"{base}/{convention.suffix}"
            roles = _matching(convention, fields, path)
            if roles is not None and name not in taken:
                taken.add(name)
                said = metadata if convention.suffix != GRIPPER else _without_names(metadata)
                details = _details(message, convention.type, next(iter(roles.values()))[:-1])
                found.append(Derived(name, convention.type, roles, message, details, said))
        for one in fields.values() if embeds else ():
            name = f"{base}/{_picture(one)}/compressed"
            if one.names_images and one.shape == () and name not in taken:
                taken.add(name)
                details = _details(message, COMPRESSED, path)
                found.append(Derived(name, COMPRESSED, {"data": (*path, one)}, message, details, metadata))
    poses = [one for one in found if one.type == POSE] if tf and "/tf" not in taken else []
    return found + [_transform(one) for one in poses[:1]]


def _transform(pose: Derived) -> Derived:
    """Return the transforms that say what a topic of poses says; the child is the topic, if nobody says another."""
    details = _details(pose.message, TF, next(iter(pose.fields.values()))[:-1])
    return Derived("/tf", TF, pose.fields, pose.message, details, pose.metadata, child=pose.topic)


def _details(message: Message, type_: str, path: tuple[Field, ...]) -> dict[str, tuple[Field, ...]]:
    """Return the fields that say details of a standard message, those beside its other fields first."""
    found: dict[str, tuple[Field, ...]] = {}
    for way in (path, ()):
        level = _by_key((way[-1].message if way else None) or message)
        for role, detail in {**DETAILS.get(type_, {}), FRAME: _FRAME}.items():
            if role in found or (way != path and role != FRAME):
                continue
            one = next((level[name] for name in detail.names if name in level and _says(level[name], detail)), None)
            header = level.get(_HEADER)
            if one is not None:
                found[role] = (*way, one)
            elif role == FRAME and header is not None and header.message is not None and header.shape == ():
                inner = _by_key(header.message).get(FRAME)
                if inner is not None and _says(inner, detail):
                    found[role] = (*way, header, inner)
    return found


def _by_key(message: Message) -> dict[str, Field]:
    return {one.key: one for one in message.fields}


def _says(one: Field, detail: Detail) -> bool:
    if _TEXTS in detail.shapes:
        return one.kind == "string" and one.shape is None
    if _TEXT in detail.shapes:
        return one.kind == "string" and one.shape == ()
    return one.message is None and one.kind in ("float64", "int64", "uint64") and one.shape in detail.shapes


def _picture(one: Field) -> str:
    """Return what to call the images whose paths a field holds."""
    name = one.name.removesuffix("_path").removesuffix("_file")
    return "image" if name in ("path", "file", "img", "frame") else name


def _levels(fields: Sequence[Field], path: tuple[Field, ...]) -> Iterable[tuple[tuple[Field, ...], dict[str, Field]]]:
    yield path, {one.key: one for one in fields}
    for one in fields:
        if one.message is not None and one.shape == ():
            yield from _levels(one.message.fields, (*path, one))


def _matching(
    convention: _Convention, fields: Mapping[str, Field], path: tuple[Field, ...]
) -> dict[str, tuple[Field, ...]] | None:
    roles: dict[str, tuple[Field, ...]] = {}
    for role, known in convention.names.items():
        wanted = ROLES[convention.type][role]
        if convention.shape is not None:
            wanted = Role((convention.shape,), wanted.quantity)
        fitting = {key: one for key, one in fields.items() if _fits(one, wanted)}
        one = _named(known, {key: one for key, one in fitting.items() if not is_ragged(one)}) or _named(known, fitting)
        if one is not None:
            roles[role] = (*path, one)
    if not any(set(group) <= set(roles) for group in _ENOUGH[convention.type]):
        return None
    if convention.is_named and not any(
        name in fields and _says(fields[name], detail)
        for detail in DETAILS[convention.type].values()
        for name in detail.names
    ):
        return None
    shapes = {way[-1].shape for way in roles.values()}
    if convention.type == JOINT_STATE and len(shapes) > 1 and None not in shapes:
        return None
    return roles


def _named(known: Sequence[str], fields: Mapping[str, Field]) -> Field | None:
    for name in known:
        if name.endswith("*"):
            found = [key for key in fields if key.startswith(name[:-1])]
            if len(found) == 1:
                return fields[found[0]]
        elif name in fields:
            return fields[name]
    return None


def _fits(one: Field, role: Role, *, embeds: bool = False) -> bool:
    if one.message is not None:
        return False
    if _BYTES in role.shapes:
        return one.shape == () and (one.kind == "bytes" or (embeds and one.kind == "string"))
    if one.kind not in ("float64", "int64", "uint64"):
        return False
    if one.shape is None:  # which `checks` has a word for
        return _COLORS not in role.shapes and _DEPTH not in role.shapes and role.shapes != ((),)
    if _COLORS in role.shapes and len(one.shape) == 3 and one.shape[2] in (1, 3, 4):
        return True
    if _DEPTH in role.shapes and len(one.shape) == 2:
        return True
    return one.shape in role.shapes or (_ANY_VECTOR in role.shapes and len(one.shape) == 1)


def _asked(message: Message, topic: str, metadata: Mapping[str, Any], suffix: str, said: Any, embeds: bool) -> Derived:
    name = _topic(topic, suffix)
    names.check_topic(name)
    if not isinstance(said, Mapping) or not isinstance(said.get("type"), str):
        raise ConversionError(f"mapping of {suffix!r}: pass a dict with the message's `type` and a field for each role")
    type_ = said["type"] if "/msg/" in said["type"] else said["type"].replace("/", "/msg/", 1)
    if type_ not in ROLES:
        raise ConversionError(f"mapping of {suffix!r}: {said['type']!r} is none of {', '.join(sorted(ROLES))}")
    roles = {}
    details = {}
    more = {key: said[key] for key in SAID if key in said}
    if isinstance(more.get("units"), Mapping) and isinstance(metadata.get("units"), Mapping):
        more["units"] = {**metadata["units"], **more["units"]}
    for role, key in said.items():
        if role == "type" or role in more:
            continue
        detail = DETAILS.get(type_, {}).get(role)
        if detail is not None:
            details[role] = _way(message, str(key), suffix)
            if not _says(details[role][-1], detail):
                what = describe(details[role][-1])
                raise ConversionError(f"mapping of {suffix!r}: field {key!r} is {what}, which does not fit {role!r}")
            continue
        if role not in ROLES[type_]:
            raise ConversionError(f"mapping of {suffix!r}: {type_} has no {role!r}; it has {', '.join(ROLES[type_])}")
        roles[role] = _way(message, str(key), suffix)
        if not _fits(roles[role][-1], ROLES[type_][role], embeds=embeds):
            hint = "pass embed_images=True if it is the path of an image, " if type_ == COMPRESSED else ""
            raise ConversionError(
                f"mapping of {suffix!r}: field {key!r} is {describe(roles[role][-1])}, which does not fit {role!r} of"
                f" {type_}; {hint}leave it out, or export with profile='lossless'"
            )
    if not any(set(group) <= set(roles) for group in _ENOUGH[type_]):
        groups = " or ".join("+".join(group) for group in _ENOUGH[type_])
        raise ConversionError(f"mapping of {suffix!r}: {type_} needs {groups}")
    metadata = _without_names(metadata) if name.rpartition("/")[2] == GRIPPER else metadata
    details = {**_details(message, type_, next(iter(roles.values()))[:-1]), **details}
    return Derived(name, type_, roles, message, details, {**metadata, **more}, is_asked=True, child=topic)


def _without_names(metadata: Mapping[str, Any]) -> dict[str, Any]:
    """Leave out the names of the arm's joints, for the gripper."""
    return {key: value for key, value in metadata.items() if key != "joint_names"}


def _way(message: Message, key: str, suffix: str) -> tuple[Field, ...]:
    fields = {one.key: one for one in message.fields}
    if key in fields:
        return (fields[key],)
    way: list[Field] = []
    inner: Message | None = message
    for part in key.split("."):
        fields = {one.key: one for one in inner.fields} if inner is not None else {}
        if part not in fields:
            there = ", ".join(one.key for one in message.fields)
            raise ConversionError(f"mapping of {suffix!r}: there is no field {key!r}; there are {there}")
        way.append(fields[part])
        inner = fields[part].message
    return tuple(way)


def _topic(topic: str, suffix: str) -> str:
    return suffix if suffix.startswith("/") else f"{topic}/{suffix}"


def is_ragged(one: Field) -> bool:
    """Whether a field's values are lists of numbers of various lengths."""
    return one.shape is None and one.kind in ("float64", "int64", "uint64")


def describe(one: Field) -> str:
    """Say a field's type and shape."""
    if one.shape is None:
        return f"lists of {one.kind} whose length changes"
    return one.kind + (f"[{','.join(map(str, one.shape))}]" if one.shape else "")
