"""A schema that is given to a topic, and the codec whose rows fit it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...errors import UsageError
from ..codec import Codec
from ..row_codec import RowCodec


@dataclass(frozen=True, slots=True)
class GivenSchema:
    """A schema that does not depend on the rows."""

    name: str
    """As the Schema record has it, such as `foxglove.PoseInFrame`; empty for the topic's name."""
    data: bytes
    """As the Schema record has it, in the schema encoding of the codec."""
    codec: Codec
    """Encodes the rows."""

    def __str__(self) -> str:
        return f"{self.name!r} ({self.codec.schema_encoding})" if self.name else f"a {self.codec.schema_encoding}"


class GivenCodec(RowCodec):
    """The codec of one given schema. It refuses rows that do not fit; their time stamp is the message's time alone.

    No row of it is ever merged with another, because what two rows make together need not fit the schema.
    """

    name: str
    """Of the schema; empty for the topic's name."""
    data: bytes
    """The schema, as the Schema record has it."""
    follows_shapes = False

    def schema(self, shape: Any, title: str) -> bytes:
        """Return the schema, whatever the rows are."""
        return self.data

    def padded(self, schema: bytes, length: int) -> bytes:
        """Return the schema as it is: it never grows."""
        return schema

    def schema_name(self, topic: str) -> str:
        """Return the name of the schema."""
        return self.name or topic

    def encode_message(self, message: Any, topic: str) -> bytes:
        """Encode a protobuf message.

        Args:
            message: What a caller passed as one.
            topic: For the error messages.

        Raises:
            UsageError: It is no message of the schema.
            FieldError: It lacks a required field, or is too large.
        """
        raise UsageError(
            f"append_message() on topic {topic!r}: the topic's schema is a"
            f" {self.schema_encoding}; append its rows with append(field=..., _ts=...)"
        )
