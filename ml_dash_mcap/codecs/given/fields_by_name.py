"""Sets the fields of protobuf messages from dicts, by name, and refuses what does not fit them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields as dataclass_fields
from dataclasses import is_dataclass
from typing import Any

from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.message import Message

from ...rows import foreign_values
from ...suggestions import hint
from ..proto import wire
from ..protobuf_messages import is_repeated
from . import known_messages, scalar_values
from .unfit_values import UnfitValueError, shown, takes

Setter = Callable[[Message, Any, int], None]
"""Sets one field of a message; the last argument is how many messages that one lies in."""

_MOST_LEVELS = 100
"""So many messages may lie in each other: readers of protobuf refuse more."""

_BULK = 64
"""Arrays of more elements than this become fields without a list between."""


class FieldsByName:
    """The fields of one type of message. Made once, and used by any thread."""

    def __init__(self, descriptor: Descriptor, others: dict[str, FieldsByName] | None = None) -> None:
        """Prepare for a type of message.

        Args:
            descriptor: Of the type.
            others: The types that are prepared already, by full name. Messages may contain each other.
        """
        others = {} if others is None else others
        others[descriptor.full_name] = self
        self.name: str = descriptor.full_name
        self._setters: dict[str, Setter] = {field.name: _setter(field, others) for field in descriptor.fields}
        self._choices = [[field.name for field in oneof.fields] for oneof in descriptor.oneofs if len(oneof.fields) > 1]

    def fill(self, message: Message, row: Mapping[Any, Any], depth: int = 0) -> None:
        """Set fields of a new message.

        Args:
            message: Of the type.
            row: Values by field name.
            depth: How many messages it lies in.

        Raises:
            UnfitValueError: There is no such field, or a value does not fit.
        """
        setters = self._setters
        for name, value in row.items():
            setter = setters.get(name)
            if setter is None:
                raise UnfitValueError(f"is not a field of {self.name}; {hint(name, setters)}", *_as_path(name))
            try:
                setter(message, value, depth)
            except UnfitValueError as unfit:
                raise unfit.within(name) from unfit.__cause__
        for names in self._choices:
            given = [name for name in names if row.get(name) is not None]
            if len(given) > 1:
                raise UnfitValueError(f"and {given[1]!r} of {self.name} exclude each other; pass one of them", given[0])


def _as_path(name: object) -> tuple[str]:
    return (name if isinstance(name, str) else repr(name),)


def _setter(field: FieldDescriptor, others: dict[str, FieldsByName]) -> Setter:
    inner = field.message_type
    if inner is not None and inner.GetOptions().map_entry:
        return _map_setter(field, others)
    if is_repeated(field):
        return _repeated_setter(field) if inner is None else _messages_setter(field, others)
    return _scalar_setter(field) if inner is None else _message_setter(field, others)


# -- one value ---------------------------------------------------------------------------------------------------------


def _scalar_setter(field: FieldDescriptor) -> Setter:
    name, convert = field.name, scalar_values.converter(field)
    may_be_absent = bool(field.has_presence)
    plain_type = scalar_values.plain_type(field)

    def set_scalar(message: Message, value: Any, depth: int) -> None:
        if value.__class__ is plain_type:
            try:
                setattr(message, name, value)
                return
            except (TypeError, ValueError):  # out of range, or no Unicode: the converter says so better
                convert(value)
                raise
        if value is None:
            if not may_be_absent:  # a reader would see 0 or an empty text
                raise UnfitValueError(f"takes a {scalar_values.type_name(field)} and has no null; leave it out")
            return
        setattr(message, name, convert(value))

    return set_scalar


def _message_setter(field: FieldDescriptor, others: dict[str, FieldsByName]) -> Setter:
    name, fill = field.name, _filler(field.message_type, others)

    def set_message(message: Message, value: Any, depth: int) -> None:
        if value is None and not takes_none:
            return
        target = getattr(message, name)
        target.SetInParent()
        fill(target, value, depth + 1)

    takes_none = known_messages.takes_none(field.message_type)
    return set_message


def _filler(descriptor: Descriptor, others: dict[str, FieldsByName]) -> Setter:
    """Return the function that gives a new message of a type its value."""
    from_python = known_messages.converter(descriptor)
    inner = others.get(descriptor.full_name) or FieldsByName(descriptor, others)

    def fill(target: Message, value: Any, depth: int) -> None:
        if depth >= _MOST_LEVELS:
            raise UnfitValueError(f"lies in more than {_MOST_LEVELS} other messages; readers refuse that")
        if isinstance(value, Message):
            _copy(target, value)
        elif from_python is not None and from_python(target, value):
            pass
        elif isinstance(value, Mapping):
            inner.fill(target, value, depth)
        elif is_dataclass(value) and not isinstance(value, type):
            inner.fill(target, {each.name: getattr(value, each.name) for each in dataclass_fields(value)}, depth)
        else:
            raise takes(known_messages.expected(descriptor), value)

    return fill


def _copy(target: Message, value: Message) -> None:
    """Give a field of a message type the value of a message of that type."""
    expected, given = target.DESCRIPTOR, value.DESCRIPTOR
    if given is expected:
        target.CopyFrom(value)
    elif given.full_name == expected.full_name:  # generated twice: a dict says the same of both
        target.MergeFromString(value.SerializePartialToString())
    elif not known_messages.pack(target, value):
        raise UnfitValueError(f"takes a message of type {expected.full_name}; this one is a {given.full_name}")


# -- many values -------------------------------------------------------------------------------------------------------


def _repeated_setter(field: FieldDescriptor) -> Setter:
    name, convert, are_fitting = field.name, scalar_values.converter(field), scalar_values.array_check(field)
    what = f"a list of {scalar_values.type_name(field)} values"
    wire_dtype = scalar_values.wire_dtype(field)
    plain_types = {scalar_values.plain_type(field)} if field.cpp_type in _ALWAYS_FIT else set()

    def set_values(message: Message, value: Any, depth: int) -> None:
        values = _listed(value, what)
        if isinstance(values, list):
            is_fitting = bool(plain_types) and set(map(type, values)) <= plain_types
        elif not are_fitting(values):
            is_fitting, values = False, values.tolist()
        elif wire_dtype is not None and len(values) > _BULK:
            # The same values as bytes: a third of the time for a long array.
            message.MergeFromString(wire.delimited(field.number, values.astype(wire_dtype).tobytes()))
            return
        else:
            is_fitting, values = True, values.tolist()
        getattr(message, name).extend(values if is_fitting else _converted(values, convert))

    return set_values


_ALWAYS_FIT = (FieldDescriptor.CPPTYPE_DOUBLE, FieldDescriptor.CPPTYPE_BOOL)
"""Types of which every value of the plain type fits."""


def _converted(values: Any, convert: Callable[[Any], Any]) -> list[Any]:
    converted = []
    for index, value in enumerate(values):
        try:
            converted.append(convert(value))
        except UnfitValueError as unfit:
            raise unfit.within(index) from unfit.__cause__
    return converted


def _listed(value: Any, what: str) -> Any:
    """Return a list, or an array of numpy, [N], of what is given as one."""
    if isinstance(value, list):
        return value
    if isinstance(value, tuple):
        return list(value)
    if value is None or isinstance(value, (str, bytes, bytearray, Mapping, Message)):
        raise takes(what, value)
    array = foreign_values.array_of(value)
    if array is None:
        instead = getattr(value, "tolist", None)
        listed = instead() if callable(instead) else None
        if not isinstance(listed, list):
            raise UnfitValueError(f"takes {what}, not {shown(value)}; {foreign_values.advice(value)}")
        return listed
    if array.ndim != 1:
        raise UnfitValueError(f"takes {what}; the array has the shape {array.shape}: pass array.ravel()")
    if scalar_values.is_masked(array):
        raise UnfitValueError(
            f"takes {what}; the array has masked elements: pass array.compressed() or array.filled(...)"
        )
    return array


def _messages_setter(field: FieldDescriptor, others: dict[str, FieldsByName]) -> Setter:
    name, fill = field.name, _filler(field.message_type, others)
    what = f"a list of {scalar_values.type_name(field)} messages"

    def set_messages(message: Message, value: Any, depth: int) -> None:
        target = getattr(message, name)
        for index, inner in enumerate(_listed(value, what)):
            try:
                fill(target.add(), inner, depth + 1)
            except UnfitValueError as unfit:
                raise unfit.within(index) from unfit.__cause__

    return set_messages


def _map_setter(field: FieldDescriptor, others: dict[str, FieldsByName]) -> Setter:
    key, inner = (field.message_type.fields_by_name[part] for part in ("key", "value"))
    name, of_key = field.name, _key_converter(key)
    what = f"a dict of {scalar_values.type_name(key)} to {scalar_values.type_name(inner)}"
    fill = None if inner.message_type is None else _filler(inner.message_type, others)
    convert = scalar_values.converter(inner) if fill is None else None

    def set_map(message: Message, value: Any, depth: int) -> None:
        if not isinstance(value, Mapping):
            raise takes(what, value)
        target = getattr(message, name)
        for place, entry in value.items():
            try:
                if fill is not None:
                    fill(target[of_key(place)], entry, depth + 1)
                elif convert is not None:
                    target[of_key(place)] = convert(entry)
            except UnfitValueError as unfit:
                raise unfit.within(*_as_path(place)) from unfit.__cause__

    return set_map


def _key_converter(field: FieldDescriptor) -> Callable[[Any], Any]:
    """Return the function that checks a key. Rows that were read have text for every key, so that is taken too."""
    convert = scalar_values.converter(field)
    if field.cpp_type == FieldDescriptor.CPPTYPE_STRING:
        return convert
    if field.cpp_type == FieldDescriptor.CPPTYPE_BOOL:
        return lambda key: convert({"true": True, "false": False}.get(key, key) if isinstance(key, str) else key)
    return lambda key: convert(_as_integer(key) if isinstance(key, str) else key)


def _as_integer(key: str) -> Any:
    return int(key) if key.removeprefix("-").isdecimal() and key.isascii() and len(key) < 21 else key
