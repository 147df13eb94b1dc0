"""Chooses the parts of a recording that go into a take: bodies, markers and joints, or every number."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...errors import ConversionError, ConversionWarning
from ...inspect.field_shapes import Field
from ...meaning import mocap_objects, rotations
from ...meaning.mocap_objects import Body, Joint, Marker, NumberSource, Objects
from ...rows.plain_row import TIME_KEY
from ..export_job import Job


def bodies_and_markers(job: Job, quat_order: str | None) -> tuple[list[Body | Marker], list[Joint]]:
    """Return the bodies of all topics of a job, then their markers; and their joints.

    Raises:
        ConversionError: There are no bodies and no markers.
    """
    topics = found_in(job, quat_order).values()
    things: list[Body | Marker] = [body for objects in topics for body in objects.bodies]
    things += [marker for objects in topics for marker in objects.markers]
    joints = [joint for objects in topics for joint in objects.joints]
    if not things:
        raise ConversionError(_nothing(job, bool(joints)))
    return things, joints


def found_in(job: Job, quat_order: str | None) -> dict[str, Objects]:
    """Return the objects of each topic of a job, also of those that have none."""
    objects: dict[str, Objects] = {}
    for topic, info in job.topics.items():
        if info.metadata.get("quat_order") not in (None, *rotations.ORDERS):
            raise ConversionError(
                f"topic {topic!r}: its metadata says quat_order={info.metadata['quat_order']!r}; 'xyzw' and 'wxyz' are"
                " known. Pass quat_order="
            )
        objects[topic] = mocap_objects.find(topic, numeric(job, topic), info.metadata, quat_order)
    return objects


def numeric(job: Job, topic: str) -> dict[mocap_objects.Path, tuple[int, ...]]:
    """Return the fields of a topic that are numbers, by their keys, with their shapes.

    One that is a position, a rotation or joints by its name, and whose lists have several lengths, is among them with
    the length that it should have: reading it finds the row that differs.
    """
    info = job.topics[topic]
    shapes: dict[mocap_objects.Path, tuple[int, ...]] = {}
    for name, field in info.fields.items():
        shape = tuple(length for length in field.shape if length is not None)
        path = _path(name, info.schema)
        if field.type in ("number", "integer") and len(shape) == len(field.shape):
            shapes[path] = shape
        elif is_ragged(field):
            shape = mocap_objects.expected(path) or ()
            if not shape and mocap_objects.is_joints(path, info.metadata):
                shape = _first_shape(job, topic, name)
            if shape:
                shapes[path] = shape
    return shapes


def is_ragged(field: Field) -> bool:
    """Whether a field has lists of numbers of several lengths."""
    return field.type in ("number", "integer") and field.shape == (None,)


def _first_shape(job: Job, topic: str, name: str) -> tuple[int, ...]:
    """Return the shape of a field of lists in the first row that has it; () if none has."""
    for row in job.part(topic, [name]).flat_rows(TIME_KEY):
        if isinstance(row.get(name), list):
            return (len(row[name]),)
    return ()


def _path(name: str, schema: Mapping[str, Any]) -> mocap_objects.Path:
    """Return the keys of a dotted name: a schema tells a dot inside a key from one between two."""
    properties = schema.get("properties", {})
    if name in properties or "." not in name:
        return (name,)
    for key, inner in properties.items():
        if name.startswith(f"{key}.") and isinstance(inner, dict):
            return (key, *_path(name[len(key) + 1 :], inner))
    return tuple(name.split("."))


def _nothing(job: Job, has_joints: bool) -> str:
    """Return the error text for topics without bodies and markers."""
    names = ", ".join(map(repr, job.topics)) or "none"
    hint = "format='sto' or layout='wide'" if has_joints else "layout='wide'"
    return (
        f"no rigid body and no marker in the topics ({names}): there is no position [3], no quaternion [4], no pose and"
        f" no dict of markers among their fields; export them with {hint}"
    )


def every_number(job: Job, topic: str) -> list[Joint]:
    """Return each number of a topic's rows as a column: `q.0`, `pose.yaw`; warn of lists that have no one length."""
    shapes = numeric(job, topic)
    columns = {".".join(path) for path in shapes}
    for name, field in job.topics[topic].fields.items():
        if is_ragged(field) and name not in columns:
            warnings.warn(
                f"topic {topic!r}: the field {name!r} is left out, for its lists have several lengths",
                ConversionWarning,
                stacklevel=2,
            )
    joints: list[Joint] = []
    for path, shape in shapes.items():
        name = ".".join(path)
        if not shape:
            joints.append(Joint(name, topic, NumberSource((path,), ())))
            continue
        indices = np.ndindex(*shape)
        for number, index in enumerate(indices):
            label = ".".join((name, *map(str, index)))
            joints.append(Joint(label, topic, NumberSource((path,), shape, number, number + 1)))
    return joints
