"""Learns from the tracks' rows which clock they run on, and moves earlier events onto that clock."""

from __future__ import annotations

import datetime
import logging
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from .. import clock
from ..mcap.row_arrays import Rows
from . import event_times
from .channels import ChannelInfo
from .fallbacks import Fallbacks

_log = logging.getLogger("ml_dash_mcap")

UNKNOWN_CLOCK = "unknown"


class EventClock:
    """Moves logs and metrics from before the tracks' first row onto the clock of the tracks.

    A viewer refuses a file whose times span from one clock to another. So where the tracks turn out not to run on the
    wall clock, events from before their first row take the time of that row, or stay behind in a segment of their own.
    Used by the writer thread only.
    """

    def __init__(
        self,
        folder: Path,
        about: Mapping[str, str],
        channels: Mapping[int, ChannelInfo],
        fallbacks: Fallbacks,
    ) -> None:
        """Begin without a row of a track.

        Args:
            folder: The run's folder, for the log.
            about: The constant part of the `ml_dash` metadata record.
            channels: The topics by number; others may add to it meanwhile.
            fallbacks: Counts the events whose time cannot be moved.
        """
        self.clock = UNKNOWN_CLOCK
        """epoch, relative (starts near 0), mixed or unknown: how the tracks' time stamps look."""
        self._folder = folder
        self._channels = channels
        self._fallbacks = fallbacks
        self._last_event_ns = _begin_ns(about)
        """The latest wall-clock time (ns) at which no track had a row yet. It stays when the first row comes."""

    def follow(self, rows: Rows, tracks: npt.NDArray[np.bool_]) -> tuple[Rows, bool]:
        """Look at a block's rows, and move events onto the tracks' clock where that is needed.

        Args:
            rows: In the order in which they were appended.
            tracks: By channel id, whether the channel is a track.

        Returns:
            The rows, and whether the rows in the file so far are on another clock than these.
        """
        is_track = tracks[rows.channels]
        previous = self.clock
        if is_track.any():
            self._look(rows.times[is_track])
        if previous != UNKNOWN_CLOCK:
            return rows, False
        is_stamped = event_times.stamped(rows, is_track)
        if self.clock == UNKNOWN_CLOCK:
            self._last_event_ns = max(self._last_event_ns, *rows.times[is_stamped].tolist(), 0)
            return rows, False
        if not event_times.are_elsewhere(rows, is_track, is_stamped, self._last_event_ns, time.time_ns()):
            return rows, False
        return event_times.follow(rows, is_track, is_stamped, self._channels, self._fallbacks), True

    def _look(self, times: npt.NDArray[np.int64]) -> None:
        """Note how the time stamps of tracks look, [N], ns."""
        epoch_like = times >= int(clock.EPOCH_LIKE_S * clock.NS_PER_S)
        now = "epoch" if epoch_like.all() else "mixed" if epoch_like.any() else "relative"
        previous = self.clock
        self.clock = now if previous in (UNKNOWN_CLOCK, now) else "mixed"
        if self.clock == "mixed" != previous:
            _log.warning(
                "the tracks in %s mix wall-clock times and times near 0; viewers refuse such a file", self._folder
            )


def _begin_ns(about: Mapping[str, str]) -> int:
    """Return when a recorder was opened, by the wall clock, in ns; 0 where that is not recorded."""
    try:
        return int(datetime.datetime.fromisoformat(about["run_start"]).timestamp() * clock.NS_PER_S)
    except (KeyError, ValueError):
        return 0
