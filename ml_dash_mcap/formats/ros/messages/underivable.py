"""Checks whether a standard message cannot be derived, whatever values the rows have."""

from __future__ import annotations

from collections.abc import Mapping

from ....meaning import units
from . import conventions, standard
from .conventions import Role
from .standard import Derived


def check(derived: Derived) -> str | None:
    """Return why a message cannot be derived; None if it can, as far as its fields and its metadata tell."""
    ragged = ragged_role(derived)
    if ragged is not None:
        return f"field {derived.key(ragged)!r} is {standard.describe(derived.fields[ragged][-1])}"
    return _check_units(derived) or _check_names(derived)


def ragged_role(derived: Derived) -> str | None:
    """Return the role of a field whose length changes and must not, if there is one; a robot's joints may change."""
    if derived.type == conventions.JOINT_STATE:
        return None
    return next((role for role, way in derived.fields.items() if conventions.is_ragged(way[-1])), None)


def _check_units(derived: Derived) -> str | None:
    stated = derived.metadata.get("units")
    if stated is None:
        return None
    if not isinstance(stated, Mapping):
        return f"its units are {stated!r}; they must be a dict of fields"
    for role, way in derived.fields.items():
        unit = units.of_field(stated, [field.key for field in way])
        quantity = _quantity(derived, role, conventions.ROLES[derived.type][role])
        scale = units.halves(*quantity, unit) if isinstance(quantity, tuple) else units.scale(quantity, unit)
        if scale is None:
            names = quantity if isinstance(quantity, tuple) else (str(quantity),)
            alternatives = "; ".join(f"as {name} these are known: {', '.join(units.UNITS[name])}" for name in names)
            return f"field {derived.key(role)!r} is in {unit!r}; {alternatives}"
    return None


def _quantity(derived: Derived, role: str, meaning: Role) -> str | tuple[str, str] | None:
    is_depth = derived.type == conventions.IMAGE and len(derived.fields[role][-1].shape or ()) == 2
    return "length" if is_depth else meaning.quantity


def _check_names(derived: Derived) -> str | None:
    order = derived.metadata.get("quat_order", "xyzw")
    if order not in ("xyzw", "wxyz"):
        return f"its quat_order is {order!r}; it must be 'xyzw' or 'wxyz'"
    for key in (conventions.FRAME, conventions.CHILD_FRAME):
        frame = derived.metadata.get(key)
        if frame is not None and (not isinstance(frame, str) or "\0" in frame):
            return f"its {key} is {frame!r}; it must be a name"
    return _check_joints(derived) if derived.type == conventions.JOINT_STATE else None


def _check_joints(derived: Derived) -> str | None:
    sizes = joints(derived)
    if len(set(sizes.values())) > 1:
        counts = ", ".join(f"{derived.key(role)!r} has {size}" for role, size in sizes.items())
        return f"its fields have different numbers of joints: {counts}"
    listed = derived.metadata.get("joint_names")
    if listed is None:
        return None
    if not isinstance(listed, (list, tuple)) or not all(isinstance(name, str) and "\0" not in name for name in listed):
        return f"its joint_names are {listed!r}; they must be a list of names"
    for role, size in sizes.items():
        if len(listed) != size:
            return f"its joint_names are {len(listed)}, and {derived.key(role)!r} has {size} values"
    return None


def joints(derived: Derived) -> dict[str, int]:
    """Return how many joints there are by each field of a JointState that says the same for all rows."""
    shapes = {role: way[-1].shape for role, way in derived.fields.items()}
    return {role: shape[0] if shape else 1 for role, shape in shapes.items() if shape is not None}
