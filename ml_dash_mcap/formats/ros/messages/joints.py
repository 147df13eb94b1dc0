"""Turns fields of many rows into the columns of sensor_msgs/JointState, whose joints may change between messages."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import numpy.typing as npt

from ....codecs.ros.message_columns import Column, Constant, Indices, Ragged, texts
from ....errors import ConversionWarning
from . import conventions
from .context import BadRows, Context, Stated

Array = npt.NDArray[Any]

_PARTS = ("position", "velocity", "effort")


def joint_state(context: Context, values: dict[str, Any]) -> dict[str, Column] | BadRows:
    """Return the columns of sensor_msgs/JointState: lists of one length each, or empty."""
    lengths = {role: _lengths(context, value) for role, value in values.items()}
    counts = np.maximum.reduce([*lengths.values()])
    for role, these_lengths in lengths.items():
        odd = (these_lengths != counts) & (these_lengths > 0)
        if odd.any():
            row = int(np.argmax(odd))
            other = next(name for name, others in lengths.items() if others[row] == counts[row])
            what = f"field {context.derived.key(role)!r} has {these_lengths[row]} values"
            return BadRows(odd, f"{what} and {context.derived.key(other)!r} has {counts[row]}")
    names = _names(context, counts)
    if isinstance(names, BadRows):
        return names
    parts = {role: _numbers(context, values[role]) if role in values else Constant([]) for role in _PARTS}
    return {"header": context.header, "name": names, **parts}


def _lengths(context: Context, values: Any) -> Indices:
    if isinstance(values, Ragged):
        return values.lengths
    return np.full(len(context.rows), values.shape[1] if values.ndim > 1 else 1, np.int64)


def _numbers(context: Context, values: Any) -> Column:
    if isinstance(values, Ragged):
        return values._replace(items=np.asarray(values.items, np.float64))
    return values.reshape(len(context.rows), -1).astype(np.float64, copy=False)


def _names(context: Context, counts: Indices) -> Column | BadRows:
    """Return the joints' names: those of the topic's metadata, those of the rows, or numbers."""
    listed = context.derived.metadata.get("joint_names")
    if listed is not None:
        odd = counts != len(listed)
        if not odd.any():
            return Constant(list(listed))
        row = int(np.argmax(odd))
        key = context.derived.key(next(iter(context.derived.fields)))
        return BadRows(odd, f"field {key!r} has {counts[row]} values, and the topic's joint_names are {len(listed)}")
    stated = context.details.get("name")
    if stated is not None:
        return _stated(context, stated, counts)
    if all(way[-1].shape is not None for way in context.derived.fields.values()):
        return Constant(_numbered(context, int(counts[0])))
    _warn(context, "the number of joints changes, and nobody says their names")
    most = _numbered(context, int(counts.max(initial=0)))
    # All rows share one list of names: each value starts at 0 and takes as many names as it has joints.
    return Ragged(texts(most), np.zeros(len(counts), np.int64), counts)


def _stated(context: Context, stated: Stated, counts: Indices) -> Column:
    """Return the names that rows state, and numbered names for rows whose names are not as many as their joints."""
    names: Ragged = stated.values
    fits = stated.is_there & (names.lengths == counts)
    if fits.all():
        return names
    key = context.derived.key("name")
    if stated.is_there.any():
        _warn(context, f"field {key!r} has other numbers of names than there are joints in some rows")
    most = _numbered(context, int(counts.max(initial=0)))
    items: Ragged = names.items
    numbers = texts(most)
    # Stated names and numbered names lie in one column, and each row's start chooses between them.
    both = Ragged(
        np.concatenate([items.items, numbers.items]),
        np.concatenate([items.starts, numbers.starts + len(items.items)]),
        np.concatenate([items.lengths, numbers.lengths]),
    )
    return Ragged(both, np.where(fits, names.starts, len(items.starts)), counts)


def _warn(context: Context, what: str) -> None:
    name = _name(context)
    warnings.warn(
        f"{context.derived.topic}: {what}; such messages have {name}1, {name}2, ...; say joint_names= with the topic,"
        " or have the names in a field 'name'",
        ConversionWarning,
        stacklevel=2,
    )


def _name(context: Context) -> str:
    return conventions.GRIPPER if context.derived.topic.rpartition("/")[2] == conventions.GRIPPER else "joint"


def _numbered(context: Context, count: int) -> list[str]:
    name = _name(context)
    if name == conventions.GRIPPER and count == 1:
        return [name]
    return [f"{name}{number}" for number in range(1, count + 1)]
