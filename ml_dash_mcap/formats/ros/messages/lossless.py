"""A message of its own for a topic's rows, which says all that they say.

ROS messages have no optional fields, no None, no lists of several types. What a type cannot say is said beside it:

    std_msgs/Header header
    float64 ts                 the exact time stamp
    uint8[2] field_state       a byte for each field below: 0 missing, 1 present, 2 None, 3 an integer among doubles
    float64[7] q
    uint8[7] q_integers        1 where an element is an integer among doubles
    string note                JSON, where no type fits

A comment in the definition says which field is which key; it survives every tool that copies definitions.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ....rows import packed
from ....rows.encode import TIME_KEY
from .. import ros_names
from .forms import Form

MISSING, PRESENT, NONE, INTEGER = range(4)
"""What a byte of `field_state` says of its field."""

STATE = "field_state"
ROW_KEY = TIME_KEY
"""The key of a field that holds a whole row as JSON; no field of a row has it."""

_MOST_FIELDS = 250
_DEEPEST = 8
_NUMBERS: Mapping[type, str] = {bool: "bool", float: "float64"}
_ARRAYS = {"bool", "float32", "float64", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}
"""The types of numpy that ROS has; arrays of others are JSON."""


@dataclass(frozen=True, slots=True)
class Field:
    """One key of a row, or of a dict in it."""

    key: str
    name: str
    """Of the message's field."""
    kind: str
    """ "bool", "int64", "uint64", "float64", "string", "bytes", "json" or "message"."""
    shape: tuple[int, ...] | None = ()
    """() for one value, (7,) or (4, 4) for lists that always have these lengths, None for lists of any length."""
    message: Message | None = None
    """Of a dict, or of each in a list."""
    integers: str | None = None
    """The field that says which elements of a list are integers among doubles."""
    is_array: bool = False
    """Whether each value is an array of numpy of this type and shape, and no list."""
    names_images: bool = field(default=False, compare=False)
    """Whether the first text was a path that ends like that of a JPEG or PNG file."""


@dataclass(frozen=True, slots=True)
class Message:
    """A message for rows, or for dicts in them."""

    name: str
    """Without its package."""
    fields: tuple[Field, ...]
    is_stated: bool
    """Whether it has `field_state`."""
    is_row: bool = True
    """Whether it has a header and a time stamp."""
    about: Mapping[str, Any] = field(default_factory=dict)
    """What else its definition says, such as the `topic`."""

    def parts(self) -> Iterator[Message]:
        """Yield the messages inside it, then itself."""
        for one in self.fields:
            if one.message is not None:
                yield from one.message.parts()
        yield self


def design(form: Form, topic: str, taken: set[str], *, is_json: bool = False) -> Message:
    """Return the message for a topic's rows.

    Args:
        form: Of the rows.
        topic: Its name.
        taken: Names of messages that are taken; gets those that are used.
        is_json: Whether to hold each row as JSON.
    """
    if is_json:
        row = Field(ROW_KEY, "json", "json")
        taken.add("Json")
        return Message("Json", (row,), False, about={"topic": topic})
    name = ros_names.message(topic, taken)
    taken.add(name)
    if len(form.fields) > _MOST_FIELDS:
        return Message(name, (Field(ROW_KEY, "json", "json"),), False, about={"topic": topic})
    fields, is_stated = _fields(form, name, taken, 0)
    return Message(name, fields, is_stated, about={"topic": topic})


def _fields(form: Form, owner: str, taken: set[str], depth: int) -> tuple[tuple[Field, ...], bool]:
    called = ros_names.fields(form.fields)
    used = {*called.values(), *ros_names.TAKEN_FIELDS}
    fields = []
    is_stated = False
    for key, inner in form.fields.items():
        is_stated = is_stated or inner.count < form.dicts or type(None) in inner.kinds
        made = _field(inner, key, called[key], owner, taken, depth)
        if inner.kinds >= {int, float} and made.kind == "float64":
            is_stated = True
        if made.integers is not None:
            made = Field(key, made.name, made.kind, made.shape, None, ros_names.free(made.integers, used, "_"))
            used.add(str(made.integers))
        fields.append(made)
    return tuple(fields), is_stated


def _field(form: Form, key: str, name: str, owner: str, taken: set[str], depth: int) -> Field:
    kinds = form.kinds - {type(None)}
    number = _number(form)
    if number is not None:
        return Field(key, name, number)
    if kinds == {str} and not form.has_odd_text:
        return Field(key, name, "string", names_images=names_image(form.first_text or ""))
    if kinds == {bytes}:
        return Field(key, name, "bytes")
    if kinds == {dict} and _fits(form, depth):
        return Field(key, name, "message", (), _nested(form, key, owner, taken, depth))
    if kinds == {list} and form.shortest is not None:
        return _list(form, key, name, owner, taken, depth)
    if kinds == {np.ndarray} and len(form.arrays) == 1:
        found = packed.parse(next(iter(form.arrays)))
        if found is not None and found[0] in _ARRAYS and all(found[1]):
            return Field(key, name, found[0], tuple(length or 0 for length in found[1]), is_array=True)
    return Field(key, name, "json")


def _list(form: Form, key: str, name: str, owner: str, taken: set[str], depth: int) -> Field:
    shape: tuple[int, ...] | None = ()
    inner: Form = form
    while inner.kinds == {list} or inner is form:
        if shape is None or inner.items is None:  # ragged lists of lists; empty lists only
            return Field(key, name, "json")
        fits = inner.shortest == inner.longest
        if not fits and shape:
            return Field(key, name, "json")
        shape = (*shape, inner.longest) if fits else None
        inner = inner.items
    number = _number(inner) if type(None) not in inner.kinds else None
    if number is not None:
        integers = f"{name}_integers" if inner.kinds >= {int, float} else None
        return Field(key, name, number, shape, None, integers)
    if shape is None or len(shape) == 1:
        if inner.kinds == {str} and not inner.has_odd_text:
            return Field(key, name, "string", None)
        if inner.kinds == {dict} and _fits(inner, depth):
            return Field(key, name, "message", None, _nested(inner, key, owner, taken, depth))
    return Field(key, name, "json")


def _number(form: Form) -> str | None:
    kinds = form.kinds - {type(None)}
    if kinds == {int}:
        if form.low >= -(2**63) and form.high < 2**63:
            return "int64"
        return "uint64" if form.low >= 0 else None
    if kinds == {int, float}:
        return "float64" if form.is_safe else None
    return _NUMBERS.get(next(iter(kinds))) if len(kinds) == 1 else None


def names_image(path: str) -> bool:
    """Whether a path ends like that of a JPEG or PNG file."""
    return path.lower().endswith((".jpg", ".jpeg", ".png"))


def _fits(form: Form, depth: int) -> bool:
    return 0 < len(form.fields) <= _MOST_FIELDS and depth < _DEEPEST


def _nested(form: Form, key: str, owner: str, taken: set[str], depth: int) -> Message:
    name = ros_names.message(owner + ros_names.message(key), taken)
    taken.add(name)
    fields, is_stated = _fields(form, name, taken, depth + 1)
    return Message(name, fields, is_stated, is_row=False)


def size(shape: tuple[int, ...]) -> int:
    """Return how many elements a list of lists has."""
    count = 1
    for length in shape:
        count *= length
    return count
