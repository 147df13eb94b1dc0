"""An encoding that decodes and encodes whole rows only: all else that a codec is asked is done by these two."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ..errors import FieldError
from ..rows.merge import merge
from ..rows.plain_row import TIME_KEY, PlainRow
from ..rows.shape import Shape
from . import json_schema
from .codec import BlockForms, Codec
from .encoded_channel import Decoder, EncodedChannel, Row


class RowCodec(Codec):
    """A codec whose `encode_row` and `decode` say all of it.

    Other methods are worth a body of their own where the encoding knows a faster way.
    """

    encode_row: Callable[[Mapping[str, Any]], bytes]
    """Encodes plain values (see `rows.plain_row.PlainRow`), in their order. It may raise anything."""
    decode: Callable[[bytes], Row]
    """Makes a row of a payload; raises a `ValueError` for one that is not in this encoding."""

    schema_encoding = json_schema.ENCODING

    # -- append --------------------------------------------------------------------------------------------------------

    def dumps(self, fields: dict[str, Any], default: Any) -> bytes:
        """Encode a row."""
        return self.encode_row(PlainRow("").row(fields))

    def encode_exactly(self, fields: Mapping[str, Any], topic: str) -> bytes:
        """Encode a row, or say which of its values cannot be stored."""
        row = PlainRow(topic).row(fields)
        for name, value in row.items():
            try:
                self.encode_row({name: value})
            except Exception as error:  # whatever an encoder raises for what it has no bytes for
                raise FieldError(f"append() on topic {topic!r}: field {name!r} cannot be stored: {error}") from error
        return self.encode_row(row)

    def encode_read(self, row: Row) -> bytes:
        """Encode a row that was read."""
        return self.encode_row(PlainRow("").row(row))

    # -- the writer ----------------------------------------------------------------------------------------------------

    def forms(self) -> BlockForms:
        """Return what learns the shapes of rows by decoding each."""
        from .decoded_forms import DecodedForms  # numpy, which no appending thread waits for

        return DecodedForms(self.decode)

    def schema(self, shape: Shape | None, title: str) -> bytes:
        """Return a JSON Schema of the rows; bytes and arrays are described as they are for JSON rows."""
        return json_schema.of_shape(shape, title)

    def padded(self, schema: bytes, length: int) -> bytes:
        """Return a JSON Schema with blanks behind it."""
        return json_schema.padded(schema, length)

    def mended(self, schema: bytes) -> bytes | None:
        """Return a JSON Schema of any object in the place of one that a crash cut."""
        # An encoding with schemas in another language inherits this method too.
        return json_schema.mended(schema) if self.schema_encoding == json_schema.ENCODING else None

    def cut(self, payloads: Sequence[bytes]) -> list[int]:
        """Return the start of each row, because the time stamp is found by decoding only."""
        return [0] * len(payloads)

    def keys_of(self, payload: bytes) -> frozenset[str]:
        """Return a row's top-level keys."""
        return frozenset(self.decode(payload))

    def time_of(self, payload: bytes) -> float:
        """Return the time stamp."""
        return _time_of(self.decode(payload))

    def with_time(self, payload: bytes, seconds: float) -> bytes:
        """Return a row at another time stamp."""
        row = self.decode(payload)
        _time_of(row)
        return self.encode_row({**row, TIME_KEY: seconds})

    def join(self, payloads: Sequence[bytes]) -> bytes:
        """Merge rows of one time stamp."""
        row = merge([self.decode(payload) for payload in payloads])
        time_s = row.pop(TIME_KEY)
        return self.encode_row({**row, TIME_KEY: time_s})

    def join_disjoint(self, payloads: Sequence[bytes], cuts: Sequence[int]) -> bytes:
        """Merge rows of one time stamp, as if they had keys in common."""
        return self.join(payloads)

    # -- reading -------------------------------------------------------------------------------------------------------

    def decoder(self, channel: EncodedChannel) -> Decoder:
        """Return the decoder of messages. It needs no schema."""
        return self.decode

    def decode_plain(self, payloads: Sequence[bytes]) -> list[Row] | None:
        """Decode rows; None if one is not in this encoding."""
        try:
            return list(map(self.decode, payloads))
        except (ValueError, RecursionError):
            return None


def _time_of(row: Row) -> float:
    time_s = row.get(TIME_KEY)
    if not isinstance(time_s, float):
        raise ValueError("the row has no time stamp")
    return time_s
