"""Designs a message of its own for a topic's rows, which loses nothing.

ROS messages have no optional fields, no None, no lists of several types. Fields beside those of the row hold what their
types cannot:

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
from dataclasses import dataclass, field, replace
from typing import Any

from ....rows import shape
from ....rows.plain_row import TIME_KEY
from ....rows.shape import Shape
from .. import ros_names

MISSING, PRESENT, NONE, INTEGER = range(4)
"""The values of a byte of `field_state`, which describes one field."""

STATE = "field_state"
ROW_KEY = TIME_KEY
"""The key of a field that holds a whole row as JSON; no field of a row has it."""

_MOST_FIELDS = 250
_DEEPEST = 8
_NUMBERS = {shape.BOOLEAN: "bool", shape.FLOAT64: "float64"}
_ARRAYS = {"bool", "float32", "float64", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}
"""The types of numpy that ROS has; arrays of others are JSON."""


@dataclass(frozen=True, slots=True)
class MessageField:
    """One key of a row, or of a dict in it."""

    key: str
    name: str
    """The name of the message's field."""
    kind: str
    """ "bool", "int64", "uint64", "float64", "string", "bytes", "json" or "message"."""
    shape: tuple[int, ...] | None = ()
    """() for one value, (7,) or (4, 4) for lists that always have these lengths, None for lists of any length."""
    message: Message | None = None
    """The message of a dict, or of each dict in a list."""
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
    fields: tuple[MessageField, ...]
    is_stated: bool
    """Whether it has `field_state`."""
    is_row: bool = True
    """Whether it has a header and a time stamp."""
    about: Mapping[str, Any] = field(default_factory=dict)
    """Other entries of its definition's comment, such as the `topic`."""

    def parts(self) -> Iterator[Message]:
        """Yield the messages inside it, then itself."""
        for member in self.fields:
            if member.message is not None:
                yield from member.message.parts()
        yield self


def design(rows: Shape, topic: str, taken: set[str], *, is_json: bool = False) -> Message:
    """Return the message for a topic's rows.

    Args:
        rows: Their shape; time stamps in it do not count.
        topic: Its name.
        taken: Names of messages that are taken; gets those that are used.
        is_json: Whether to hold each row as JSON.
    """
    if is_json:
        row = MessageField(ROW_KEY, "json", "json")
        taken.add("Json")
        return Message("Json", (row,), False, about={"topic": topic})
    name = ros_names.message(topic, taken)
    taken.add(name)
    rows = replace(rows, fields={key: values for key, values in rows.fields.items() if key != TIME_KEY})
    if len(rows.fields) > _MOST_FIELDS:
        return Message(name, (MessageField(ROW_KEY, "json", "json"),), False, about={"topic": topic})
    fields, is_stated = _fields(rows, name, taken, 0)
    return Message(name, fields, is_stated, about={"topic": topic})


def _fields(dicts: Shape, owner: str, taken: set[str], depth: int) -> tuple[tuple[MessageField, ...], bool]:
    called = ros_names.fields(dicts.fields)
    used = {*called.values(), *ros_names.TAKEN_FIELDS}
    fields = []
    is_stated = False
    for key, values in dicts.fields.items():
        is_stated = is_stated or key in dicts.optional or values.has_nulls
        made = _field(values, key, called[key], owner, taken, depth)
        if _are_mixed_numbers(values) and made.kind == "float64":
            is_stated = True
        if made.integers is not None:
            made = MessageField(key, made.name, made.kind, made.shape, None, ros_names.free(made.integers, used, "_"))
            used.add(str(made.integers))
        fields.append(made)
    return tuple(fields), is_stated


def _field(values: Shape, key: str, name: str, owner: str, taken: set[str], depth: int) -> MessageField:
    kinds = values.value_kinds
    number = _number(values)
    if number is not None:
        return MessageField(key, name, number)
    if _are_plain_texts(values):
        return MessageField(key, name, "string", names_images=names_image(values.first_text or ""))
    if kinds == shape.BYTES:
        return MessageField(key, name, "bytes")
    if kinds == shape.DICT and _fits(values, depth):
        return MessageField(key, name, "message", (), _nested(values, key, owner, taken, depth))
    if kinds == shape.LIST:
        return _list(values, key, name, owner, taken, depth)
    array = values.array
    if kinds == shape.ARRAY and array is not None and array.is_plain and array.dtype in _ARRAYS and array.lengths:
        lengths = tuple(length for length in array.lengths if length)
        if len(lengths) == len(array.lengths):
            return MessageField(key, name, array.dtype, lengths, is_array=True)
    return MessageField(key, name, "json")


def _list(lists: Shape, key: str, name: str, owner: str, taken: set[str], depth: int) -> MessageField:
    lengths: tuple[int, ...] | None = ()
    values = lists
    while values.value_kinds == shape.LIST and (values is lists or not values.has_nulls):
        if lengths is None or values.items is None or not values.items.kinds:  # ragged lists of lists; only empty lists
            return MessageField(key, name, "json")
        is_fixed = values.shortest == values.longest
        if not is_fixed and lengths:
            return MessageField(key, name, "json")
        lengths = (*lengths, values.longest) if is_fixed else None
        values = values.items
    number = None if values.has_nulls else _number(values)
    if number is not None:
        integers = f"{name}_integers" if _are_mixed_numbers(values) else None
        return MessageField(key, name, number, lengths, None, integers)
    if (lengths is None or len(lengths) == 1) and not values.has_nulls:
        if _are_plain_texts(values):
            return MessageField(key, name, "string", None)
        if values.value_kinds == shape.DICT and _fits(values, depth):
            return MessageField(key, name, "message", None, _nested(values, key, owner, taken, depth))
    return MessageField(key, name, "json")


def _number(values: Shape) -> str | None:
    kinds = values.value_kinds
    if kinds == shape.INTEGER:
        # UNSIGNED marks numbers above 2**63 - 1, for which int64 has no room; HUGE ones need more than 64 bits.
        if not values.kinds & shape.UNSIGNED:
            return None if values.kinds & shape.HUGE else "int64"
        return None if values.kinds & (shape.NEGATIVE | shape.HUGE) else "uint64"
    if kinds == shape.INTEGER | shape.FLOAT64:
        return "float64" if values.is_exact_as_doubles else None
    return _NUMBERS.get(kinds)


def _are_mixed_numbers(values: Shape) -> bool:
    """Whether there are integers and fractions among some values."""
    return bool(values.kinds & shape.INTEGER and values.kinds & shape.FLOAT64)


def _are_plain_texts(values: Shape) -> bool:
    """Whether all values are texts that ROS has a place for."""
    return values.value_kinds == shape.TEXT and not values.kinds & (shape.HAS_NUL | shape.HAS_SURROGATE)


def names_image(path: str) -> bool:
    """Whether a path ends like that of a JPEG or PNG file."""
    return path.lower().endswith((".jpg", ".jpeg", ".png"))


def _fits(dicts: Shape, depth: int) -> bool:
    return 0 < len(dicts.fields) <= _MOST_FIELDS and depth < _DEEPEST


def _nested(dicts: Shape, key: str, owner: str, taken: set[str], depth: int) -> Message:
    name = ros_names.message(owner + ros_names.message(key), taken)
    taken.add(name)
    fields, is_stated = _fields(dicts, name, taken, depth + 1)
    return Message(name, fields, is_stated, is_row=False)


def size(shape: tuple[int, ...]) -> int:
    """Return how many elements a list of lists has."""
    count = 1
    for length in shape:
        count *= length
    return count
