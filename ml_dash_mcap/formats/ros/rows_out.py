"""Turns the topics of a recording into the messages of a ROS bag, block by block, in time order."""

from __future__ import annotations

import functools
import heapq
import json
import math
from collections.abc import Callable, Iterator, Mapping
from itertools import chain
from operator import or_
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ... import clock
from ...codecs.ros.message_columns import Constant, Indices, pick
from ...codecs.ros.pack import Packed, pack
from ...errors import ConversionError
from ...mcap.message import MessageBlock
from ...query import exact_blocks
from ...query import topic_rows as rows
from ...query.file import File
from ...rows.plain_row import TIME_KEY
from ...rows.shape import NOTHING, Shape
from ...rows.table import Block
from ...rows.value_shapes import of_values
from ...store import read_ahead
from ..export_job import Job
from . import bag_images, ros_names
from .bag_plan import Outlet, Planner, Settings, TopicPlan
from .carry_out import Carried
from .messages import arrow_blocks as blocks
from .messages import interface_package as interfaces
from .messages import lossless
from .messages import standard_columns as messages
from .messages.context import BadRows
from .messages.fill import MisfitError, fill
from .messages.lossless import Message
from .messages.standard import Derived

Part = Block | list[dict[str, Any]]

_OVERLAP_S = 1.0
"""How far the messages of one topic may run ahead of another's where they must be nearly in order, in s."""

_END_S = 2**31
"""The first time that a header's stamp cannot say, in s (year 2038)."""


class _Stamped(list[dict[str, Any]]):
    """Rows of messages that are never merged: their times are known to the nanosecond, which doubles do not tell."""

    def __init__(self, rows: list[dict[str, Any]], times_ns: list[int]) -> None:
        super().__init__(rows)
        self.times_ns = times_ns

    def __getitem__(self, key: Any) -> Any:
        rows = super().__getitem__(key)
        return _Stamped(rows, self.times_ns[key]) if isinstance(key, slice) else rows

    def __add__(self, others: Any) -> Any:
        return _Stamped([*self, *others], [*self.times_ns, *others.times_ns]) if others else self


class Sent(NamedTuple):
    """Messages of one topic, in time order."""

    outlet: Outlet
    times_ns: npt.NDArray[np.uint64]
    packed: Packed


class Outgoing:
    """The messages of a recording for a bag."""

    def __init__(self, job: Job, settings: Settings, carried: Carried | None = None) -> None:
        """Look at the first rows of each topic.

        Args:
            job: Topics whose rows become messages.
            settings: What the caller wants of the bag.
            carried: Messages that go into the bag as they are.

        Raises:
            ConversionError: The mapping does not fit.
        """
        self._job = job
        self._settings = settings
        self._started: dict[str, Iterator[Part]] = {}
        self._carried = carried
        self._planner = Planner(job, settings, () if carried is None else carried.outlets)
        self._images = bag_images.images(settings.embed_images, job.files)
        self._is_wide = False
        self._last = math.inf
        self._reached = -math.inf
        shapes: dict[str, Shape] = {}
        for topic in job.topics:
            parts = self._parts(topic)
            first = next(parts, None)
            shapes[topic] = NOTHING if first is None else _shape_of(first)
            # The block that was read to plan is written too: reading it again would decode it twice.
            self._started[topic] = parts if first is None else chain([first], parts)
        self.plans = self._planner.plan(shapes)

    def widen(self) -> None:
        """Read all rows, and plan for all that they have; called when `messages` found rows that did not fit.

        Raises:
            ConversionError: They have changed since they were read.
        """
        if self._is_wide:
            raise ConversionError("the recording has other rows than a moment ago; export it when it is finished")
        self._is_wide = True
        self._started.clear()
        shapes = {
            topic: functools.reduce(or_, map(_shape_of, self._parts(topic)), NOTHING) for topic in self._job.topics
        }
        self.plans = self._planner.plan(shapes)

    @property
    def outlets(self) -> list[Outlet]:
        """All topics of the bag."""
        return [*(() if self._carried is None else self._carried.outlets), *self._planner.outlets]

    @property
    def carried_files(self) -> list[File]:
        """The files that carried messages come from."""
        return [] if self._carried is None else self._carried.files

    @property
    def own_messages(self) -> list[Message]:
        """The messages that hold whole rows."""
        return list({plan.message.name: plan.message for plan in self.plans if plan.own is not None}.values())

    def about(self) -> dict[str, Any]:
        """Return what an import of the bag needs: the bag's topics to ours, and the description of the recording."""
        own = {plan.own.topic: plan.topic for plan in self.plans if plan.own is not None}
        derived = {outlet.topic: plan.topic for plan in self.plans for _, outlet in plan.derived}
        topics = {
            name: {"description": info.description, "tags": list(info.tags), "metadata": dict(info.metadata)}
            for name, info in self._job.topics.items()
        }
        return {
            "version": 1,
            "profile": self._settings.profile,
            "topics": own,
            "derived": derived,
            "about": topics,
            "params": self._job.about.get("params", {}),
        }

    def messages(self) -> Iterator[tuple[int, list[Sent] | MessageBlock]]:
        """Yield the messages of some rows of one topic each, or some that are carried, by the time of the first one.

        Yields:
            How many rows, and their messages; no rows after `finish_up`, when all are done that belong before.

        Raises:
            MisfitError: A row has something that the topic's message cannot say: `widen`, and begin again.
            ConversionError: A message cannot hold what a row has; the error names the row.
        """
        waiting: list[_Waiting] = []
        done = dict.fromkeys(range(len(self.plans)), 0)
        blocks = iter(()) if self._carried is None else self._carried.blocks()
        _push(waiting, _CARRIED, next(blocks, None), blocks)
        for number, plan in enumerate(self.plans):
            parts = self._started.pop(plan.topic, None) or self._parts(plan.topic)
            _push(waiting, number, next(parts, None), parts)
        while waiting:
            start, number, part, parts = heapq.heappop(waiting)
            if start > self._last:
                self._last = math.inf
                yield 0, []
            if isinstance(part, MessageBlock):
                self._reached = max(self._reached, float(_times(part).max()))
                yield len(part), part
                _push(waiting, number, next(parts, None), parts)
                continue
            others = min((other[0] for other in waiting), default=math.inf) if self._settings.is_in_order else math.inf
            now, later = _cut(part, min(others + _OVERLAP_S, self._last))
            now, later = self._portion(self.plans[number], now, later)
            self._reached = max(self._reached, float(_times(now)[-1]))
            yield exact_blocks.size(now), self._convert(self.plans[number], now, done[number])
            done[number] += exact_blocks.size(now)
            _push(waiting, number, next(parts, None) if later is None else later, parts)

    def finish_up(self) -> None:
        """Ask for all messages up to the latest so far before later ones."""
        self._last = min(self._last, self._reached)

    def _portion(self, plan: TopicPlan, now: Part, later: Part | None) -> tuple[Part, Part | None]:
        """Put off rows that together name more images than should be in memory at once."""
        if self._images is None or not plan.paths:
            return now, later
        rows: Any = now if isinstance(now, list) else blocks.to_rows(now)
        count = self._images.fitting(rows, plan.paths)
        if count == len(rows):
            return rows, later
        rest = [] if later is None else later if isinstance(later, list) else blocks.to_rows(later)
        return rows[:count], rows[count:] + rest

    def _parts(self, topic: str) -> Iterator[Part]:
        job = self._job
        stored = job.stored(topic)
        if stored.is_track:
            return exact_blocks.read(stored, job.low, job.high)
        stamped = rows.stamped(stored, job.low, job.high)
        return (_Stamped(some, times_ns) for some, times_ns in stamped)

    # -- rows to messages ----------------------------------------------------------------------------------------------

    def _convert(self, plan: TopicPlan, part: Part, before: int) -> list[Sent]:
        settings = self._settings
        count = exact_blocks.size(part)
        times = _times(part)
        stamps = self._stamps(plan, times, getattr(part, "times_ns", None), before)
        is_row_text = plan.message.fields and plan.message.fields[0].key == lossless.ROW_KEY
        if isinstance(part, Block):
            column = fill(plan.message, blocks.to_rows(part)) if is_row_text else blocks.fill_block(plan.message, part)
        else:
            column = fill(plan.message, part)
        frame = _frame(self._planner.metadata[plan.topic].get("frame_id"), settings.frame_id)
        header = _header(stamps, frame, before, is_ros1=settings.is_ros1)
        sent = []
        if plan.own is not None:
            whole = {"header": header, "ts": times, **column}
            packed = pack(plan.own.definitions, whole, count, is_ros1=settings.is_ros1, room=settings.room)
            sent.append(Sent(plan.own, stamps, packed))
        for derived, outlet in plan.derived:
            rows = messages.present(plan.message, column, derived, count)
            rows, built = self._built(plan, derived, column, rows, times, header, before)
            if len(rows):
                packed = pack(outlet.definitions, built, len(rows), is_ros1=settings.is_ros1, room=settings.room)
                sent.append(Sent(outlet, stamps[rows], packed))
        return sent

    def _built(
        self, plan: TopicPlan, derived: Derived, column: Any, rows: Indices, times: Any, header: Any, before: int
    ) -> tuple[Indices, dict[str, Any]]:
        """Return the columns of a standard message and the rows that they are of."""
        header = {**header, "frame_id": Constant(_frame(derived.metadata.get("frame_id"), self._settings.frame_id))}
        while len(rows):
            load = self._images.load if self._images is not None else None
            built = messages.build(derived, column, rows, times, pick(header, rows), load)
            if not isinstance(built, BadRows):
                return rows, built
            row = int(rows[int(np.argmax(built.which))])
            where = f"topic {plan.topic!r}, row {before + row} (_ts={float(times[row])!r})"
            if self._settings.on_bad == "raise" and (derived.is_asked or not built.is_other):
                raise ConversionError(
                    f"{where}: {built.what}, so {derived.topic} cannot be written; pass on_bad='lossless' to leave such"
                    f" rows out of it, mapping={{{plan.topic!r}: {{{_suffix(plan, derived)!r}: None}}}} to leave it"
                    " out, or profile='lossless'"
                )
            self._planner.warn(
                f"topic {plan.topic!r}: {derived.topic} lacks rows that it cannot say", f"{where}: {built.what}"
            )
            rows = rows[~built.which]
        return rows, {}

    def _stamps(
        self, plan: TopicPlan, times: npt.NDArray[np.float64], times_ns: list[int] | None, before: int
    ) -> npt.NDArray[np.uint64]:
        times_of_rows = clock.to_nanoseconds_each(times) if times_ns is None else np.array(times_ns, np.uint64)
        stamps = times_of_rows.astype(np.int64) + round(self._settings.time_offset * clock.NS_PER_S)
        bad = (stamps < 0) | (stamps >= _END_S * clock.NS_PER_S)
        if bad.any():
            row = int(np.argmax(bad))
            raise ConversionError(
                f"topic {plan.topic!r}, row {before + row} (_ts={float(times[row])!r}): a bag's times lie between 0 and"
                f" {_END_S} s (1970 to 2038), and with time_offset={self._settings.time_offset!r} this one does not;"
                " pass another"
            )
        return stamps.astype(np.uint64)


def _frame(stated: object, otherwise: str) -> str:
    return stated if isinstance(stated, str) and "\0" not in stated else otherwise


def _suffix(plan: TopicPlan, derived: Derived) -> str:
    base = (plan.own.topic if plan.own is not None else ros_names.topic(plan.topic)) + "/"
    return derived.topic.removeprefix(base)


def _shape_of(part: Part) -> Shape:
    return of_values(part) if isinstance(part, list) else blocks.shape_of(part)


def _times(part: Part | MessageBlock) -> npt.NDArray[np.float64]:
    if isinstance(part, MessageBlock):
        return np.array(clock.to_seconds_each([int(part.times_ns.min()), int(part.times_ns.max())]))
    if isinstance(part, list):
        return np.array([row[TIME_KEY] for row in part], np.float64)
    times: npt.NDArray[np.float64] = part.columns[TIME_KEY].array.to_numpy(zero_copy_only=False)
    return times


_Waiting = tuple[float, int, Part | MessageBlock, Iterator[Any]]

_CARRIED = -1
"""Stands for the number of a plan."""


def _push(waiting: list[_Waiting], number: int, part: Part | MessageBlock | None, parts: Iterator[Any]) -> None:
    if part is not None:
        # Each number waits once at most, so the heap never compares two parts, which have no order.
        heapq.heappush(waiting, (float(_times(part)[0]), number, part, parts))


def _cut(part: Part, last: float) -> tuple[Part, Part | None]:
    """Divide rows into those up to a time, the first one always among them, and those after it."""
    times = _times(part)
    if times[-1] <= last:
        return part, None
    count = max(1, int(np.searchsorted(times, last, "right")))
    if isinstance(part, list):
        return part[:count], part[count:]
    return part.slice(0, count), part.slice(count, part.count - count)


def _header(stamps: npt.NDArray[np.uint64], frame: str, before: int, *, is_ros1: bool) -> dict[str, Any]:
    seconds, nanoseconds = np.divmod(stamps, np.uint64(clock.NS_PER_S))
    names = ("secs", "nsecs") if is_ros1 else ("sec", "nanosec")
    return {
        # A sequence number has 32 bits in ROS 1 and starts again at 0; numpy's cast does the same.
        "seq": np.arange(before, before + len(stamps), dtype=np.int64).astype(np.uint32),
        "stamp": dict(zip(names, (seconds.astype(np.int32), nanoseconds.astype(np.uint32)), strict=True)),
        "frame_id": Constant(frame),
    }


def packed(
    steps: Iterator[tuple[int, list[Sent] | MessageBlock]],
    prepare: Callable[[MessageBlock], Any],
    *,
    is_split: bool = False,
) -> Iterator[tuple[int, Any]]:
    """Yield what `Outgoing.messages` does, with what is carried prepared for its file, on all cores.

    Args:
        steps: The messages.
        prepare: Of the file.
        is_split: Whether each has to be written before the next is asked for, so that a file can end behind it.
    """

    def work(step: tuple[int, list[Sent] | MessageBlock]) -> tuple[int, Any]:
        return step[0], step[1] if isinstance(step[1], list) else prepare(step[1])

    if is_split:
        return map(work, steps)
    return read_ahead.in_order(work, steps, weigh=lambda step: 0 if isinstance(step[1], list) else 2 * step[1].size)


def to_text(about: Mapping[str, Any]) -> str:
    """Return the description that an import needs as JSON."""
    return json.dumps(about)


def write_package(folder: Path, outgoing: Outgoing) -> None:
    """Write the interface package of a bag's messages that say all, if there are any."""
    messages = outgoing.own_messages
    for path, text in interfaces.files(messages, folder.name).items() if messages else ():
        place = folder / path
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(text, encoding="utf-8")


__all__ = ["MisfitError", "Outgoing", "Sent", "packed", "to_text", "write_package"]
