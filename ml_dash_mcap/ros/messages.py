"""Fields of many rows to the columns of standard messages."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import ConversionWarning
from ..rows import rotations
from . import cameras, checks, standard, units
from .columns import Column, Constant, Indices, Ragged, pick
from .context import BadRows, Context, Load
from .lossless import INTEGER, PRESENT, STATE, Message
from .standard import Derived

Array = npt.NDArray[Any]

NO_ESTIMATE = (-1.0, *[0.0] * 8)
"""The covariance of what a sensor does not measure (the comment in sensor_msgs/Imu)."""

_UNKNOWN = (0.0,) * 9

Build = Callable[[Context, dict[str, Array]], "dict[str, Column] | BadRows"]


def present(message: Message, column: Mapping[str, Column], derived: Derived, count: int) -> Indices:
    """Return which rows have all fields of a derived message, [N]."""
    having = np.ones(count, np.bool_)
    for way in derived.fields.values():
        inner, at = message, column
        for one in way:
            if inner.is_stated:
                states = at[STATE][:, inner.fields.index(one)]
                having &= (states == PRESENT) | (states == INTEGER)
            if one.message is not None:
                inner, at = one.message, at[one.name]
    return np.flatnonzero(having)


def build(
    derived: Derived,
    column: Mapping[str, Column],
    rows: Indices,
    times: npt.NDArray[np.float64],
    header: Any,
    load: Load | None = None,
) -> dict[str, Column] | BadRows:
    """Return the columns of standard messages.

    Args:
        derived: Which messages.
        column: Of all rows, as `fill` returns it.
        rows: Which of them to take, [N].
        times: Time stamps of all rows, in s.
        header: The messages' header, [N].
        load: Reads the files that fields name, where images are embedded.
    """
    values = {role: _values(column, derived, role, rows, len(times)) for role in derived.fields}
    return _BUILDERS[derived.type](Context(derived, rows, times, header, load), values)


def _values(column: Mapping[str, Column], derived: Derived, role: str, rows: Indices, count: int) -> Any:
    at: Any = column
    way = derived.fields[role]
    for one in way:
        at = at[one.name]
    if len(rows) < count:
        at = pick(at, rows)
    if isinstance(at, Ragged):
        return at
    at = at.reshape(len(rows), *(way[-1].shape or ()))
    quantity = standard.ROLES[derived.type][role].quantity
    unit = units.said(derived.metadata.get("units"), [one.key for one in way])
    if isinstance(quantity, tuple):
        both = units.halves(*quantity, unit)
        assert both is not None  # `checks` saw to it
        return at if both[0].factor == both[1].factor == 1 else at * np.repeat([one.factor for one in both], 3)
    found = units.scale(quantity, unit)
    assert found is not None
    if quantity is None or (found.factor == 1 and not found.offset):
        return at
    scaled = at * found.factor + found.offset
    if role == "pose":  # only its lengths
        scaled = np.array(at, np.float64)
        places = (..., slice(0, 3), 3) if at.ndim == 3 else (..., [3, 7, 11] if at.shape[-1] == 16 else slice(0, 3))
        scaled[places] *= found.factor
    return scaled


def _joint_state(context: Context, values: dict[str, Array]) -> dict[str, Column]:
    count = len(context.rows)
    joints = checks.joints(context.derived)
    listed = context.derived.metadata.get("joint_names")
    found = {
        role: values[role].reshape(count, joints).astype(np.float64, copy=False) if role in values else Constant([])
        for role in ("position", "velocity", "effort")
    }
    is_gripper = context.derived.topic.rpartition("/")[2] == standard.GRIPPER
    name = standard.GRIPPER if is_gripper else "joint"
    called = [f"{name}{number}" for number in range(1, joints + 1)]
    if listed is not None:
        called = list(listed)
    elif is_gripper and joints == 1:
        called = [name]
    return {"header": context.header, "name": Constant(called), **found}


def _pose(context: Context, values: dict[str, Array]) -> dict[str, Column] | BadRows:
    found = _position_and_orientation(context, values)
    if isinstance(found, BadRows):
        return found
    position, quaternions = found
    return {"header": context.header, "pose": {"position": _xyz(position), "orientation": _xyzw(quaternions)}}


def _transform(context: Context, values: dict[str, Array]) -> dict[str, Column] | BadRows:
    found = _position_and_orientation(context, values)
    if isinstance(found, BadRows):
        return found
    position, quaternions = found
    child = str(context.derived.metadata.get("child_frame_id", "")).strip("/")
    transform = {
        "header": context.header,
        "child_frame_id": Constant(child),
        "transform": {"translation": _xyz(position), "rotation": _xyzw(quaternions)},
    }
    count = len(context.rows)
    return {"transforms": Ragged(transform, np.arange(count), np.ones(count, np.int64))}


def _position_and_orientation(context: Context, values: dict[str, Array]) -> tuple[Array, Array] | BadRows:
    if "pose" not in values:
        quaternions = _oriented(context, values["orientation"], "orientation")
        return quaternions if isinstance(quaternions, BadRows) else (values["position"], quaternions)
    pose = values["pose"]
    if pose.ndim == 2 and pose.shape[1] == 7:
        quaternions = _oriented(context, pose[:, 3:], "pose")
        return quaternions if isinstance(quaternions, BadRows) else (pose[:, :3], quaternions)
    matrices = pose.reshape(len(pose), 4, 4)
    found, bad = rotations.of_matrices(matrices[:, :3, :3])
    bad |= ~(np.abs(matrices[:, 3] - (0, 0, 0, 1)) <= rotations.ORTHONORMAL_TOLERANCE).all(axis=1)
    bad |= ~np.isfinite(found).all(axis=1)
    if bad.any():
        where = " (row by row, the position in its last column)"
        return BadRows(bad, f"field {context.derived.key('pose')!r} is no pose as a 4x4 matrix{where}")
    return matrices[:, :3, 3], np.where(found[:, 3:] < 0, -found, found)


def _oriented(context: Context, given: Array, role: str) -> Array | BadRows:
    """Return unit quaternions x y z w."""
    said = context.derived.metadata.get("quat_order")
    bad = rotations.not_unit(given) | ~np.isfinite(given).all(axis=1)
    key = context.derived.key(role)
    if bad.any():
        return BadRows(bad, f"field {key!r} is no unit quaternion: {given[int(np.argmax(bad))].tolist()}")
    if said is None and len(given) and abs(abs(given[0, 0]) - 1) < 1e-6:
        warnings.warn(
            f"{context.derived.topic}: field {key!r} starts with {given[0].tolist()}, which looks like w x y z, and is"
            " taken for x y z w; say quat_order='xyzw' or 'wxyz' with the topic",
            ConversionWarning,
            stacklevel=2,
        )
    return rotations.to_xyzw(given, said or "xyzw")


def _twist(context: Context, values: dict[str, Array]) -> dict[str, Column]:
    linear, angular = _halves(values, "twist", "linear", "angular")
    return {"header": context.header, "twist": {"linear": _xyz(linear), "angular": _xyz(angular)}}


def _wrench(context: Context, values: dict[str, Array]) -> dict[str, Column]:
    force, torque = _halves(values, "wrench", "force", "torque")
    return {"header": context.header, "wrench": {"force": _xyz(force), "torque": _xyz(torque)}}


def _halves(values: dict[str, Array], both: str, first: str, second: str) -> tuple[Array, Array]:
    if both in values:
        return values[both][:, :3], values[both][:, 3:]
    return values[first], values[second]


def _imu(context: Context, values: dict[str, Array]) -> dict[str, Column] | BadRows:
    zero: Any = Constant({"x": 0.0, "y": 0.0, "z": 0.0})
    found: dict[str, Column] = {
        "header": context.header,
        "orientation": Constant({"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}),
    }
    found["orientation_covariance"] = Constant(NO_ESTIMATE)
    if "orientation" in values:
        quaternions = _oriented(context, values["orientation"], "orientation")
        if isinstance(quaternions, BadRows):
            return quaternions
        found["orientation"], found["orientation_covariance"] = _xyzw(quaternions), Constant(_UNKNOWN)
    for role in ("angular_velocity", "linear_acceleration"):
        found[role] = _xyz(values[role]) if role in values else zero
        found[f"{role}_covariance"] = Constant(_UNKNOWN if role in values else NO_ESTIMATE)
    return found


def _magnetic(context: Context, values: dict[str, Array]) -> dict[str, Column]:
    field = _xyz(values["magnetic_field"])
    return {"header": context.header, "magnetic_field": field, "magnetic_field_covariance": Constant(_UNKNOWN)}


def _temperature(context: Context, values: dict[str, Array]) -> dict[str, Column]:
    return {"header": context.header, "temperature": values["temperature"], "variance": Constant(0.0)}


def _xyz(vectors: Array) -> dict[str, Array]:
    return {name: vectors[:, place] for place, name in enumerate("xyz")}


def _xyzw(quaternions: Array) -> dict[str, Array]:
    return {name: quaternions[:, place] for place, name in enumerate("xyzw")}


_BUILDERS: Mapping[str, Build] = {
    standard.JOINT_STATE: _joint_state,
    standard.POSE: _pose,
    standard.TF: _transform,
    standard.TWIST: _twist,
    standard.WRENCH: _wrench,
    standard.IMU: _imu,
    standard.MAGNETIC: _magnetic,
    standard.TEMPERATURE: _temperature,
    standard.CAMERA_INFO: cameras.camera_info,
    standard.IMAGE: cameras.image,
    standard.COMPRESSED: cameras.compressed,
}
