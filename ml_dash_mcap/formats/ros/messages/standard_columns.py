"""Turns fields of many rows into the columns of standard messages."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ....codecs.ros.message_columns import Column, Constant, Indices, Ragged, pick
from ....errors import ConversionWarning
from ....meaning import rotations, units
from . import cameras, conventions, joints, stated_texts
from .context import BadRows, Context, Load, Stated
from .lossless import INTEGER, PRESENT, STATE, Message, MessageField
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
        having &= _is_there(message, column, way, count)
    return np.flatnonzero(having)


def _is_there(
    message: Message, column: Mapping[str, Column], way: Sequence[MessageField], count: int
) -> npt.NDArray[np.bool_]:
    """Tell which rows have a field, [N]."""
    having = np.ones(count, np.bool_)
    inner, at = message, column
    for field in way:
        if inner.is_stated:
            states = at[STATE][:, inner.fields.index(field)]
            having &= (states == PRESENT) | (states == INTEGER)
        if field.message is not None:
            inner, at = field.message, at[field.name]
    if inner.is_stated and way[-1].message is inner:  # a dict that is a vector has all of its numbers
        having &= np.isin(at[STATE], (PRESENT, INTEGER)).all(axis=1)
    return having


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
    details = {
        role: Stated(
            _is_there(derived.message, column, way, len(times))[rows], _details(column, derived, role, rows, len(times))
        )
        for role, way in derived.details.items()
    }
    header = {**header, "frame_id": stated_texts.of_header(derived, header["frame_id"], details)}
    return _BUILDERS[derived.type](Context(derived, rows, times, header, load, details), values)


def _at(column: Mapping[str, Column], way: Sequence[MessageField], rows: Indices, count: int) -> Any:
    at: Any = column
    for field in way:
        at = at[field.name]
    return pick(at, rows) if len(rows) < count else at


def _details(column: Mapping[str, Column], derived: Derived, role: str, rows: Indices, count: int) -> Any:
    """Return the values that a field states for a detail, in ROS's unit."""
    way = derived.details[role]
    at = _at(column, way, rows, count)
    detail = conventions.DETAILS.get(derived.type, {}).get(role)
    if detail is None or detail.of is None or detail.of not in derived.fields or isinstance(at, Ragged):
        return at
    of_unit = units.of_field(derived.metadata.get("units"), [field.key for field in derived.fields[detail.of]])
    quantity = conventions.ROLES[derived.type][detail.of].quantity
    scale = units.scale(quantity if isinstance(quantity, str) else None, of_unit)
    assert scale is not None  # `checks` saw to it
    # A variance is in the square of the unit of its quantity.
    return np.asarray(at, np.float64).reshape(len(rows), -1) * scale.factor**2


def _values(column: Mapping[str, Column], derived: Derived, role: str, rows: Indices, count: int) -> Any:
    way = derived.fields[role]
    at = _at(column, way, rows, count)
    if isinstance(at, Ragged):
        return _scaled_lists(derived, role, at)
    if way[-1].message is not None:
        numbers = {inner.key: at[inner.name] for inner in way[-1].message.fields}
        at = np.stack([np.asarray(numbers[key], np.float64) for key in "xyzw" if key in numbers], axis=1)
    at = at.reshape(len(rows), *(conventions.vector_shape(way[-1]) or way[-1].shape or ()))
    quantity = conventions.ROLES[derived.type][role].quantity
    unit = units.of_field(derived.metadata.get("units"), [field.key for field in way])
    if isinstance(quantity, tuple):
        both = units.halves(*quantity, unit)
        assert both is not None  # `checks` saw to it
        return at if both[0].factor == both[1].factor == 1 else at * np.repeat([field.factor for field in both], 3)
    scale = units.scale(quantity, unit)
    assert scale is not None
    if quantity is None or (scale.factor == 1 and not scale.offset):
        return at
    scaled = at * scale.factor + scale.offset
    if role == "pose":  # only its lengths
        scaled = np.array(at, np.float64)
        # The translation is the last column of a 4x4 matrix: elements 3, 7 and 11 row by row.
        places = (..., slice(0, 3), 3) if at.ndim == 3 else (..., [3, 7, 11] if at.shape[-1] == 16 else slice(0, 3))
        scaled[places] *= scale.factor
    return scaled


def _scaled_lists(derived: Derived, role: str, values: Ragged) -> Ragged:
    """Return lists of numbers in ROS's unit; whatever else comes as lists has no unit."""
    quantity = conventions.ROLES[derived.type][role].quantity
    unit = units.of_field(derived.metadata.get("units"), [field.key for field in derived.fields[role]])
    scale = units.scale(quantity, unit) if isinstance(quantity, str) else None
    if scale is None or (scale.factor == 1 and not scale.offset):
        return values
    return values._replace(items=np.asarray(values.items) * scale.factor + scale.offset)


def _pose(context: Context, values: dict[str, Array]) -> dict[str, Column] | BadRows:
    placed = _position_and_orientation(context, values)
    if isinstance(placed, BadRows):
        return placed
    position, quaternions = placed
    return {"header": context.header, "pose": {"position": _xyz(position), "orientation": _xyzw(quaternions)}}


def _transform(context: Context, values: dict[str, Array]) -> dict[str, Column] | BadRows:
    placed = _position_and_orientation(context, values)
    if isinstance(placed, BadRows):
        return placed
    position, quaternions = placed
    transform = {
        "header": {**context.header, "frame_id": stated_texts.parent(context)},
        "child_frame_id": stated_texts.child(context),
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
    of_matrices, bad = rotations.of_matrices(matrices[:, :3, :3])
    bad |= ~(np.abs(matrices[:, 3] - (0, 0, 0, 1)) <= rotations.ORTHONORMAL_TOLERANCE).all(axis=1)
    bad |= ~np.isfinite(of_matrices).all(axis=1)
    if bad.any():
        where = " (row by row, the position in its last column)"
        return BadRows(bad, f"field {context.derived.key('pose')!r} is no pose as a 4x4 matrix{where}")
    # q and -q are the same rotation; w >= 0 picks one of them, so that the result does not depend on the method.
    return matrices[:, :3, 3], np.where(of_matrices[:, 3:] < 0, -of_matrices, of_matrices)


def _oriented(context: Context, given: Array, role: str) -> Array | BadRows:
    """Return unit quaternions x y z w."""
    is_dict = context.derived.fields[role][-1].message is not None  # its keys name its parts
    order = "xyzw" if is_dict else context.derived.metadata.get("quat_order")
    bad = rotations.not_unit(given) | ~np.isfinite(given).all(axis=1)
    key = context.derived.key(role)
    if bad.any():
        return BadRows(bad, f"field {key!r} is no unit quaternion: {given[int(np.argmax(bad))].tolist()}")
    # A recording often starts near the identity, whose number of size 1 is w: at the first place it suggests w x y z.
    if order is None and len(given) and abs(abs(given[0, 0]) - 1) < 1e-6:
        warnings.warn(
            f"{context.derived.topic}: field {key!r} starts with {given[0].tolist()}, which looks like w x y z, and is"
            " taken for x y z w; say quat_order='xyzw' or 'wxyz' with the topic",
            ConversionWarning,
            stacklevel=2,
        )
    return rotations.to_xyzw(given, order or "xyzw")


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
    columns: dict[str, Column] = {
        "header": context.header,
        "orientation": Constant({"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}),
    }
    columns["orientation_covariance"] = Constant(NO_ESTIMATE)
    if "orientation" in values:
        quaternions = _oriented(context, values["orientation"], "orientation")
        if isinstance(quaternions, BadRows):
            return quaternions
        columns["orientation"] = _xyzw(quaternions)
        columns["orientation_covariance"] = _covariance(context, "orientation_covariance")
    for role in ("angular_velocity", "linear_acceleration"):
        columns[role] = _xyz(values[role]) if role in values else zero
        covariance = f"{role}_covariance"
        columns[covariance] = _covariance(context, covariance) if role in values else Constant(NO_ESTIMATE)
    return columns


def _magnetic(context: Context, values: dict[str, Array]) -> dict[str, Column]:
    field = _xyz(values["magnetic_field"])
    covariance = _covariance(context, "magnetic_field_covariance")
    return {"header": context.header, "magnetic_field": field, "magnetic_field_covariance": covariance}


def _temperature(context: Context, values: dict[str, Array]) -> dict[str, Column]:
    variance = context.details.get("variance")
    variances: Column = Constant(0.0)
    if variance is not None:
        variances = np.where(variance.is_there, np.asarray(variance.values, np.float64).reshape(-1), 0.0)
    return {"header": context.header, "temperature": values["temperature"], "variance": variances}


def _covariance(context: Context, role: str) -> Column:
    """Return the covariances of a measured quantity.

    Rows without a covariance have zeros, which mean that it is unknown.
    """
    stated = context.details.get(role)
    if stated is None:
        return Constant(_UNKNOWN)
    matrices = np.asarray(stated.values, np.float64).reshape(len(context.rows), 9)
    return np.where(stated.is_there[:, None], matrices, 0.0)


def _xyz(vectors: Array) -> dict[str, Array]:
    return {name: vectors[:, place] for place, name in enumerate("xyz")}


def _xyzw(quaternions: Array) -> dict[str, Array]:
    return {name: quaternions[:, place] for place, name in enumerate("xyzw")}


_BUILDERS: Mapping[str, Build] = {
    conventions.JOINT_STATE: joints.joint_state,
    conventions.POSE: _pose,
    conventions.TF: _transform,
    conventions.TWIST: _twist,
    conventions.WRENCH: _wrench,
    conventions.IMU: _imu,
    conventions.MAGNETIC: _magnetic,
    conventions.TEMPERATURE: _temperature,
    conventions.CAMERA_INFO: cameras.camera_info,
    conventions.IMAGE: cameras.image,
    conventions.COMPRESSED: cameras.compressed,
}
