"""Chooses the standard messages that can be derived from a topic's fields.

A message is derived where a field's name, shape and type fit; what a topic's metadata and the caller's mapping say
comes before any convention. `conventions` has the tables, `messages` makes the messages.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ....errors import ConversionError
from ....meaning.field_kinds import is_matrix_name, poses, spelled
from .. import ros_names
from .conventions import (
    COMPRESSED,
    CONVENTIONS,
    DETAILS,
    ENOUGH,
    FRAME,
    FRAME_DETAIL,
    GRIPPER,
    HEADER,
    JOINT_STATE,
    POSE,
    ROLES,
    SAID,
    TF,
    Convention,
    Role,
    fits,
    is_ragged,
    says,
    vector_shape,
)
from .lossless import Message, MessageField


@dataclass(frozen=True, slots=True)
class Derived:
    """A topic of standard messages that is derived from fields of one of ours."""

    topic: str
    """In ROS."""
    type: str
    """The type of its messages."""
    fields: Mapping[str, tuple[MessageField, ...]]
    """Role, to the field that fills it: the way to it, from the row's own field inwards."""
    message: Message
    """The message that holds the whole rows."""
    details: Mapping[str, tuple[MessageField, ...]] = dataclasses.field(default_factory=dict)
    """Detail, to the field that says it; rows may lack it."""
    metadata: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """Of our topic: `frame_id`, `joint_names`, `quat_order`, `units`."""
    is_asked: bool = False
    """Whether the caller's mapping asks for it; otherwise a convention made it."""
    child: str = ""
    """The child frame of a transform if none is stated."""

    def key(self, role: str) -> str:
        """Return the dotted name of a role's field."""
        return ".".join(field.key for field in (self.fields.get(role) or self.details[role]))


def derive(
    message: Message,
    topic: str,
    metadata: Mapping[str, Any],
    mapping: Mapping[str, Any] | None,
    *,
    tf: bool = False,
    embeds: bool = False,
) -> list[Derived]:
    """Return the standard messages that can be made of a topic's rows.

    Args:
        message: Of the rows.
        topic: Its name in ROS.
        metadata: Of the topic, as recorded.
        mapping: What the caller says of it: suffix or topic to None, for no such message, or to a dict of the `type`
            and, by role, the dotted name of the field; None for the conventions.
        tf: Whether to send its poses on `/tf` as well.
        embeds: Whether a text that is the path of an image stands for the image.

    Raises:
        ConversionError: The mapping names a field that is not there or does not fit.
    """
    asked = dict(mapping or {})
    derived = [
        _asked(message, topic, metadata, suffix, wish, embeds) for suffix, wish in asked.items() if wish is not None
    ]
    taken = {_topic(topic, suffix) for suffix in asked}
    for path, fields in _levels(message.fields, ()):
        base = "/".join([topic, *(field.name for field in path)])
        for convention in CONVENTIONS:
            name = f"{base}/{convention.suffix}"
            roles = _matching(convention, fields, path)
            if roles is not None and name not in taken:
                taken.add(name)
                # The joint names of a topic are those of the arm.
                own_metadata = metadata if convention.suffix != GRIPPER else _without_names(metadata)
                details = _details(message, convention.type, next(iter(roles.values()))[:-1])
                derived.append(Derived(name, convention.type, roles, message, details, own_metadata))
        for name, roles in _other_poses(base, fields, path, derived):
            if name not in taken:
                taken.add(name)
                derived.append(Derived(name, POSE, roles, message, _details(message, POSE, path), metadata))
        for field in fields.values() if embeds else ():
            name = f"{base}/{_picture(field)}/compressed"
            if field.names_images and field.shape == () and name not in taken:
                taken.add(name)
                details = _details(message, COMPRESSED, path)
                derived.append(Derived(name, COMPRESSED, {"data": (*path, field)}, message, details, metadata))
    poses = [pose for pose in derived if pose.type == POSE] if tf and "/tf" not in taken else []
    return derived + [_transform(pose) for pose in poses[:1]]


def _transform(pose: Derived) -> Derived:
    """Return the transforms for a topic of poses. The child frame is named after the topic unless another is stated."""
    details = _details(pose.message, TF, next(iter(pose.fields.values()))[:-1])
    return Derived("/tf", TF, pose.fields, pose.message, details, pose.metadata, child=pose.topic)


def _details(message: Message, type_: str, path: tuple[MessageField, ...]) -> dict[str, tuple[MessageField, ...]]:
    """Return the fields that say details of a standard message, those beside its other fields first."""
    details: dict[str, tuple[MessageField, ...]] = {}
    for way in (path, ()):
        level = _by_key((way[-1].message if way else None) or message)
        for role, detail in {**DETAILS.get(type_, {}), FRAME: FRAME_DETAIL}.items():
            if role in details or (way != path and role != FRAME):
                continue
            field = next((level[name] for name in detail.names if name in level and says(level[name], detail)), None)
            header = level.get(HEADER)
            if field is not None:
                details[role] = (*way, field)
            elif role == FRAME and header is not None and header.message is not None and header.shape == ():
                inner = _by_key(header.message).get(FRAME)
                if inner is not None and says(inner, detail):
                    details[role] = (*way, header, inner)
    return details


def _by_key(message: Message) -> dict[str, MessageField]:
    return {field.key: field for field in message.fields}


def _picture(field: MessageField) -> str:
    """Return what to call the images whose paths a field holds."""
    name = field.name.removesuffix("_path").removesuffix("_file")
    return "image" if name in ("path", "file", "img", "frame") else name


def _levels(
    fields: Sequence[MessageField], path: tuple[MessageField, ...]
) -> Iterable[tuple[tuple[MessageField, ...], dict[str, MessageField]]]:
    yield path, {field.key: field for field in fields}
    for field in fields:
        if field.message is not None and field.shape == ():
            yield from _levels(field.message.fields, (*path, field))


def _other_poses(
    base: str, fields: Mapping[str, MessageField], path: tuple[MessageField, ...], others: Sequence[Derived]
) -> Iterable[tuple[str, dict[str, tuple[MessageField, ...]]]]:
    """Yield the topics of poses that no convention made, and their fields: those of `tcp_pos` and `tcp_quat`."""
    used = [way for derived in others if derived.type == POSE for way in derived.fields.values()]
    shapes = {key: shape for key, field in fields.items() if (shape := vector_shape(field))}
    for pose in poses(shapes):
        if pose.orientation is None:
            roles = {"pose": (*path, fields[pose.position])}
        else:
            roles = {"position": (*path, fields[pose.position]), "orientation": (*path, fields[pose.orientation])}
        if not any(way in used for way in roles.values()):
            name = pose.position if is_matrix_name(pose.position) else f"{pose.owner}_pose" if pose.owner else "pose"
            yield f"{base}/{ros_names.field(name)}", roles


def _matching(
    convention: Convention, fields: Mapping[str, MessageField], path: tuple[MessageField, ...]
) -> dict[str, tuple[MessageField, ...]] | None:
    roles: dict[str, tuple[MessageField, ...]] = {}
    for role, names in convention.names.items():
        wanted = ROLES[convention.type][role]
        if convention.shape is not None:
            wanted = Role((convention.shape,), wanted.quantity)
        fitting = {key: field for key, field in fields.items() if fits(field, wanted)}
        # A field of one fixed length is preferred: lists whose length changes fit fewer messages.
        even = {key: field for key, field in fitting.items() if not is_ragged(field)}
        field = _named(names, even) or _named(names, fitting)
        if field is not None:
            roles[role] = (*path, field)
    if not any(set(group) <= set(roles) for group in ENOUGH[convention.type]):
        return None
    if convention.is_named and not any(
        name in fields and says(fields[name], detail)
        for detail in DETAILS[convention.type].values()
        for name in detail.names
    ):
        return None
    if convention.type == JOINT_STATE:
        shapes = {way[-1].shape for way in roles.values()}
        if len(shapes) > 1 and None not in shapes:
            return None
        torque = fields.get("torque")  # of a wrench, unless there is one for each joint
        if "position" in roles and "effort" not in roles and torque is not None and torque.shape in shapes:
            roles["effort"] = (*path, torque)
    return roles


def _named(names: Sequence[str], fields: Mapping[str, MessageField]) -> MessageField | None:
    for name in names:
        if name.endswith("*"):
            matches = [key for key in fields if key.startswith(name[:-1])]
            if len(matches) == 1:
                return fields[matches[0]]
        elif name in fields:
            return fields[name]
    by_spelling = {spelled(key): field for key, field in fields.items()}
    return next((by_spelling[name] for name in names if name in by_spelling), None)


def _asked(message: Message, topic: str, metadata: Mapping[str, Any], suffix: str, wish: Any, embeds: bool) -> Derived:
    name = _topic(topic, suffix)
    ros_names.check_topic(name)
    if not isinstance(wish, Mapping) or not isinstance(wish.get("type"), str):
        raise ConversionError(f"mapping of {suffix!r}: pass a dict with the message's `type` and a field for each role")
    type_ = wish["type"] if "/msg/" in wish["type"] else wish["type"].replace("/", "/msg/", 1)
    if type_ not in ROLES:
        raise ConversionError(f"mapping of {suffix!r}: {wish['type']!r} is none of {', '.join(sorted(ROLES))}")
    roles = {}
    details = {}
    more = {key: wish[key] for key in SAID if key in wish}
    if isinstance(more.get("units"), Mapping) and isinstance(metadata.get("units"), Mapping):
        more["units"] = {**metadata["units"], **more["units"]}
    for role, key in wish.items():
        if role == "type" or role in more:
            continue
        detail = DETAILS.get(type_, {}).get(role)
        if detail is not None:
            details[role] = _way(message, str(key), suffix)
            if not says(details[role][-1], detail):
                what = describe(details[role][-1])
                raise ConversionError(f"mapping of {suffix!r}: field {key!r} is {what}, which does not fit {role!r}")
            continue
        if role not in ROLES[type_]:
            raise ConversionError(f"mapping of {suffix!r}: {type_} has no {role!r}; it has {', '.join(ROLES[type_])}")
        roles[role] = _way(message, str(key), suffix)
        if not fits(roles[role][-1], ROLES[type_][role], embeds=embeds):
            hint = "pass embed_images=True if it is the path of an image, " if type_ == COMPRESSED else ""
            raise ConversionError(
                f"mapping of {suffix!r}: field {key!r} is {describe(roles[role][-1])}, which does not fit {role!r} of"
                f" {type_}; {hint}leave it out, or export with profile='lossless'"
            )
    if not any(set(group) <= set(roles) for group in ENOUGH[type_]):
        groups = " or ".join("+".join(group) for group in ENOUGH[type_])
        raise ConversionError(f"mapping of {suffix!r}: {type_} needs {groups}")
    metadata = _without_names(metadata) if name.rpartition("/")[2] == GRIPPER else metadata
    details = {**_details(message, type_, next(iter(roles.values()))[:-1]), **details}
    return Derived(name, type_, roles, message, details, {**metadata, **more}, is_asked=True, child=topic)


def _without_names(metadata: Mapping[str, Any]) -> dict[str, Any]:
    """Leave out the names of the arm's joints, for the gripper."""
    return {key: value for key, value in metadata.items() if key != "joint_names"}


def _way(message: Message, key: str, suffix: str) -> tuple[MessageField, ...]:
    fields = {field.key: field for field in message.fields}
    if key in fields:
        return (fields[key],)
    way: list[MessageField] = []
    inner: Message | None = message
    for part in key.split("."):
        fields = {field.key: field for field in inner.fields} if inner is not None else {}
        if part not in fields:
            there = ", ".join(field.key for field in message.fields)
            raise ConversionError(f"mapping of {suffix!r}: there is no field {key!r}; there are {there}")
        way.append(fields[part])
        inner = fields[part].message
    return tuple(way)


def _topic(topic: str, suffix: str) -> str:
    return suffix if suffix.startswith("/") else f"{topic}/{suffix}"


def describe(field: MessageField) -> str:
    """Describe a field's type and shape in words."""
    if field.shape is None:
        return f"lists of {field.kind} whose length changes"
    return field.kind + (f"[{','.join(map(str, field.shape))}]" if field.shape else "")
