"""Protobuf: rows as messages of a type that is inferred from them, and messages of others by their descriptors.

An object of the codec records the rows of one channel, because fields get their numbers while rows are appended.
"""

from __future__ import annotations

import functools
import logging
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ..errors import BacklogFullError, FieldError, StorageError
from ..rows import json_text
from ..rows.plain_row import TIME_KEY, PlainRow, encodable
from ..rows.shape import Shape
from . import protobuf_messages
from .codec import BlockForms, Codec, ColumnReader, EncodedColumns
from .encoded_channel import Decoder, EncodedChannel, Row
from .proto import descriptor, row_parts
from .proto.compilation import Compilation
from .proto.compiled_rows import AppendCode
from .proto.growth import Growth
from .proto.layout import ROW, Layout
from .proto.row_decoder import RowDecoder
from .proto.row_encoder import RowEncoder

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

_log = logging.getLogger("ml_dash_mcap")

_MOST_GROWTHS = 200
"""How often the layout of a topic grows; what comes later has no field. Each growth writes the whole descriptor into
the journal."""

_REFUSED_GROWTH = 20
"""As so many growths counts one that the journal had no room for. It takes milliseconds to find that out."""

_LOCK_WAIT_S = 1.0
"""After a fork, another thread of the parent may hold the lock in the child for ever."""


class ProtobufCodec(Codec):
    """Rows of one channel as protobuf messages. Any thread may call it."""

    message_encoding = "protobuf"
    schema_encoding = "protobuf"
    follows_shapes = False

    def __init__(self, topic: str = "", layout: Layout = ROW, declare: Callable[[bytes], bool] | None = None) -> None:
        """Begin with a layout.

        Args:
            topic: The channel's.
            layout: Of the rows so far.
            declare: Called with each wider schema, before a row is encoded with it; returns whether there is room
                for it.
        """
        self.topic = topic
        self.layout = layout
        self._declare = declare
        self._lock = threading.RLock()
        """Guards the growth of the layout."""
        self._is_growing = False
        self._growths = 0
        self._has_warned = False
        self._compilation = Compilation()

    def for_channel(self, topic: str, schema: bytes = b"", declare: Callable[[bytes], bool] | None = None) -> Codec:
        """Return a codec for the rows of one channel."""
        layout = descriptor.decode(schema, descriptor.full_name(topic)) if schema else None
        return ProtobufCodec(topic, layout or ROW, declare)

    def note_units(self, units: Mapping[str, str]) -> None:
        """Take the units of fields for the descriptor. The journal learns them with the next field."""
        noted = tuple((encodable(name), encodable(unit)) for name, unit in units.items())
        if noted == self.layout.units or not self._lock.acquire(timeout=_LOCK_WAIT_S):
            return
        try:
            if not self._is_growing:
                self.layout = replace(self.layout, units=noted)
        finally:
            self._lock.release()

    def on_compiled(self, install: Callable[[AppendCode | None], None]) -> None:
        """Name the function that takes the code of an `append`."""
        self._compilation.install = install

    # -- append --------------------------------------------------------------------------------------------------------

    def dumps(self, fields: dict[str, Any], default: Any) -> bytes:
        """Encode a row, by a compiled function if rows like it came before."""
        for encode in self._compilation.functions.get(tuple(fields), ()):
            payload = encode(fields)
            if payload is not None:
                return payload
        layout = self.layout
        payload = self._encoded(PlainRow(self.topic).row(fields))
        if layout is self.layout:
            self._compilation.learn(layout, fields)
        return payload

    def encode_exactly(self, fields: Mapping[str, Any], topic: str) -> bytes:
        """Encode a row, or say which of its values cannot be stored."""
        row = PlainRow(topic).row(fields)
        try:
            return self._encoded(row)
        except FieldError:
            json_text.exact(row, topic)  # its error names the field
            raise

    def encode_columns(
        self, times: npt.NDArray[np.float64], columns: Mapping[str, Any], topic: str, head: bytes
    ) -> Iterator[EncodedColumns] | None:
        """Encode rows by filling one array with the columns."""
        if not len(times):
            return None
        from .proto import columns_encoder  # numpy, which no appending thread waits for

        first = PlainRow(topic).row(columns_encoder.first_row(columns))
        return columns_encoder.encode(self._wide_enough(first), times, columns, head)

    def encode_read(self, row: Row) -> bytes:
        """Encode a row that was read."""
        try:
            return self.dumps(row, None)
        except FieldError:  # a text has lone surrogates
            return self._encoded(PlainRow("").row(row), is_read=True)

    def _encoded(self, row: dict[str, Any], *, is_read: bool = False) -> bytes:
        layout = self._wide_enough(row)
        encoder = RowEncoder()
        payload = encoder.encode(layout, row, is_read=is_read)
        if encoder.opaque and layout.lacks_opaque(encoder.opaque):
            self._name_opaque(encoder.opaque)
        return payload

    def _name_opaque(self, paths: Sequence[str]) -> None:
        """Name values without a field. The schema in the journal does without: nothing is decoded by these names."""
        if not self._lock.acquire(blocking=False):
            return
        try:
            if not self._is_growing:
                self.layout = self.layout.with_opaque(paths)
        finally:
            self._lock.release()

    def _wide_enough(self, row: dict[str, Any]) -> Layout:
        """Return the layout, with a field for each value of a plain row that can have one."""
        fields = {key: value for key, value in row.items() if key != TIME_KEY}
        layout = self.layout
        if Growth(layout).widened(layout, fields) is layout:
            return layout
        return self._grown(lambda layout: Growth(layout).widened(layout, fields))

    def _grown(self, grow: Callable[[Layout], Layout]) -> Layout:
        """Widen the layout, where that is possible now.

        A signal handler that appends while its own thread widens the layout goes on with the layout as it is.
        """
        if self._growths >= _MOST_GROWTHS:
            self._warn_of_end()
            return self.layout
        if not self._lock.acquire(timeout=_LOCK_WAIT_S):
            return self.layout
        try:
            layout = self.layout
            if self._is_growing:
                return layout
            self._is_growing = True
            try:
                wider = grow(layout)
                if wider is layout:
                    return layout
                is_declared = self._declare is None or self._declare(descriptor.encode(wider, self.topic))
                self._growths += 1 if is_declared else _REFUSED_GROWTH
                if not is_declared:
                    self._warn_of_end()
                    return layout
                self.layout = wider
                self._compilation.forget()
                return wider
            except (BacklogFullError, StorageError):  # the row will meet that itself, and be counted
                return layout
            finally:
                self._is_growing = False
        finally:
            self._lock.release()

    def _warn_of_end(self) -> None:
        """Tell once that values have no field any more."""
        if not self._has_warned:
            self._has_warned = True
            _log.warning(
                "topic %r: its protobuf type has no room to grow; values that it has no field for are kept in the text"
                " `_exact` (see docs/guides/encodings.md, Limits of protobuf)",
                self.topic,
            )

    # -- the writer ----------------------------------------------------------------------------------------------------

    def forms(self) -> BlockForms:
        """Return a learner that tells the forms of rows by their tags and lengths."""
        from .proto.block_forms import ProtobufForms  # numpy, which no appending thread waits for

        return ProtobufForms()

    def schema_name(self, topic: str) -> str:
        """Return the full name of the message."""
        return descriptor.full_name(topic)

    def schema(self, shape: Shape | None, title: str) -> bytes:
        """Return the file descriptors of the rows so far."""
        return descriptor.encode(self.layout, title)

    def padded(self, schema: bytes, length: int) -> bytes:
        """Return file descriptors with a field behind them that readers pass over."""
        return descriptor.padded(schema, length)

    def cut(self, payloads: Sequence[bytes]) -> list[int]:
        """Return where each row's time stamp begins."""
        return [row_parts.cut(payload) for payload in payloads]

    def keys_of(self, payload: bytes) -> frozenset[str]:
        """Return a row's top-level keys."""
        return row_parts.keys(self.layout, payload)

    def time_of(self, payload: bytes) -> float:
        """Return the time stamp."""
        return row_parts.time_of(payload)

    def with_time(self, payload: bytes, seconds: float) -> bytes:
        """Return a row at another time stamp."""
        return row_parts.with_time(payload, seconds)

    def join(self, payloads: Sequence[bytes]) -> bytes:
        """Merge rows of one time stamp."""
        return row_parts.join(self.layout, payloads)

    def join_disjoint(self, payloads: Sequence[bytes], cuts: Sequence[int]) -> bytes:
        """Merge rows of one time stamp without a key in common, by joining their bytes."""
        fields = [payload[:cut] for payload, cut in zip(payloads, cuts, strict=True)]
        return b"".join([*fields, payloads[-1][cuts[-1] :]])

    opening_bytes = 0

    def cuts(
        self, data: npt.NDArray[np.uint8], starts: npt.NDArray[np.int64], ends: npt.NDArray[np.int64]
    ) -> npt.NDArray[np.int64] | None:
        """Return where the time stamps of many rows begin."""
        from .proto import row_cuts  # numpy, which no appending thread waits for

        return row_cuts.cuts(data, starts, ends)

    # -- reading -------------------------------------------------------------------------------------------------------

    def decoder(self, channel: EncodedChannel) -> Decoder | None:
        """Return the decoder of a channel's messages, rows of ours or messages of others."""
        schema = channel.schema
        if schema.encoding != "protobuf":
            return None
        misfit = None if channel.decoding.on_unknown == "raise" else channel.misfit()
        layout = _layout(schema.data, schema.name)
        if layout is not None:
            return RowDecoder(layout, misfit)
        decode = protobuf_messages.decoder(schema.name, schema.data)
        if misfit is None:
            return decode

        def decode_or_carry(payload: bytes) -> Row | None:
            try:
                return decode(payload)
            except (ValueError, RecursionError) as error:
                return misfit(payload, error)

        return decode_or_carry

    def column_reader(self, decoder: Callable[[], Decoder], columns: Sequence[str] | None) -> ColumnReader:
        """Return a reader of rows of ours; messages of others all become rows first."""
        from .proto.columns import ProtobufColumnReader  # pyarrow, which only readers of columns wait for

        return ProtobufColumnReader(decoder, columns)


@functools.lru_cache(maxsize=256)
def _layout(schema: bytes, name: str) -> Layout | None:
    return descriptor.decode(schema, name)


CODEC = ProtobufCodec()
