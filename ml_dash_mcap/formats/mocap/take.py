"""A take: the content of motion capture files of a recording, on one clock, window by window."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...errors import ConversionWarning
from ...meaning import space
from ...meaning.mocap_objects import Body, Joint, Marker
from ..export_job import Job, RowCounter
from .placement import Note, Placing
from .take_clock import Clock
from .take_options import TakeOptions
from .topic_frames import TopicFrames

Floats = npt.NDArray[np.float64]
Thing = Body | Marker | Joint

_WINDOW = 1024
"""Frames at a time: about as many as one block has, so that those who read ahead need not wait for one of us."""


@dataclass(frozen=True, slots=True)
class FrameWindow:
    """Some frames of a take."""

    frames: npt.NDArray[np.int64]
    """Their numbers, [N], from 0."""
    times: Floats
    """From the take's origin, [N], s."""
    values: Floats
    """[N, C], NaN where something is missing; `Take.columns` says which column is what."""


@dataclass(frozen=True, slots=True)
class OutgoingTake:
    """The objects that are written to a file, and the clock that they are on."""

    job: Job
    options: TakeOptions
    things: list[Thing]
    """In the order of their columns."""
    clock: Clock

    def columns(self) -> list[tuple[Thing, int]]:
        """Return each object with its first column. Bodies have x y z w, x y z, and the error if they have one."""
        return list(zip(self.things, np.cumsum([0, *map(_width, self.things)]).tolist(), strict=False))

    def unit_of(self, thing: Thing) -> str:
        """Return the unit of an object's lengths, in which its values stand."""
        source = thing.value if isinstance(thing, Joint) else thing.position
        return space.unit_of(self.job.topics[thing.topic].metadata, source.columns[0])

    def windows(self) -> Iterator[FrameWindow]:
        """Yield all frames, some thousand at a time.

        Raises:
            ConversionError: A quaternion or matrix is no rotation, or a field changes its size.
        """
        self._warn_of_axes()
        counter = self.job.counter()
        topics = [self._topic(topic, counter) for topic in dict.fromkeys(thing.topic for thing in self.things)]
        width = sum(map(_width, self.things))
        for first in range(0, self.clock.count, _WINDOW):
            part = self.clock.part(first, min(first + _WINDOW, self.clock.count))
            values = np.full((len(part.frames), width), np.nan)
            for topic in topics:
                topic.fill(values, part.times, first)
            yield FrameWindow(part.frames, part.times - self.clock.origin, values)
        counter.finish()
        bad = sum(topic.bad for topic in topics)
        if bad:
            warnings.warn(f"{bad} values that are no rotations were left out", ConversionWarning, stacklevel=2)

    def note(self, placing: Placing, joints: str | None = None) -> Note:
        """Return the note of a file: what its columns were in the recording.

        Args:
            placing: Of the columns.
            joints: The name of the file beside it that has the joints, if there is one.
        """
        topics = dict.fromkeys(thing.topic for thing in self.things)
        metadata = {topic: self.job.topics[topic].metadata for topic in topics}
        return Note(self.clock.origin, self.options.up, placing.placements(), metadata, joints)

    def _warn_of_axes(self) -> None:
        """Warn if a file will have two axes that point up, for it can name only one."""
        topics = dict.fromkeys(thing.topic for thing in self.things if not isinstance(thing, Joint))
        ups = {topic: space.up_of(self.job.topics[topic].metadata) for topic in topics}
        if self.options.up is None and len(set(ups.values())) > 1:
            axes = ", ".join(f"{up} in {topic!r}" for topic, up in ups.items())
            warnings.warn(
                f"the topics have different axes that point up ({axes}), and nothing is turned; pass up='z' or 'y'",
                ConversionWarning,
                stacklevel=2,
            )

    def _topic(self, topic: str, counter: RowCounter) -> TopicFrames:
        mine = [(thing, at) for thing, at in self.columns() if thing.topic == topic]
        info = self.job.topics[topic]
        # Between the integers of a mode or a counter there is nothing, so they are held.
        held = {name for name, field in info.fields.items() if field.type == "integer" and not field.shape}
        return TopicFrames(self.job.part(topic), info.metadata, mine, self.clock, self.options, counter, held=held)


def _width(thing: Thing) -> int:
    if isinstance(thing, Body):
        return 7 if thing.error is None else 8
    return 3 if isinstance(thing, Marker) else 1
