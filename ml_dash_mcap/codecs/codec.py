"""The protocol of an encoding of messages, as the recorder, the writer thread and the readers use it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

from ..rows import foreign_values
from ..rows.shape import Shape

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from ..mcap.row_arrays import Rows
    from .encoded_channel import Decoder, EncodedChannel, Row
    from .proto.compiled_rows import AppendCode

UNKNOWN_FORM = -1
"""The form of rows that may hold anything."""

LONG_ROW_BYTES = 256 * 1024
"""Rows from this many bytes on are decoded one by one to learn their shape, and not with the others of their block."""


class Columns(NamedTuple):
    """Rows of one channel as flat columns."""

    arrays: dict[str, Any]
    """Arrow arrays by dotted name, in the types that `rows.table` gives the same rows."""
    others: npt.NDArray[np.intp]
    """Numbers of the payloads that are not in the arrays, because only Python objects hold their rows without loss."""


class ColumnReader(Protocol):
    """Reads the rows of one channel, block by block, as columns. Any thread may call it."""

    def read(self, payloads: Sequence[bytes]) -> Columns | None:
        """Return the columns of a block of rows; None if only Python objects hold them without loss."""

    def read_exactly(self, payloads: Sequence[bytes]) -> dict[str, Any] | None:
        """Return columns that tell all that the rows do, or None.

        In them no null stands for a field that a row lacks, no double for an integer, and a dot in a name only for a
        dict in a dict.
        """


class BlockForms(Protocol):
    """The forms and shapes of the rows of all channels of one encoding so far. Used by the writer thread only.

    Rows of one form have the same top-level keys. A form is a number that its channel's rows have in one block.
    """

    @property
    def size(self) -> int:
        """How much is remembered, in bytes, about."""

    def begin_block(self) -> None:
        """Begin a block; forms that were returned before may be forgotten."""

    def forget(self) -> None:
        """Forget all but the shapes."""

    def learn(self, channel: int, payload: bytes) -> int:
        """Widen a channel's shape by one row; returns the row's form, or `UNKNOWN_FORM`."""

    def of_rows(self, rows: Rows) -> npt.NDArray[np.int32]:
        """Return the form of each row, [N], and widen the channels' shapes. None of the rows is a long one."""

    def add_channel(self, channel: int, codec: Codec) -> None:
        """Take a channel with its codec, before the first of its rows."""

    def shape_of(self, channel: int) -> Shape | None:
        """Return the shape of a channel's rows so far; None if it has had no rows."""

    def keys_of(self, channel: int, form: int) -> frozenset[str]:
        """Return the top-level keys of a channel's form, which is not `UNKNOWN_FORM`."""


class EncodedColumns(NamedTuple):
    """Some rows, given as columns, as Message records."""

    records: bytes
    """One after the other."""
    starts: npt.NDArray[np.int64]
    """Where each of them starts, [N]."""
    last_s: float
    """The last row's time stamp, in seconds."""
    is_uniform: bool
    """Whether all of them have the same fields, of the same types and shapes."""


class MessageCodec(Protocol):
    """An encoding that can be read."""

    def decoder(self, channel: EncodedChannel) -> Decoder | None:
        """Return the decoder of a channel's messages; None if the schema's language does not belong to this encoding.

        The function raises a `ValueError` for a payload that is not in this encoding.

        Raises:
            EncodingError: The schema cannot be used.
        """

    def decode_plain(self, payloads: Sequence[bytes]) -> list[Row] | None:
        """Return rows of payloads of which nothing but the syntax is to be read; None where something else is."""
        return None

    def column_reader(self, decoder: Callable[[], Decoder], columns: Sequence[str] | None) -> ColumnReader | None:
        """Return a reader that makes columns of a channel's messages; None if they all have to become rows first.

        Args:
            decoder: Returns the decoder of the channel's messages.
            columns: Dotted names of the wanted columns; None for all. Other columns may come back with them.
        """
        return None


@runtime_checkable
class Codec(MessageCodec, Protocol):
    """An encoding that rows can be recorded in. Its methods may be called by any thread.

    An encoded row ends with its time stamp, under `_ts`.
    """

    message_encoding: str
    schema_encoding: str

    follows_shapes: bool = True
    """Whether the schema follows from the shapes of the rows, which the writer thread learns. Otherwise the codec knows
    it itself, as soon as a row is encoded."""

    def for_channel(self, topic: str, schema: bytes = b"", declare: Callable[[bytes], bool] | None = None) -> Codec:
        """Return the codec of the rows of one channel; the same object where the encoding knows nothing of channels.

        Args:
            topic: The channel's.
            schema: Of the rows so far, where some were recorded before; empty otherwise.
            declare: Called with each wider schema, before a row is encoded with it; returns whether there is room
                for it. What it raises, `dumps` raises.
        """
        return self

    def on_compiled(self, install: Callable[[AppendCode | None], None]) -> None:
        """Name the function that is called with the code of an `append` for rows like those that came so far.

        Args:
            install: Called by an appending thread, while it encodes a row; with None when earlier code is out of date.
        """
        return  # otherwise mypy takes it for abstract

    def note_units(self, units: Mapping[str, str]) -> None:
        """Take the units of fields, by dotted name, for schemas that say them; others have them beside the schema."""
        return  # otherwise mypy takes it for abstract

    def schema_name(self, topic: str) -> str:
        """Return the name of the schema of a topic."""
        return topic

    # -- append: an appending thread calls these -----------------------------------------------------------------------

    dumps: Callable[[dict[str, Any], Callable[[Any], Any]], bytes]
    """Encodes the fields of a row, the time stamp last, fast; whatever it raises, `encode_exactly` is called then. The
    second argument is `default`: orjson is called by `append` as it is, without a function of Python between."""
    default: Callable[[Any], Any] = staticmethod(foreign_values.simple)
    probe: int | bytes = b"\xff" * 16
    """A payload of `dumps` with this in it goes through `recheck`, which by default leaves it as it is."""

    def encode_exactly(self, fields: Mapping[str, Any], topic: str) -> bytes:
        """Encode a row that `dumps` could not, or not without loss.

        Raises:
            FieldError: A value cannot be stored; the message names the topic and the field.
        """

    def recheck(self, payload: bytes, fields: Mapping[str, Any], topic: str, probe: int | bytes) -> tuple[bytes, Any]:
        """Return the payload that a row should have, and the probe for the topic's next rows.

        Args:
            payload: The bytes that `dumps` returned.
            fields: Of the row.
            topic: For the error messages.
            probe: The byte or bytes that were found in the payload.
        """
        return payload, probe

    def encode(self, fields: dict[str, Any], topic: str) -> bytes:
        """Encode a row whose fields end with its time stamp, as `append` does, for callers that are in no hurry."""
        try:
            payload = self.dumps(fields, self.default)
        except Exception:  # `encode_exactly` raises an error that names the field
            return self.encode_exactly(fields, topic)
        return self.recheck(payload, fields, topic, self.probe)[0]

    def encode_columns(
        self, times: npt.NDArray[np.float64], columns: Mapping[str, Any], topic: str, head: bytes
    ) -> Iterator[EncodedColumns] | None:
        """Encode many rows, given as columns of numbers; None where they are to be encoded row by row.

        Args:
            times: Time stamps, [N], s.
            columns: By field, arrays of numbers [N, ...], masked or not, or dicts of these.
            topic: For the error messages.
            head: Channel id and sequence number as they stand in a Message record.
        """
        return None

    # -- the writer: its thread calls these ----------------------------------------------------------------------------

    def forms(self) -> BlockForms:
        """Return a learner of the forms and shapes of rows, for one recorder."""

    def schema(self, shape: Shape | None, title: str) -> bytes:
        """Return the schema of rows of a shape, in `schema_encoding`.

        Args:
            shape: The shape of the rows so far; None before the first row.
            title: The topic's name.
        """

    def padded(self, schema: bytes, length: int) -> bytes:
        """Return a schema with a padding that readers pass over, so that it has a length and can grow in place."""

    def mended(self, schema: bytes) -> bytes | None:
        """Return a valid schema in the place of one that a crash cut while it was rewritten in place.

        Returns:
            A schema of the same length, which need not describe any field; None if `schema` is whole, or if this
            encoding cannot tell.
        """
        return None

    def cut(self, payloads: Sequence[bytes]) -> list[int]:
        """Return where each row's time stamp begins, with its key; it goes on to the end of the payload.

        It is 0 in an encoding in which the time stamp does not stand for itself: rows are cut to compare their times.
        """

    def keys_of(self, payload: bytes) -> frozenset[str]:
        """Return a row's top-level keys, including the time stamp's key."""

    def time_of(self, payload: bytes) -> float:
        """Return the time stamp, in seconds, without decoding the rest."""

    def with_time(self, payload: bytes, seconds: float) -> bytes:
        """Return a row at another time stamp; nothing else of it changes.

        Raises:
            ValueError: It has no time stamp.
        """

    def join(self, payloads: Sequence[bytes]) -> bytes:
        """Merge rows of one time stamp, the earliest first: for each top-level key, the last row that has it wins."""

    def join_disjoint(self, payloads: Sequence[bytes], cuts: Sequence[int]) -> bytes:
        """Merge rows of one time stamp that have no top-level key in common; `cuts` are theirs."""

    opening_bytes: int | None = None
    """How many bytes every row begins with that a merged row has once, such as a brace. None where `join_disjoint` is
    more than this: the first row's opening, the fields of each row between its opening and its cut, and the time stamp
    of the last row. Otherwise the writer thread joins the rows of a whole block at once."""

    def cuts(
        self, data: npt.NDArray[np.uint8], starts: npt.NDArray[np.int64], ends: npt.NDArray[np.int64]
    ) -> npt.NDArray[np.int64] | None:
        """Do what `cut` does for many rows at once, where `opening_bytes` is not None.

        Args:
            data: The bytes of a block. Before each row there are as many as a Message record's head has, at least.
            starts: Where in it the rows start, [N].
            ends: Where in it they end, [N].

        Returns:
            Where in `data` each row's time stamp begins, [N]; None if only `cut` can tell.
        """
        return None

    # -- copies --------------------------------------------------------------------------------------------------------

    def encode_read(self, row: Row) -> bytes:
        """Encode a row that was read. It may hold values that `encode` refuses."""
