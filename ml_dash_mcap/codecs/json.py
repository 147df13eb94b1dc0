"""JSON, the encoding that rows are recorded in by default: every viewer reads it."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import orjson

from ..rows import json_text
from ..rows.plain_row import EXACT_KEY
from ..rows.shape import Shape
from . import json_depth, json_merge, json_schema
from .codec import BlockForms, Codec, ColumnReader, EncodedColumns
from .encoded_channel import Decoder, EncodedChannel, Row

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

_MOST_DIGITS = 21
"""The most digits that an integer of 64 bits has, with its sign."""


class JsonCodec(Codec):
    """Rows as JSON objects. Values that JSON does not have are noted in a side key (see `rows.json_text`)."""

    message_encoding = "json"
    schema_encoding = json_schema.ENCODING

    # -- append --------------------------------------------------------------------------------------------------------

    dumps = staticmethod(orjson.dumps)
    default = staticmethod(json_text.row_value)
    # A number: `in` then looks for a single byte of `null`.
    probe = b"n"[0]

    def encode_exactly(self, fields: Mapping[str, Any], topic: str) -> bytes:
        """Encode a row with bytes, non-finite numbers, large arrays or odd keys, or say what is wrong with it."""
        return json_text.exact(fields, topic)

    def recheck(self, payload: bytes, fields: Mapping[str, Any], topic: str, probe: int | bytes) -> tuple[bytes, Any]:
        """Look closer at a payload that may have a null in it, where orjson writes None but also NaN and infinities.

        Searching for `null` takes longer than encoding a row, for one byte a fiftieth of that. So a byte of `null`
        that the topic's rows do not have otherwise is looked for, and changed when a row has it.
        """
        if b"null" in payload:
            return json_text.exact(fields, topic), probe
        return payload, next((byte for byte in b"nul" if byte not in payload), probe)

    def encode_columns(
        self, times: npt.NDArray[np.float64], columns: Mapping[str, Any], topic: str, head: bytes
    ) -> Iterator[EncodedColumns] | None:
        """Encode rows by formatting each column as a whole."""
        from . import json_column_texts  # numpy, which no appending thread waits for

        are_worthwhile = json_column_texts.is_worthwhile(columns)
        return json_column_texts.encode(times, columns, topic, head) if are_worthwhile else None

    # -- the writer ----------------------------------------------------------------------------------------------------

    def forms(self) -> BlockForms:
        """Return a learner that tells the forms of rows by their skeletons."""
        from .json_forms import JsonForms  # numpy, which no appending thread waits for

        return JsonForms()

    def schema(self, shape: Shape | None, title: str) -> bytes:
        """Return a JSON Schema."""
        return json_schema.of_shape(shape, title)

    def padded(self, schema: bytes, length: int) -> bytes:
        """Return a JSON Schema with blanks behind it."""
        return json_schema.padded(schema, length)

    def mended(self, schema: bytes) -> bytes | None:
        """Return a JSON Schema of any object in the place of one that a crash cut."""
        return json_schema.mended(schema)

    def cut(self, payloads: Sequence[bytes]) -> list[int]:
        """Return where each row's time stamp begins, with its key."""
        return [payload.rindex(json_merge.TIME_MARK) for payload in payloads]

    def keys_of(self, payload: bytes) -> frozenset[str]:
        """Return a row's top-level keys."""
        return frozenset(orjson.loads(payload))

    def time_of(self, payload: bytes) -> float:
        """Return the time stamp."""
        return json_merge.time_of(payload)

    def with_time(self, payload: bytes, seconds: float) -> bytes:
        """Return a row at another time stamp."""
        return json_merge.with_time(payload, seconds)

    def join(self, payloads: Sequence[bytes]) -> bytes:
        """Merge rows of one time stamp."""
        return json_merge.join(payloads)

    def join_disjoint(self, payloads: Sequence[bytes], cuts: Sequence[int]) -> bytes:
        """Merge rows of one time stamp without a key in common, by joining their bytes."""
        return json_merge.join_disjoint(payloads, cuts)

    opening_bytes = 1

    def cuts(
        self, data: npt.NDArray[np.uint8], starts: npt.NDArray[np.int64], ends: npt.NDArray[np.int64]
    ) -> npt.NDArray[np.int64] | None:
        """Return where the time stamps of many rows begin, with their keys."""
        from . import json_cuts  # numpy, which no appending thread waits for

        return json_cuts.cuts(data, starts, ends)

    # -- reading -------------------------------------------------------------------------------------------------------

    def decoder(self, channel: EncodedChannel) -> Decoder:
        """Return the decoder of messages. It needs no schema."""
        return decode

    def decode_plain(self, payloads: Sequence[bytes]) -> list[Row] | None:
        """Decode rows without a side key."""
        if not json_depth.are_within(payloads, json_depth.MOST):
            return None
        try:
            rows = list(map(orjson.loads, payloads))
        except orjson.JSONDecodeError:
            return None
        return rows if {*map(type, rows)} == {dict} and not any(EXACT_KEY in row for row in rows) else None

    def column_reader(self, decoder: Callable[[], Decoder], columns: Sequence[str] | None) -> ColumnReader:
        """Return a reader that lets pyarrow read the rows."""
        from .json_columns import JsonColumnReader  # pyarrow, which only readers of columns wait for

        return JsonColumnReader(columns)

    def encode_read(self, row: Row) -> bytes:
        """Encode a row that was read."""
        try:
            encoded = orjson.dumps(row)
        except TypeError:  # the row has bytes, arrays or lone surrogates
            return json_text.exact_as_read(row)
        return json_text.exact_as_read(row) if b"null" in encoded else encoded  # orjson writes NaN as null


def decode(payload: bytes) -> Row:
    """Decode a payload, with its non-finite numbers, bytes and arrays restored.

    Whatever is not an object becomes the field `value`, and an empty payload a row without fields.

    Raises:
        ValueError: It is no JSON.
    """
    if not json_depth.is_within(payload, json_depth.MOST):
        raise ValueError(f"it is nested deeper than {json_depth.MOST} levels")
    try:
        row = orjson.loads(payload)
    except orjson.JSONDecodeError:
        row = _decode_lenient(payload)
    if not isinstance(row, dict):
        return {"value": row}
    return json_text.restore(row) if EXACT_KEY in row else row


def _decode_lenient(payload: bytes) -> Any:
    """Decode the JSON of less strict writers: NaN and Infinity literals, lone surrogates, or an empty payload."""
    return json.loads(payload, parse_int=_integer) if payload.strip() else {}


def _integer(digits: str) -> int | float:
    """Return an integer as orjson would: as a double if it needs more than 64 bits."""
    value = int(digits) if len(digits) <= _MOST_DIGITS else math.inf
    return value if -(2**63) <= value < 2**64 else float(digits)


CODEC = JsonCodec()
