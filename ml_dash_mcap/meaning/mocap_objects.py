"""Finds the objects of motion capture among a topic's fields: rigid bodies, markers, joints."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from .field_kinds import (
    JOINT_EFFORT,
    JOINT_POSITION,
    JOINT_VELOCITY,
    NAMED_EFFORT,
    NAMED_POSITION,
    NAMED_VELOCITY,
    ORIENTATION,
    POSE,
    POSITION,
    TORQUE,
    PoseFields,
    is_body,
    owner_of,
    poses,
)

Path = tuple[str, ...]
"""A field's keys, from the outermost dict in."""
Shapes = Mapping[Path, tuple[int, ...]]
"""Fields of numbers to the shape of their values; () for a single number."""

MARKERS_TOPIC = "markers"
"""The topic of markers that belong to no body; its name is no part of theirs."""

MARKER_KINDS = {"body_markers": "Rigid Body Marker", "bone_markers": "Bone Marker"}
"""Fields that hold markers of a special kind, to Motive's names of these kinds."""

_MARKER = re.compile("marker", re.IGNORECASE)
_JOINT_KINDS = (
    ("", (JOINT_POSITION,), NAMED_POSITION),
    ("_u", (JOINT_VELOCITY,), NAMED_VELOCITY),
    ("_tau", (JOINT_EFFORT, TORQUE), NAMED_EFFORT),
)
"""The suffix that OpenSim appends to a joint's name; the fields that get it always; and those that get it for named
joints."""
_GRIPPER = re.compile("gripper", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class NumberSource:
    """Where an object's numbers stand: some fields, their values flattened and put side by side, or a part of that."""

    fields: tuple[Path, ...]
    shape: tuple[int, ...]
    """The shape of each field's value."""
    start: int = 0
    stop: int | None = None

    @property
    def columns(self) -> list[str]:
        """The fields' dotted names."""
        return [".".join(field) for field in self.fields]

    @property
    def size(self) -> int:
        """How many numbers the fields have together, those left out included."""
        return len(self.fields) * math.prod(self.shape)


@dataclass(frozen=True, slots=True)
class Body:
    """Something with a position and a rotation."""

    name: str
    topic: str
    position: NumberSource
    """x y z; of a matrix all 16 numbers, row by row."""
    rotation: NumberSource | None
    """The quaternion; None if `position` is a 4x4 matrix."""
    order: str = "xyzw"
    """The order of the quaternion's numbers."""
    error: NumberSource | None = None
    """The mean error of its markers, a length."""

    @property
    def path(self) -> Path:
        """The path of its field, for a body that is given as a matrix."""
        return self.position.fields[0]


@dataclass(frozen=True, slots=True)
class Marker:
    """A point."""

    name: str
    topic: str
    position: NumberSource
    kind: str = "Marker"


@dataclass(frozen=True, slots=True)
class Joint:
    """One number of a joint, or of what moves like one."""

    name: str
    topic: str
    value: NumberSource


@dataclass(frozen=True, slots=True)
class Objects:
    """The objects of a topic."""

    bodies: tuple[Body, ...] = ()
    markers: tuple[Marker, ...] = ()
    joints: tuple[Joint, ...] = ()


def find(topic: str, shapes: Shapes, metadata: Mapping[str, Any], quat_order: str | None = None) -> Objects:
    """Find a topic's objects by the names and shapes of its fields, and by what its metadata says.

    * A rigid body is a position [3] and a quaternion [4] whose names differ in the last word only (`ee_pos` and
      `ee_quat`, `pose.position` and `pose.orientation`), a `pose` [7] of both, or a 4x4 matrix (`pose`, `T_base_ee`).
      Dicts of the numbers x y z and x y z w are positions and quaternions too. The only body of a topic has its name.
    * A marker is a [3] inside a dict `markers`, or in a topic whose name says so; a row of `markers` [M, 3]; a position
      without a quaternion.
    * Joints are the numbers of `q`, `dq`, `tau` and what else these are called, and those of a gripper.

    Args:
        topic: Its name.
        shapes: Of its fields.
        metadata: Of the topic; `quat_order`, `marker_names` and `joint_names` count.
        quat_order: Instead of the metadata's.
    """
    order = str(quat_order or metadata.get("quat_order") or "xyzw")
    fields = _gather(shapes)
    bodies = _bodies(topic, fields, order)
    used = {path for body in bodies for source in (body.position, body.rotation) if source for path in source.fields}
    rest = {path: source for path, source in fields.items() if not used.intersection(source.fields)}
    return Objects(tuple(bodies), tuple(_markers(topic, rest, metadata)), tuple(_joints(topic, shapes, used, metadata)))


def expected(path: Path) -> tuple[int, ...] | None:
    """Return the shape that a field should have by its name, if its values have several."""
    if any(_MARKER.search(word) for word in path[:-1]):
        return (3,)
    for kind, size in ((POSITION, 3), (ORIENTATION, 4), (POSE, 7)):
        owner = owner_of(path[-1], kind)
        if owner is not None and is_body(owner):
            return (size,)
    return None


def is_joints(path: Path, metadata: Mapping[str, Any]) -> bool:
    """Whether the numbers of a list are joints by its name."""
    return _joint_suffix(path[-1], bool(_joint_names(metadata))) is not None


def _gather(shapes: Shapes) -> dict[Path, NumberSource]:
    """Return every field as a source; dicts of x y z and of x y z w as one."""
    sources: dict[Path, NumberSource] = {}
    for path, shape in shapes.items():
        parent = path[:-1]
        letters = {other[-1] for other in shapes if other[:-1] == parent and shapes[other] == ()}
        if parent and shape == () and letters in ({"x", "y", "z"}, {"x", "y", "z", "w"}):
            names = "xyzw"[: len(letters)]
            sources[parent] = NumberSource(tuple((*parent, letter) for letter in names), ())
        else:
            sources[path] = NumberSource((path,), shape)
    return sources


def _bodies(topic: str, fields: Mapping[Path, NumberSource], order: str) -> list[Body]:
    levels: dict[Path, dict[str, tuple[int, ...]]] = {}
    for path, source in fields.items():
        levels.setdefault(path[:-1], {})[path[-1]] = source.shape or (source.size,)
    by_field = {(*parent, pose.position): (parent, pose) for parent in levels for pose in poses(levels[parent])}
    in_order = [by_field[path] for path in fields if path in by_field]
    return [_body(topic, fields, order, parent, pose, is_only=len(in_order) == 1) for parent, pose in in_order]


def _body(
    topic: str, fields: Mapping[Path, NumberSource], order: str, parent: Path, pose: PoseFields, *, is_only: bool
) -> Body:
    path: Path = (*parent, pose.position)
    position, owner = fields[path], pose.owner
    rotation = None if pose.orientation is None else fields.get((*parent, pose.orientation))
    if position.shape == (7,):
        position, rotation = NumberSource(position.fields, (7,), 0, 3), NumberSource(position.fields, (7,), 3, 7)
    elif rotation is None:
        owner = pose.position
    elif rotation.shape == ():
        order = "xyzw"
    name = topic if is_only else f"{topic}:{'.'.join(filter(None, (*parent, owner))) or 'body'}"
    return Body(name, topic, position, rotation, order, _error(parent, fields))


def _error(parent: Path, fields: Mapping[Path, NumberSource]) -> NumberSource | None:
    error = fields.get((*parent, "mean_marker_error"))
    return error if error is not None and error.shape == () else None


def _is_point(source: NumberSource) -> bool:
    return source.size == 3 and len(source.shape) < 2


def _markers(topic: str, fields: Mapping[Path, NumberSource], metadata: Mapping[str, Any]) -> list[Marker]:
    prefix = "" if topic == MARKERS_TOPIC else f"{topic}:"
    markers: list[Marker] = []
    for path, source in fields.items():
        names = metadata.get("marker_names")
        is_marker = any(_MARKER.search(word) for word in (topic, *path))
        if len(source.shape) == 2 and source.shape[1] == 3 and (is_marker or names is not None):
            markers += _rows(prefix, topic, path, source, names)
        elif _is_point(source) and is_marker:
            name = ".".join(path[1:] if len(path) > 1 and _MARKER.search(path[0]) else path)
            markers.append(Marker(prefix + name, topic, source, MARKER_KINDS.get(path[0], "Marker")))
        elif _is_point(source) and (owner := owner_of(path[-1], POSITION)) is not None and is_body(owner):
            name = ".".join(filter(None, (*path[:-1], owner)))
            markers.append(Marker(f"{prefix}{name}" if name else topic, topic, source))
    return markers


def _rows(prefix: str, topic: str, path: Path, source: NumberSource, names: Any) -> list[Marker]:
    """Return the markers of a field [M, 3]."""
    count = source.shape[0]
    if not isinstance(names, Sequence) or isinstance(names, str) or len(names) != count:
        names = [f"{path[-1]}{number + 1}" for number in range(count)]
    return [
        Marker(f"{prefix}{name}", topic, NumberSource(source.fields, source.shape, 3 * number, 3 * number + 3))
        for number, name in enumerate(names)
    ]


def _joints(topic: str, shapes: Shapes, used: set[Path], metadata: Mapping[str, Any]) -> list[Joint]:
    names = _joint_names(metadata)
    joints: list[Joint] = []
    for path, shape in shapes.items():
        if path in used:
            continue
        suffix = _joint_suffix(path[-1], bool(names))
        is_list = len(shape) == 1 or (shape == () and len(path) == 1)
        if is_list and suffix is not None:
            count = math.prod(shape)
            of = names if len(names) == count else [f"q{number}" for number in range(count)]
            joints += [
                Joint(f"{name}{suffix}", topic, NumberSource((path,), shape, number, number + 1))
                for number, name in enumerate(of)
            ]
        elif shape == () and _GRIPPER.search(path[-1]):
            joints.append(Joint(".".join(path), topic, NumberSource((path,), ())))
    return joints


def _joint_names(metadata: Mapping[str, Any]) -> Sequence[str]:
    names = metadata.get("joint_names")
    return names if isinstance(names, Sequence) and not isinstance(names, str) else ()


def _joint_suffix(name: str, is_named: bool) -> str | None:
    """Return what OpenSim appends to a joint's name for a field of its angle, speed or effort; None for others."""
    for suffix, kinds, if_named in _JOINT_KINDS:
        if any(owner_of(name, kind) == "" for kind in (*kinds, *((if_named,) if is_named else ()))):
            return suffix
    return None
