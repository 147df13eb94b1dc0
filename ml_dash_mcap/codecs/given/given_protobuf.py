"""Protobuf messages of a type that a user gives: built from rows by the names of fields, or taken as they are."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

from google.protobuf import message_factory
from google.protobuf.descriptor import Descriptor, FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import EncodeError, Message

from ...errors import EncodingError, FieldError, UsageError
from ...rows.plain_row import TIME_KEY
from ..protobuf_messages import decoder
from .fields_by_name import FieldsByName
from .given_schema import GivenCodec, GivenSchema
from .unfit_values import UnfitValueError, spelled

ENCODING = "protobuf"


class GivenProtobufCodec(GivenCodec):
    """Messages of one type. A payload is what protobuf makes of the message, and nothing else."""

    message_encoding = schema_encoding = ENCODING

    def __init__(self, descriptor: Descriptor, data: bytes) -> None:
        """Prepare for a type of message.

        Args:
            descriptor: Of the type.
            data: Its file and all that it imports, as a serialized `FileDescriptorSet`.
        """
        self.name: str = descriptor.full_name
        self.data = data
        self._class: Any = message_factory.GetMessageClass(descriptor)
        self._fields = FieldsByName(descriptor)
        self.decode = decoder(self.name, data)
        self._same_classes: set[type] = {self._class}

    # -- append --------------------------------------------------------------------------------------------------------

    def dumps(self, fields: dict[str, Any], default: Any) -> bytes:
        """Encode a row; its time stamp is no part of the message."""
        fields.pop(TIME_KEY, None)
        return self.encode_row(fields)

    def encode_row(self, row: Mapping[str, Any]) -> bytes:
        """Encode the fields of a message."""
        message = self._class()
        self._fields.fill(message, row)
        payload: bytes = message.SerializeToString()
        return payload

    def encode_exactly(self, fields: Mapping[str, Any], topic: str) -> bytes:
        """Encode a row, or say which of its values does not fit."""
        row = {name: value for name, value in fields.items() if name != TIME_KEY}
        message = self._class()
        try:
            self._fields.fill(message, row)
        except UnfitValueError as unfit:
            raise FieldError(f"append() on topic {topic!r}: field {spelled(unfit.path)!r} {unfit.what}") from unfit
        except FieldError:
            raise
        except Exception as error:  # whatever protobuf, or a method of a foreign object, raises
            raise FieldError(f"append() on topic {topic!r}: the row does not fit {self.name}: {error}") from error
        return self._serialized(message, f"append() on topic {topic!r}")

    def encode_message(self, message: Any, topic: str) -> bytes:
        """Encode a message of the type."""
        if message.__class__ not in self._same_classes:
            self._check(message, topic)
        return self._serialized(message, f"append_message() on topic {topic!r}")

    def _check(self, message: Any, topic: str) -> None:
        check_message(message, topic)
        given = message.DESCRIPTOR.full_name
        if given != self.name:
            raise UsageError(
                f"append_message() on topic {topic!r}: the message is a {given}, but the topic's schema is"
                f" {self.name}; each type of message has a topic of its own"
            )
        if descriptor_set(message.DESCRIPTOR) != self.data:
            raise UsageError(
                f"append_message() on topic {topic!r}: the message is a {given} by another definition than the"
                " topic's schema; its class was generated from another .proto file"
            )
        self._same_classes.add(type(message))

    def _serialized(self, message: Message, call: str) -> bytes:
        try:
            payload: bytes = message.SerializeToString()
        except (EncodeError, ValueError) as error:  # upb, and protobuf's encoder in Python
            missing = message.FindInitializationErrors()
            why = f"it lacks the required {', '.join(missing)}" if missing else str(error)
            raise FieldError(f"{call}: the {self.name} cannot be stored: {why}") from error
        return payload


def of_descriptor(descriptor: Descriptor) -> GivenSchema:
    """Return the schema of a type of message.

    Raises:
        EncodingError: Its descriptors cannot be stored.
    """
    try:
        return _of_descriptor(descriptor)
    except TypeError:  # the descriptor has no hash
        return _of_descriptor.__wrapped__(descriptor)


@functools.lru_cache(maxsize=256)
def _of_descriptor(descriptor: Descriptor) -> GivenSchema:
    data = descriptor_set(descriptor)
    try:
        codec = GivenProtobufCodec(descriptor, data)
    except EncodingError as error:
        raise EncodingError(f"the schema {descriptor.full_name!r} cannot be stored: {error}") from error
    return GivenSchema(descriptor.full_name, data, codec)


def of_message(message: Any, topic: str) -> GivenSchema:
    """Return the schema of a message's type.

    Raises:
        UsageError: It is no message.
        EncodingError: Its descriptors cannot be stored.
    """
    check_message(message, topic)
    return of_descriptor(message.DESCRIPTOR)


def descriptor_of(schema: Any) -> Descriptor | None:
    """Return the descriptor that a caller means by a class of messages or by a descriptor; None for anything else."""
    if isinstance(schema, Descriptor):
        return schema
    is_class = isinstance(schema, type) and issubclass(schema, Message)
    descriptor = getattr(schema, "DESCRIPTOR", None) if is_class else None
    return descriptor if isinstance(descriptor, Descriptor) else None


def check_message(message: Any, topic: str) -> None:
    """Raise UsageError for what is no protobuf message."""
    if isinstance(message, Message):
        return
    call = f"append_message() on topic {topic!r}"
    if isinstance(message, type) and issubclass(message, Message):
        raise UsageError(f"{call} takes a message, not its class: pass {message.__name__}(...)")
    if isinstance(message, Mapping):
        raise UsageError(f"{call} takes a protobuf message, not a dict: write append(**row)")
    if isinstance(message, bytes):
        raise UsageError(f"{call} takes a protobuf message, not its bytes: pass its class's FromString(data)")
    raise UsageError(f"{call} takes a protobuf message, not {message!r}")


def descriptor_set(descriptor: Descriptor) -> bytes:
    """Return the file of a type of message and all files that it imports, each behind those that it imports itself.

    None of them can be missing: protobuf makes no descriptor of a file whose imports it lacks.
    """
    files: dict[str, FileDescriptor] = {}
    _collect(descriptor.file, files)
    described = FileDescriptorSet()
    for file in files.values():
        file.CopyToProto(described.file.add())
    data: bytes = described.SerializeToString(deterministic=True)
    return data


def _collect(file: FileDescriptor, files: dict[str, FileDescriptor]) -> None:
    for imported in file.dependencies:
        if imported.name not in files:
            _collect(imported, files)
    files[file.name] = file
