"""Prepares a sealed buffer for the sinks: shapes, merges and numbers its rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..file_names import TRACK
from ..mcap.record_layout import PREFIX_BYTES, Fields
from ..mcap.records import METADATA, Metadata
from ..mcap.row_arrays import Rows, SealedBuffer, by_channel, pack
from .channels import ChannelInfo
from .event_clock import EventClock
from .fallbacks import Fallbacks
from .merge_block import merge_each, merge_same_time
from .prepared_block import PreparedBlock
from .row_forms import Forms, RowForms
from .time_steps import TimeSteps


@dataclass(frozen=True, slots=True)
class SessionProgress:
    """The part of a session that is in its files already. A recovery goes on from there."""

    next_block: int = 0
    """Number of the first block with rows that is not in a file."""
    sequences: Mapping[int, int] = field(default_factory=dict)
    """Rows in files by channel id."""
    last_ns: Mapping[int, int] = field(default_factory=dict)
    """The last time appended to each channel, in ns."""


class BlockPreparer:
    """Prepares the blocks of one session in order. Used by one thread at a time.

    A block whose preparation failed, for want of memory, may be prepared again.
    """

    def __init__(
        self,
        folder: Path,
        about: Mapping[str, str],
        channels: Mapping[int, ChannelInfo],
        progress: SessionProgress | None = None,
    ) -> None:
        """Begin with the first block that is not in a file.

        Args:
            folder: The run's folder, for the log.
            about: The constant part of the `ml_dash` metadata record.
            channels: The topics by number; others may add to it meanwhile.
            progress: The part of the session that is in files already, in a recovery.
        """
        progress = progress or SessionProgress()
        self.fallbacks = Fallbacks(folder)
        """Counts work that failed for many rows at once and was done row by row."""
        self.steps = TimeSteps(progress.last_ns)
        """The steps back in time of each topic, and the rows that merged across them."""
        self._channels = channels
        self._forms = RowForms(channels, self.fallbacks)
        self._event_clock = EventClock(folder, about, channels, self.fallbacks)
        self._sequences: dict[int, int] = dict(progress.sequences)
        self._next_block = progress.next_block
        self._begun: tuple[SealedBuffer, Rows, bool] | None = None
        """The block in preparation, after its times were looked at. It is kept until its preparation has succeeded."""

    def prepare(self, block: SealedBuffer) -> PreparedBlock:
        """Return a sealed buffer's rows shaped, merged and numbered. Its sequence numbers are changed in place."""
        metadata = tuple(_metadata(block, start, end) for start, end in block.extras)
        if not block.starts:
            return PreparedBlock(self._next_block, None, metadata=metadata, clock=self._event_clock.clock)
        tracks = self._tracks()
        # These two learn from each block, so they must see it once only, even if the rest is tried again.
        if self._begun is None or self._begun[0] is not block:
            rows, is_elsewhere = self._event_clock.follow(pack(block), tracks)
            self.steps.look(rows, tracks)
            self._begun = (block, rows, is_elsewhere)
        _, rows, is_elsewhere = self._begun
        merged = self._merge(rows, self._forms.of_block(rows))
        ends = self._number(merged)
        channels = {number: self._channels[number] for number in ends}
        topics = {number: channel.topic for number, channel in channels.items()}
        prepared = PreparedBlock(
            self._next_block,
            merged,
            channels,
            metadata,
            clock=self._event_clock.clock,
            begins_segment=is_elsewhere,
            shapes=self._forms.shapes_of(ends),
            time_steps=self.steps.record(self._next_block, topics, merged, ends),
            merged=len(rows) - len(merged),
        )
        self._begun = None
        self._next_block += 1
        self._sequences.update(ends)
        return prepared

    def _tracks(self) -> npt.NDArray[np.bool_]:
        """Return, by channel id, whether it is a track or has times as tracks have them."""
        # A copy, because other threads may open topics while this iterates.
        channels = list(self._channels.items())
        tracks = np.zeros(max(number for number, _ in channels) + 1, np.bool_)
        for number, info in channels:
            tracks[number] = info.has_times_of_tracks
        return tracks

    def _merge(self, rows: Rows, forms: Forms) -> Rows:
        infos = list(self._channels.items())
        codecs = {number: info.codec for number, info in infos if info.kind == TRACK and info.codec is not None}
        notes: list[tuple[int, list[int], bool]] = []
        note = (lambda *merge: notes.append(merge)) if self.steps.has_steps else None
        try:
            merged = merge_same_time(rows, codecs, forms, self._forms.keys_of, note)
        except Exception as error:
            self.fallbacks.note("merging the rows of a block", error)
            # The failed attempt may have noted some merges already; they are noted again below.
            notes.clear()
            merged = merge_each(rows, codecs, self._note_unmerged, note)
        for merge in notes:
            self.steps.note_merged(*merge)
        return merged

    def _note_unmerged(self, error: Exception) -> None:
        self.fallbacks.note("merging rows of one time", error, "they are merged when they are read")

    def _number(self, rows: Rows) -> dict[int, int]:
        """Number each channel's rows on from its last row; returns how many rows each channel has with these."""
        sequence = np.zeros(len(rows), np.int64)
        ends = {}
        for number, which in by_channel(rows):
            first = self._sequences.get(number, 0)
            sequence[which] = first + np.arange(len(which))
            ends[number] = first + len(which)
        rows.number(sequence.astype(np.uint32))
        return ends


def _metadata(block: SealedBuffer, start: int, end: int) -> Metadata:
    return METADATA.read(Fields(block.data[start:end].tobytes(), "", start=PREFIX_BYTES))
