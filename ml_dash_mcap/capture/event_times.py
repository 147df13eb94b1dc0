"""Moves events that have wall-clock times onto the tracks' clock, where the tracks turn out to have another one."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from .. import clock
from ..mcap.row_arrays import Rows, replaced
from .channels import ChannelInfo
from .fallbacks import Fallbacks
from .tracks_clock import NOW_S

WALL_STAMPED = 1
"""An event has this sequence number in the journal if the wall clock gave it its time. All other rows have 0. The true
sequence number is set when the row goes to the file."""

_NOW_NS = int(NOW_S * clock.NS_PER_S)

Flags = npt.NDArray[np.bool_]


def stamped(rows: Rows, is_track: Flags) -> Flags:
    """Tell which rows are events at a time that the wall clock gave them, [N]."""
    events = np.flatnonzero(~is_track)
    is_stamped = np.zeros(len(rows), np.bool_)
    is_stamped[events] = rows.sequences(events) == WALL_STAMPED
    return is_stamped


def are_elsewhere(rows: Rows, is_track: Flags, is_stamped: Flags, since_ns: int, now_ns: int) -> bool:
    """Tell whether the tracks' first rows are all at times that the wall clock did not show while they came in.

    Args:
        rows: The first rows of tracks, with the events around them, in the order in which they were appended.
        is_track: Which rows are of tracks, at least one row, [N].
        is_stamped: Which rows are events at times of the wall clock, [N].
        since_ns: A time of the wall clock at which there was no row of a track yet, in ns.
        now_ns: The wall clock, later, in ns.
    """
    first = int(is_track.argmax())
    earlier = rows.times[:first][is_stamped[:first]]
    since_ns = max(since_ns, int(earlier.max())) if len(earlier) else since_ns
    low, high = min(since_ns, now_ns), max(since_ns, now_ns)
    times = rows.times[is_track]
    return not bool(((times >= low - _NOW_NS) & (times <= high + _NOW_NS)).any())


def follow(
    rows: Rows, is_track: Flags, is_stamped: Flags, channels: Mapping[int, ChannelInfo], fallbacks: Fallbacks
) -> Rows:
    """Give each stamped event the time of the row of a track before it, or of the first such row if none is before it.

    Nothing of an event but its time is changed. An event whose time cannot be moved keeps it, and is counted: an event
    at the wrong time is worth less than a writer that goes on.

    Args:
        rows: The first rows of tracks, with the events around them, in the order in which they were appended.
        is_track: Which rows are of tracks, at least one row, [N].
        is_stamped: Which rows are events at times of the wall clock, [N].
        channels: The topics by number.
        fallbacks: Counts the events whose time cannot be moved.
    """
    tracks = np.flatnonzero(is_track)
    payloads: dict[int, tuple[int, bytes]] = {}
    for row in np.flatnonzero(is_stamped).tolist():
        at = tracks[max(int(np.searchsorted(tracks, row)) - 1, 0)]
        time_ns = int(rows.times[at])
        codec = channels[int(rows.channels[row])].codec
        try:
            if codec is not None:
                payloads[row] = (time_ns, codec.with_time(rows.payload(row), clock.to_seconds(time_ns)))
        except Exception as error:
            fallbacks.note("moving an event to the tracks' clock", error, "the event keeps its wall-clock time")
    return replaced(rows, np.ones(len(rows), np.bool_), payloads) if payloads else rows
