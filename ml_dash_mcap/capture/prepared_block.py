"""The block that the writer thread hands to the sinks: the rows of one buffer, shaped, merged and numbered."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from .. import clock
from ..codecs.encoded_channel import Decoder
from ..mcap.records import Metadata
from ..mcap.row_arrays import Rows
from ..rows.plain_row import TIME_KEY
from ..rows.shape import Shape
from .channels import ChannelInfo
from .event_clock import UNKNOWN_CLOCK


class BlockMessage(NamedTuple):
    """One row of a block."""

    channel: ChannelInfo
    """Its topic, with the kind and the metadata of that."""
    time_ns: int
    """Its log time, ns."""
    sequence: int
    """How many rows the topic has before it in this session."""
    payload: bytes
    """The row as it is in the file."""
    decode: Decoder
    """Makes rows of the channel's payloads."""

    def row(self) -> dict[str, Any]:
        """Decode the row; its time stamp is the field `_ts`, in seconds."""
        row = self.decode(self.payload) or {}
        if TIME_KEY not in row:  # messages of a schema that the user gave have the log time alone
            row[TIME_KEY] = clock.to_seconds(self.time_ns)
        return row


@dataclass(frozen=True, slots=True)
class PreparedBlock:
    """A block of rows that is ready to be compressed and written.

    Its memory may be that of a journal buffer, which is used again afterwards. So it is valid only during the call that
    it is handed to. A sink that keeps parts of it longer must copy them. `messages` yields copies.
    """

    number: int
    """Its number among the session's blocks with rows. Without rows, it is the number of the next such block."""
    rows: Rows | None
    """Its Message records, with the arrays `channels`, `times` (ns), `starts` and `ends` over them, each [N]; None
    where it holds metadata only."""
    channels: Mapping[int, ChannelInfo] = field(default_factory=dict)
    """The topic of each channel id in it."""
    metadata: tuple[Metadata, ...] = ()
    """Its metadata records (`name`, `values`): parameters, descriptions of topics, and the like."""
    clock: str = UNKNOWN_CLOCK
    """epoch, relative (starts near 0), mixed or unknown: how the tracks' time stamps look up to here."""
    begins_segment: bool = False
    """Whether its rows are on another clock than the rows in the segment so far, so that a new segment begins."""
    shapes: Mapping[int, Shape] = field(default_factory=dict)
    """By channel id, the shape of all rows so far, where the schema is inferred from that."""
    time_steps: bytes = b""
    """The Metadata record of where time stepped back in it; empty if it did not."""
    merged: int = 0
    """How many rows became part of others."""

    def __len__(self) -> int:
        """Return the number of rows."""
        return 0 if self.rows is None else len(self.rows)

    @property
    def size(self) -> int:
        """How many bytes it holds, about."""
        texts = sum(len(name) + len(value) for entry in self.metadata for name, value in entry.values.items())
        return texts + (0 if self.rows is None else len(self.rows.data))

    def messages(self) -> Iterator[BlockMessage]:
        """Yield its rows, in the order in which they were appended."""
        rows = self.rows
        if rows is None:
            return
        decoders = {number: channel.decoder(self.shapes.get(number)) for number, channel in self.channels.items()}
        heads = zip(
            rows.channels.tolist(), rows.times.tolist(), rows.sequences(np.arange(len(rows))).tolist(), strict=True
        )
        for row, (number, time_ns, sequence) in enumerate(heads):
            yield BlockMessage(self.channels[number], time_ns, sequence, rows.payload(row), decoders[number])

    def detached(self) -> PreparedBlock:
        """Return a copy with memory of its own."""
        return self if self.rows is None else replace(self, rows=replace(self.rows, data=self.rows.data.copy()))
