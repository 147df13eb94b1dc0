"""Decodes protobuf messages of any type by the descriptors that a channel has."""

from __future__ import annotations

import functools
from collections.abc import Callable
from operator import itemgetter
from typing import Any

from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.message import DecodeError, Message
from mcap.records import Schema as SchemaRecord
from mcap_protobuf.decoder import DecoderFactory

from ..errors import EncodingError
from .encoded_channel import Row

Convert = Callable[[Any], Any]


@functools.lru_cache(maxsize=256)
def decoder(name: str, data: bytes) -> Callable[[bytes], Row]:
    """Return the function that turns a message's bytes into a row, with the fields as its .proto file has them.

    Messages are dicts, repeated fields lists, maps dicts with text for keys, enums the names of their values (or the
    number, of one that the schema does not know). A field that can tell whether it was set is left out if it was not.
    The function raises a `ValueError` for bytes that are no such message.

    Args:
        name: The name of the message, such as `foxglove.LaserScan`.
        data: A serialized `google.protobuf.FileDescriptorSet`.

    Raises:
        EncodingError: The descriptors are broken, or lack that message.
    """
    try:
        parse = DecoderFactory().decoder_for("protobuf", SchemaRecord(id=1, name=name, encoding="protobuf", data=data))
        empty = parse(b"") if parse is not None else None
    except Exception as error:  # the descriptor pool's errors have no common class
        raise EncodingError(f"{type(error).__name__}: {error}") from error
    if parse is None or empty is None:
        raise EncodingError("no message is described")
    message_class, convert = type(empty), _Rows().of(empty.DESCRIPTOR)

    def decode(payload: bytes) -> Row:
        try:
            message = message_class.FromString(payload)
        except DecodeError as error:
            raise ValueError(str(error)) from error
        row: Row = convert(message)
        return row

    return decode


class _Rows:
    """Converters of each kind of message. Messages may contain each other."""

    def __init__(self) -> None:
        self._converters: dict[str, Convert] = {}

    def of(self, descriptor: Descriptor) -> Convert:
        converter = self._converters.get(descriptor.full_name)
        if converter is not None:
            return converter
        fields: list[tuple[str, bool, Convert | None]] = []

        def convert(message: Message) -> Row:
            row: Row = {}
            for name, may_be_absent, convert_value in fields:
                if may_be_absent and not message.HasField(name):
                    continue
                value = getattr(message, name)
                row[name] = value if convert_value is None else convert_value(value)
            return row

        # Before its fields are looked at, because a message may contain itself.
        self._converters[descriptor.full_name] = convert
        fields += [(field.name, field.has_presence, self._of_field(field)) for field in descriptor.fields]
        return convert

    def _of_field(self, field: FieldDescriptor) -> Convert | None:
        """Return the converter of a field's value; None if the value stays as it is."""
        inner = field.message_type
        if inner is not None and inner.GetOptions().map_entry:
            return _map(inner.fields_by_name["key"], self._of_value(inner.fields_by_name["value"]))
        of_value = self._of_value(field)
        if not is_repeated(field):
            return of_value
        return _AS_LIST if of_value is None else lambda values: [of_value(value) for value in values]

    def _of_value(self, field: FieldDescriptor) -> Convert | None:
        if field.message_type is not None:
            return self.of(field.message_type)
        if field.enum_type is not None:
            # Reversed, so that of several names of one number (allow_alias) the first one counts.
            names = {value.number: value.name for value in reversed(field.enum_type.values)}
            return lambda number: names.get(number, number)
        return None


def is_repeated(field: FieldDescriptor) -> bool:
    """Whether a field holds any number of values."""
    if hasattr(field, "is_repeated"):
        return bool(field.is_repeated)
    return bool(field.label == FieldDescriptor.LABEL_REPEATED)  # protobuf before 6.31


def _map(key: FieldDescriptor, of_value: Convert | None) -> Convert:
    of_key = _BOOLS.__getitem__ if key.type == FieldDescriptor.TYPE_BOOL else str

    def convert(values: Any) -> Row:
        return {of_key(name): value if of_value is None else of_value(value) for name, value in values.items()}

    return convert


_BOOLS = {False: "false", True: "true"}

_AS_LIST = itemgetter(slice(None))
"""Takes half the time that `list` does for protobuf's containers of numbers."""
