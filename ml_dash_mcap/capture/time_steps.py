"""Counts where time steps back on a topic, and which rows of one time merge across such a step."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.ma  # numpy.unique() would load it at the first block: 20 ms, beside a control loop
import numpy.typing as npt

from .. import clock
from ..file_names import STEPS_RECORD
from ..mcap.records import METADATA, Metadata
from ..mcap.row_arrays import Rows

TOLERANCE_S = 0.05
"""In seconds. A row steps back if its time lies further than this before that of the row appended before it. Smaller
steps are usual where several threads append to one topic: a thread may pause between taking its time and appending."""

_TOLERANCE_NS = int(TOLERANCE_S * clock.NS_PER_S)

Passes = npt.NDArray[np.int64]


@dataclass(slots=True)
class StepCounts:
    """The steps back of one topic."""

    steps: int = 0
    """Steps back."""
    by_ns: int = 0
    """The largest step back, ns."""
    merged: int = 0
    """Rows that were merged with a row of the same time from before a step back."""
    overwritten: int = 0
    """Merged rows with a field that the earlier row had, too, so that its value is lost."""

    def take(self, other: StepCounts) -> None:
        """Add the counts of a block."""
        self.steps += other.steps
        self.by_ns = max(self.by_ns, other.by_ns)
        self.merged += other.merged
        self.overwritten += other.overwritten


class TimeSteps:
    """Watches the times of one recorder's tracks, block by block, before rows merge. For the writer thread.

    Merging hides what happened: of three episodes that begin at t = 0 a single one is left, with the values of the
    last. So each block in which time steps back has a metadata record in the file, before its chunks. The record is
    about its block alone. If a recovery writes the block again, its number tells that it is the same.
    """

    def __init__(self, last_ns: Mapping[int, int] | None = None) -> None:
        """Begin.

        Args:
            last_ns: The last time appended to each channel, in ns, where a recovery goes on.
        """
        self.totals: dict[int, StepCounts] = {}
        """By channel id; read by other threads."""
        self._last_ns = dict(last_ns or {})
        self._block: dict[int, StepCounts] = {}
        self._passes: Passes | None = None

    def look(self, rows: Rows, tracks: npt.NDArray[np.bool_]) -> None:
        """Look at a block's rows, in the order in which they were appended.

        Args:
            rows: Before any are merged.
            tracks: By channel id, whether the channel is a track.
        """
        self._block = {}
        self._passes = None
        order = np.argsort(rows.channels.astype(np.uint16), kind="stable")  # of 16 bits numpy sorts in linear time
        channels, times = rows.channels[order], rows.times[order]
        firsts = np.flatnonzero(np.diff(channels, prepend=-1))
        lasts = np.append(firsts[1:], len(times)) - 1
        # Sorted by channel, the row before a channel's first row is of another channel; these are replaced below.
        previous = np.concatenate((times[:1], times[:-1]))
        first_times = zip(channels[firsts].tolist(), times[firsts].tolist(), strict=True)
        previous[firsts] = [self._last_ns.get(number, time_ns) for number, time_ns in first_times]
        self._last_ns.update(zip(channels[lasts].tolist(), times[lasts].tolist(), strict=True))
        by_ns = previous - times
        is_step = (by_ns > _TOLERANCE_NS) & tracks[channels]
        if not is_step.any():
            return
        self._passes = np.empty(len(rows), np.int64)
        # The number of steps so far: rows of one channel with different numbers have a step between them.
        self._passes[order] = np.cumsum(is_step)
        for number in np.unique(channels[is_step]).tolist():
            steps_ns = by_ns[is_step & (channels == number)]
            self._block[number] = StepCounts(len(steps_ns), int(steps_ns.max()))

    @property
    def has_steps(self) -> bool:
        """Whether time steps back in the block, so that merges count."""
        return self._passes is not None

    def note_merged(self, channel: int, same: list[int], is_disjoint: bool) -> None:
        """Note that rows of one time and channel become one row.

        Args:
            channel: The channel id.
            same: The numbers of the rows in the block.
            is_disjoint: Whether no two of them have a field in common.
        """
        if self._passes is None or channel not in self._block:
            return
        rows = len(set(self._passes[same].tolist())) - 1
        self._block[channel].merged += rows
        self._block[channel].overwritten += 0 if is_disjoint else rows

    def record(self, number: int, topics: Mapping[int, str], merged: Rows, next_sequence: Mapping[int, int]) -> bytes:
        """Return the block's metadata record; empty where no time stepped back in it.

        Args:
            number: The number of the block.
            topics: Names by channel id.
            merged: The rows of the block after merging.
            next_sequence: By channel id, how many rows the topic has in files with this block.
        """
        by_topic: dict[str, dict[str, int]] = {}
        for channel in self._hidden(merged):
            counts = self._block.get(channel, StepCounts())
            by_topic[topics[channel]] = {
                "steps_back": counts.steps,
                "by_ns": counts.by_ns,
                "merged": counts.merged,
                "overwritten": counts.overwritten,
                "last_ns": self._last_ns[channel],
                "rows": next_sequence[channel],
            }
        if not by_topic:
            return b""
        return METADATA.pack(Metadata(STEPS_RECORD, {"block": str(number), "topics": json.dumps(by_topic)}))

    def _hidden(self, merged: Rows) -> Iterable[int]:
        """Return the channels with a step back, and those whose last row in the file is not the last row appended."""
        # unique() returns first indices, so on the reversed array the last row of each channel.
        numbers, at = np.unique(merged.channels[::-1], return_index=True)
        last_ns = merged.times[::-1][at]
        for channel, time_ns in zip(numbers.tolist(), last_ns.tolist(), strict=True):
            if channel in self._block or self._last_ns.get(channel, time_ns) != time_ns:
                yield channel

    def commit(self) -> None:
        """Add the block's counts to the totals."""
        for channel, counts in self._block.items():
            self.totals.setdefault(channel, StepCounts()).take(counts)
        self._block = {}
