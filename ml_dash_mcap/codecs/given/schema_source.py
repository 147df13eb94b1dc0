"""Makes the schema of a topic from what a user gives as one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Union

from ...errors import OptionError, UsageError
from .given_schema import GivenSchema

if TYPE_CHECKING:
    from google.protobuf.descriptor import Descriptor
    from google.protobuf.message import Message

SchemaSource = Union["type[Message]", "Descriptor", Mapping[str, Any], str, None]
"""What a caller may give as the schema of a topic."""


def given_schema(schema: SchemaSource, encoding: str | None = None) -> GivenSchema | None:
    """Return the schema that a caller gives a topic; None if none is given.

    Args:
        schema: A protobuf class or descriptor, a JSON Schema as a dict, a name such as "foxglove.PoseInFrame", or None.
        encoding: The encoding that the caller gives the topic beside it.

    Raises:
        UsageError: It is nothing of the kind.
        OptionError: The name is not known, a package is missing, or the schema is not of that encoding.
        EncodingError: The schema is broken.
    """
    if schema is None:
        return None
    given = _of(schema)
    if encoding not in (None, given.codec.message_encoding):
        raise OptionError(
            f"schema={given.name!r} and encoding={encoding!r} contradict each other: rows of that schema are"
            f" {given.codec.message_encoding!r}; leave encoding= out"
        )
    return given


def schema_of_message(message: Any, topic: str) -> GivenSchema:
    """Return the schema of the first message of a topic.

    Raises:
        UsageError: It is no protobuf message.
        EncodingError: Its descriptors cannot be stored.
    """
    from . import given_protobuf  # protobuf, which only those import who have messages

    return given_protobuf.of_message(message, topic)


def _of(schema: Any) -> GivenSchema:
    # Each of these imports a library that the others do without.
    if isinstance(schema, str):
        from . import foxglove_schemas, given_protobuf

        return given_protobuf.of_descriptor(foxglove_schemas.descriptor(schema))
    if isinstance(schema, Mapping):
        from . import given_json

        return given_json.of_schema(schema)
    from . import given_protobuf

    descriptor = given_protobuf.descriptor_of(schema)
    if descriptor is None:
        kind = type(schema).__name__
        instead = f", such as {kind}" if given_protobuf.descriptor_of(type(schema)) is not None else ""
        raise UsageError(
            f"schema={schema!r} is of type {kind}; pass a class of protobuf messages{instead}, a JSON Schema as a dict,"
            ' or a name such as "foxglove.PoseInFrame"'
        )
    return given_protobuf.of_descriptor(descriptor)
