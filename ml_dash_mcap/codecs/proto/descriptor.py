"""Writes a layout as a set of file descriptors, as the Schema record of MCAP has it, and reads it back.

The descriptor says all that a layout does: what no .proto file can say (the key where it is no identifier, the lengths
of matrices) stands in an option of each field, which other readers pass over.

Sources: https://github.com/protocolbuffers/protobuf/blob/main/src/google/protobuf/descriptor.proto,
https://mcap.dev/spec/registry#protobuf
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import orjson
from google.protobuf import descriptor_pb2
from google.protobuf.message import DecodeError

from ...rows import packed_arrays
from . import names, wire
from .layout import EXACT_NUMBER, MOST_DEPTH, TIME_NUMBER, Kind, Layout, Member, Slot

OPTION_NUMBER = 51_700
"""The number of our option of fields and messages, from the range that protobuf leaves to organisations."""

_VERSION = 1

_FieldProto = descriptor_pb2.FieldDescriptorProto
_TYPES = {
    Kind.DOUBLE: _FieldProto.TYPE_DOUBLE,
    Kind.INT: _FieldProto.TYPE_SFIXED64,
    Kind.UINT: _FieldProto.TYPE_FIXED64,
    Kind.BOOL: _FieldProto.TYPE_BOOL,
    Kind.TEXT: _FieldProto.TYPE_STRING,
    Kind.BYTES: _FieldProto.TYPE_BYTES,
    Kind.DICT: _FieldProto.TYPE_MESSAGE,
    Kind.ARRAY: _FieldProto.TYPE_MESSAGE,
}

_PAD_NUMBER = 15
"""A field that FileDescriptorSet does not have: readers pass over it."""

_PAD_HEAD = wire.tag(_PAD_NUMBER, wire.DELIMITED)
_LEAST_PAD = _PAD_HEAD + b"\0"


# -- writing -----------------------------------------------------------------------------------------------------------


def full_name(topic: str) -> str:
    """Return the name of the message of a topic's rows, with its package."""
    return ".".join(names.of_topic(topic))


def encode(layout: Layout, topic: str) -> bytes:
    """Return the serialized `google.protobuf.FileDescriptorSet` of a topic's rows, with the least padding.

    Args:
        layout: Of the rows.
        topic: Its name.
    """
    content: bytes = file_set(layout, topic).SerializeToString(deterministic=True)
    return content + _LEAST_PAD


def file_set(layout: Layout, topic: str) -> descriptor_pb2.FileDescriptorSet:
    """Return the file descriptors of a topic's rows."""
    package, name = names.of_topic(topic)
    file = descriptor_pb2.FileDescriptorProto(
        name=f"{package.replace('.', '/')}/{name}.proto", package=package, syntax="proto3"
    )
    _write_message(file.message_type.add(), layout, name, f".{package}.{name}", f".{package}.{name}.{names.ARRAY_NAME}")
    return descriptor_pb2.FileDescriptorSet(file=[file])


def _write_message(message: Any, layout: Layout, name: str, path: str, array_type: str) -> None:
    message.name = name
    units = {"units": dict(layout.units)} if layout.units else {}
    _set_option(message.options, {"ml_dash": _VERSION, **units} if layout.is_row else {})
    if layout.is_row:
        _write_single(message, names.TIME_NAME, TIME_NUMBER, _TYPES[Kind.DOUBLE])
        exact = _write_single(message, names.EXACT_NAME, EXACT_NUMBER, _TYPES[Kind.TEXT])
        _set_option(exact.options, {"opaque": list(layout.opaque)} if layout.opaque else {})
    name_of = names.of_members(layout)
    dicts = [member for member in layout.members if member.inner is not None]
    inner_names = names.of_inner(name_of.values(), [member.key for member in dicts])
    inner_name_of = {member.number: inner for member, inner in zip(dicts, inner_names, strict=True)}
    for member in layout.members:
        field = _write_field(message, member, name_of[member.number])
        if member.inner is not None:
            inner_name = inner_name_of[member.number]
            field.type_name = f"{path}.{inner_name}"
            _write_message(message.nested_type.add(), member.inner, inner_name, field.type_name, array_type)
        elif member.slot.kind is Kind.ARRAY:
            field.type_name = array_type
    used = {field.name for field in message.field}
    for index, single in enumerate(field for field in message.field if field.proto3_optional):
        single.oneof_index = index
        message.oneof_decl.add(name=names.of_oneof(single.name, used))
    if layout.is_row and _has_arrays(layout):
        _write_array_message(message.nested_type.add())


def _write_field(message: Any, member: Member, name: str) -> Any:
    type_ = _TYPES[member.slot.kind]
    if member.slot.is_list:
        field = message.field.add(name=name, number=member.number, label=_FieldProto.LABEL_REPEATED, type=type_)
    elif member.slot.kind.struct_code is None and type_ == _FieldProto.TYPE_MESSAGE:
        field = message.field.add(name=name, number=member.number, label=_FieldProto.LABEL_OPTIONAL, type=type_)
    else:
        field = _write_single(message, name, member.number, type_)
    entries: dict[str, Any] = {} if name == member.key else {"key": member.key}
    if member.slot.lengths:
        entries["lengths"] = list(member.slot.lengths)
    if member.array:
        entries["array"] = member.array
    _set_option(field.options, entries)
    return field


def _write_single(message: Any, name: str, number: int, type_: int) -> Any:
    """Write a field of which a reader can tell whether it is there."""
    return message.field.add(
        name=name, number=number, label=_FieldProto.LABEL_OPTIONAL, type=type_, proto3_optional=True
    )


def _write_array_message(message: Any) -> None:
    message.name = names.ARRAY_NAME
    message.field.add(name="type", number=1, label=_FieldProto.LABEL_OPTIONAL, type=_FieldProto.TYPE_STRING)
    message.field.add(name="data", number=2, label=_FieldProto.LABEL_OPTIONAL, type=_FieldProto.TYPE_BYTES)


def _has_arrays(layout: Layout) -> bool:
    return any(
        member.slot.kind is Kind.ARRAY or (member.inner is not None and _has_arrays(member.inner))
        for member in layout.members
    )


def _set_option(options: Any, entries: dict[str, Any]) -> None:
    if entries:
        options.MergeFromString(wire.delimited(OPTION_NUMBER, orjson.dumps(entries)))


# -- padding -----------------------------------------------------------------------------------------------------------


def padded(schema: bytes, length: int) -> bytes:
    """Return a set of file descriptors at a length.

    Args:
        schema: As `encode` returns it.
        length: Of the result, in bytes.

    Raises:
        ValueError: It does not fit.
    """
    content = schema.removesuffix(_LEAST_PAD)
    return content + _pad(length - len(content))


def _pad(length: int) -> bytes:
    """Return fields without a meaning that have so many bytes together."""
    if length < len(_LEAST_PAD):
        raise ValueError(f"a padding has at least {len(_LEAST_PAD)} bytes, not {length}")
    for head in range(2, 7):
        encoded = wire.varint(length - head) if length >= head else b""
        if encoded and len(_PAD_HEAD) + len(encoded) == head:
            return _PAD_HEAD + encoded + b" " * (length - head)
    return _LEAST_PAD + _pad(length - len(_LEAST_PAD))  # a length that needs one byte more than it leaves


# -- reading -----------------------------------------------------------------------------------------------------------


def decode(schema: bytes, message: str) -> Layout | None:
    """Return the layout that a set of file descriptors says; None for descriptors that are not of our writing.

    Args:
        schema: A serialized `google.protobuf.FileDescriptorSet`.
        message: The full name of the message of the rows.
    """
    try:
        files = descriptor_pb2.FileDescriptorSet.FromString(schema)
        for file in files.file:
            for proto in file.message_type:
                if f"{file.package}.{proto.name}" == message and entries_of(proto.options).get("ml_dash") == _VERSION:
                    return _read_row(proto, f".{message}")
    except (DecodeError, ValueError):  # not of our writing, though it may say so: the rules below are ours
        return None
    return None


_HEAD_OF_ROWS = [
    (TIME_NUMBER, names.TIME_NAME, _TYPES[Kind.DOUBLE], _FieldProto.LABEL_OPTIONAL),
    (EXACT_NUMBER, names.EXACT_NAME, _TYPES[Kind.TEXT], _FieldProto.LABEL_OPTIONAL),
]
"""The fields with which each message of a row begins."""


def _read_row(proto: Any, path: str) -> Layout:
    head = [(field.number, field.name, field.type, field.label) for field in proto.field[: len(_HEAD_OF_ROWS)]]
    _require(head == _HEAD_OF_ROWS, "the time stamp and the exact text come first")
    opaque = entries_of(proto.field[1].options).get("opaque", [])
    _require(isinstance(opaque, list) and all(isinstance(path, str) for path in opaque), "opaque values have paths")
    members = _Members(f"{path}.{names.ARRAY_NAME}").read(proto, proto.field[len(_HEAD_OF_ROWS) :], path)
    _require(all(member.number > EXACT_NUMBER for member in members), "the first numbers are taken")
    units = entries_of(proto.options).get("units", {})
    is_text = isinstance(units, dict) and all(isinstance(unit, str) for unit in units.values())
    _require(is_text, "units are texts")
    return Layout(members, is_row=True, opaque=tuple(opaque), units=tuple(units.items()))


class _Members:
    """Reads the fields of a message and of the messages inside."""

    def __init__(self, array_type: str) -> None:
        """Take the name of the message of arrays, with a dot before it."""
        self._array_type = array_type

    def read(self, message: Any, fields: Iterable[Any], path: str, depth: int = 0) -> tuple[Member, ...]:
        """Read the fields of one message.

        Args:
            message: Of the fields.
            fields: All that hold values of the row.
            path: The full name of the message, with a dot before it.
            depth: In how many messages this one lies.

        Raises:
            ValueError: They are not of our writing.
        """
        _require(depth <= MOST_DEPTH, "dicts in each other have a limit")
        inner_protos = {f"{path}.{inner.name}": inner for inner in message.nested_type}
        members: list[Member] = []
        slots: set[tuple[str, Slot]] = set()
        for field in fields:
            key, slot = _read_slot(field, self._array_type)
            inner = None
            if slot.kind is Kind.DICT:
                # Each message inside is that of one field: a hostile file could have a tree without end otherwise.
                inner_proto = inner_protos.pop(field.type_name, None)
                _require(inner_proto is not None, "each dict has its message")
                inner = Layout(self.read(inner_proto, inner_proto.field, field.type_name, depth + 1))
            _require(field.number > (members[-1].number if members else 0), "the numbers rise")
            _require((key, slot) not in slots, "a key has one field for each type")
            slots.add((key, slot))
            members.append(Member(field.number, key, slot, inner, _read_array(field, slot)))
        return tuple(members)


def _read_slot(field: Any, array_type: str) -> tuple[str, Slot]:
    kind = next((kind for kind, type_ in _TYPES.items() if type_ == field.type), None)
    if kind is Kind.DICT and field.type_name == array_type:
        kind = Kind.ARRAY
    entries = entries_of(field.options)
    key, lengths = entries.get("key", field.name), entries.get("lengths", [])
    if kind is None or not isinstance(key, str) or not _are_lengths(lengths):
        raise ValueError("a field has a key and a type of rows")
    is_list = field.label == _FieldProto.LABEL_REPEATED
    _require(is_list or field.label == _FieldProto.LABEL_OPTIONAL, "no field is required")
    _require(not lengths or (is_list and kind.is_packed), "only lists of numbers are lists of lists")
    _require(not is_list or kind is not Kind.ARRAY, "arrays are single values")
    return key, Slot(kind, tuple(lengths) if is_list else None)


def _read_array(field: Any, slot: Slot) -> str:
    """Return the description of the arrays of a field; empty if it has none."""
    described = entries_of(field.options).get("array", "")
    is_known = isinstance(described, str) and (described in ("", "array") or packed_arrays.parse(described) is not None)
    _require(is_known and (not described or slot.kind is Kind.ARRAY), "only arrays have a type and a shape of numpy's")
    return str(described)


def _require(is_so: bool, rule: str) -> None:
    if not is_so:
        raise ValueError(f"the layout is not of our writing: {rule}")


def _are_lengths(lengths: object) -> bool:
    return isinstance(lengths, list) and all(type(length) is int and 0 < length < 2**31 for length in lengths)


def entries_of(options: Any) -> dict[str, Any]:
    """Return the entries of our option; none where there is none.

    Raises:
        ValueError: They cannot be read.
    """
    data = options.SerializeToString()
    for field in wire.fields(data):
        if field.number == OPTION_NUMBER and field.wire_type == wire.DELIMITED:
            entries = orjson.loads(data[field.value_start : field.end])
            return entries if isinstance(entries, dict) else {}
    return {}
