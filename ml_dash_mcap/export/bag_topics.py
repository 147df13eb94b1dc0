"""A recording's topics as the messages of a ROS bag, block by block, in time order."""

from __future__ import annotations

import heapq
import json
import math
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from .. import clock
from ..errors import ConversionError, ConversionWarning, OptionError
from ..read import exact
from ..ros import blocks, forms, lossless, messages, msg, names, standard, stores
from ..ros import package as interfaces
from ..ros.columns import Constant, Indices, Struct, pick
from ..ros.fill import MisfitError, fill
from ..ros.forms import Form
from ..ros.lossless import Message
from ..ros.pack import Packed, pack
from ..ros.standard import Derived
from ..rows.encode import TIME_KEY
from ..rows.table import Block
from .job import Job

Part = Block | list[dict[str, Any]]

PROFILES = ("std+lossless", "std", "lossless", "json")
_OVERLAP_S = 1.0
"""How far the messages of one topic may run ahead of another's where they must be nearly in order, in s."""

_END_S = 2**31
"""The first time that a header's stamp cannot say, in s (year 2038)."""


@dataclass(frozen=True, slots=True)
class Settings:
    """What a caller wants of a bag, whatever its format."""

    profile: str = "std+lossless"
    mapping: Mapping[str, Any] | None = None
    time_offset: float = 0.0
    """Added to all times but the field `ts`, in s."""
    package: str = "ml_dash_msgs"
    frame_id: str = ""
    """Of topics whose metadata has none."""
    tf: bool = False
    on_bad: str = "raise"
    is_ros1: bool = False
    room: int = 0
    """Bytes to leave before each message."""
    is_in_order: bool = False
    """Whether messages of different topics must be nearly in order."""

    def __post_init__(self) -> None:
        names.check_package(self.package)
        for name, value, known in (
            ("profile", self.profile, PROFILES),
            ("on_bad", self.on_bad, ("raise", "lossless")),
        ):
            if value not in known:
                raise OptionError(f"{name}={value!r}: it must be one of {', '.join(map(repr, known))}")
        if self.mapping is not None and not isinstance(self.mapping, Mapping):
            raise OptionError(f"mapping={self.mapping!r}: pass a dict of topics")
        if not isinstance(self.time_offset, (int, float)) or not np.isfinite(self.time_offset):
            raise OptionError(f"time_offset={self.time_offset!r}: pass seconds")


@dataclass(frozen=True, slots=True)
class Outlet:
    """A topic of the bag."""

    number: int
    topic: str
    type: str
    """With its package, as in "sensor_msgs/msg/JointState"."""
    text: str
    """The type's definition, followed by those of the messages in it."""
    digest: str
    struct: Struct = field(repr=False)


class Sent(NamedTuple):
    """Messages of one topic, in time order."""

    outlet: Outlet
    times_ns: npt.NDArray[np.uint64]
    packed: Packed


@dataclass(frozen=True, slots=True)
class Plan:
    """How the rows of a topic become messages."""

    topic: str
    message: Message
    own: Outlet | None
    """For the message that says all; None if it is not wanted."""
    derived: tuple[tuple[Derived, Outlet], ...]


class Outgoing:
    """The messages of a recording for a bag."""

    def __init__(self, job: Job, settings: Settings) -> None:
        """Look at the first rows of each topic.

        Raises:
            ConversionError: The mapping does not fit.
        """
        self._job = job
        self._settings = settings
        self._started: dict[str, Iterator[Part]] = {}
        self._metadata = {name: _metadata(job, name) for name in job.topics}
        self._warned: set[str] = set()
        self._last = math.inf
        self._reached = -math.inf
        found: dict[str, Form] = {}
        for topic in job.topics:
            parts = self._parts(topic)
            first = next(parts, None)
            found[topic] = _take_in(Form(), [] if first is None else first)
            self._started[topic] = parts if first is None else chain([first], parts)
        self._plan(found)

    def widen(self) -> None:
        """Read all rows, and plan for all that they have; called when `messages` found rows that did not fit."""
        self._started.clear()
        found = {topic: Form() for topic in self._job.topics}
        for topic, form in found.items():
            for part in self._parts(topic):
                _take_in(form, part)
        self._plan(found)

    @property
    def outlets(self) -> list[Outlet]:
        """All topics of the bag."""
        return self._outlets

    @property
    def own_messages(self) -> list[Message]:
        """The messages that say all."""
        return list({plan.message.name: plan.message for plan in self.plans if plan.own is not None}.values())

    def about(self) -> dict[str, Any]:
        """Return what the way back wants to know: our topics by those of the bag, and what else is recorded."""
        own = {plan.own.topic: plan.topic for plan in self.plans if plan.own is not None}
        derived = {outlet.topic: plan.topic for plan in self.plans for _, outlet in plan.derived}
        said = {
            name: {"description": info.description, "tags": list(info.tags), "metadata": dict(info.metadata)}
            for name, info in self._job.topics.items()
        }
        return {
            "version": 1,
            "profile": self._settings.profile,
            "topics": own,
            "derived": derived,
            "about": said,
            "params": self._job.about.get("params", {}),
        }

    def messages(self) -> Iterator[tuple[int, list[Sent]]]:
        """Yield the messages of some rows of one topic each, by the time of the first one.

        Yields:
            How many rows, and their messages; no rows after `finish_up`, when all are done that belong before.

        Raises:
            MisfitError: A row has something that the topic's message cannot say: `widen`, and begin again.
            ConversionError: A row cannot be said; the message names it.
        """
        waiting: list[_Waiting] = []
        done = dict.fromkeys(range(len(self.plans)), 0)
        for number, plan in enumerate(self.plans):
            parts = self._started.pop(plan.topic, None) or self._parts(plan.topic)
            _push(waiting, number, next(parts, None), parts)
        while waiting:
            start, number, part, parts = heapq.heappop(waiting)
            if start > self._last:
                self._last = math.inf
                yield 0, []
            others = min((one[0] for one in waiting), default=math.inf) if self._settings.is_in_order else math.inf
            now, later = _cut(part, min(others + _OVERLAP_S, self._last))
            self._reached = max(self._reached, float(_times(now)[-1]))
            yield exact.size(now), self._convert(self.plans[number], now, done[number])
            done[number] += exact.size(now)
            _push(waiting, number, next(parts, None) if later is None else later, parts)

    def finish_up(self) -> None:
        """Ask for all messages up to the latest so far before later ones."""
        self._last = min(self._last, self._reached)

    def _parts(self, topic: str) -> Iterator[Part]:
        return exact.read(self._job.files, topic, self._job.low, self._job.high)

    # -- planning ------------------------------------------------------------------------------------------------------

    def _plan(self, found: Mapping[str, Form]) -> None:
        self._outlets: list[Outlet] = []
        taken_types: set[str] = set()
        taken_topics: set[str] = set()
        self.plans = [self._planned(topic, form, taken_types, taken_topics) for topic, form in found.items()]

    def _planned(self, topic: str, form: Form, taken_types: set[str], taken_topics: set[str]) -> Plan:
        settings = self._settings
        is_json = settings.profile == "json"
        message = lossless.design(form, topic, set() if is_json else taken_types, is_json=is_json)
        called = names.topic(topic, taken_topics)
        taken_topics.add(called)
        wanted = self._wanted(topic, message, called, taken_topics) if "std" in settings.profile else []
        about = {} if is_json else self._about(topic, wanted)  # one type of JSON for all topics
        message = Message(message.name, message.fields, message.is_stated, True, about)
        own = None
        if settings.profile != "std":
            type_ = f"{settings.package}/msg/{message.name}"
            text = msg.embedded(message, settings.package, is_ros1=settings.is_ros1)
            digest = stores.digest(type_, text, is_ros1=settings.is_ros1)
            struct = lossless.struct(message, settings.package, is_ros1=settings.is_ros1)
            own = self._outlet(called, type_, text, digest, struct)
        derived = [(one, self._standard(one)) for one in wanted]
        if own is None and not derived and form.count:
            self._warn(f"topic {topic!r}: no standard message says what its fields hold; profile='std' leaves it out")
        return Plan(topic, message, own, tuple(derived))

    def _about(self, topic: str, wanted: list[Derived]) -> dict[str, Any]:
        """Return what a message's definition says besides its fields, in bags that have no other place for it too."""
        info = self._job.topics[topic]
        said: dict[str, Any] = {"topic": topic}
        if info.description is not None:
            said["description"] = info.description
        if info.tags:
            said["tags"] = list(info.tags)
        if info.metadata:
            said["metadata"] = dict(info.metadata)
        if wanted:
            said["derived"] = [one.topic for one in wanted]
        return said

    def _wanted(self, topic: str, message: Message, called: str, taken: set[str]) -> list[Derived]:
        settings = self._settings
        mapping = (settings.mapping or {}).get(topic, {})
        if mapping is None or mapping is False:
            return []
        said = {"frame_id": settings.frame_id, **self._metadata[topic]}
        try:
            wanted = standard.derive(message, called, said, mapping, tf=settings.tf)
        except ConversionError as error:
            raise ConversionError(f"topic {topic!r}: {error}") from error
        found = []
        for one in wanted:
            why = messages.check(one)
            if why is not None and settings.on_bad == "raise":
                raise ConversionError(f"topic {topic!r}: {why}; or pass on_bad='lossless' to leave out {one.topic}")
            if why is not None or (one.topic in taken and one.type != standard.TF):
                self._warn(f"topic {topic!r}: {one.topic} is left out: {why or 'another topic has that name'}")
                continue
            taken.add(one.topic)
            found.append(one)
        return found

    def _standard(self, one: Derived) -> Outlet:
        """Return the outlet of a standard message; `/tf` is everybody's."""
        for other in self._outlets:
            if other.topic == one.topic:
                return other
        text, digest = stores.definition(one.type, is_ros1=self._settings.is_ros1)
        struct = stores.struct(one.type, is_ros1=self._settings.is_ros1)
        return self._outlet(one.topic, one.type, text, digest, struct)

    def _outlet(self, topic: str, type_: str, text: str, digest: str, struct: Struct) -> Outlet:
        outlet = Outlet(len(self._outlets) + 1, topic, type_, text, digest, struct)
        self._outlets.append(outlet)
        return outlet

    # -- rows to messages ----------------------------------------------------------------------------------------------

    def _convert(self, plan: Plan, part: Part, before: int) -> list[Sent]:
        settings = self._settings
        count = exact.size(part)
        times = _times(part)
        stamps = self._stamps(plan, times, before)
        is_row_text = plan.message.fields and plan.message.fields[0].key == lossless.ROW_KEY
        if isinstance(part, Block):
            column = fill(plan.message, blocks.to_rows(part)) if is_row_text else blocks.fill_block(plan.message, part)
        else:
            column = fill(plan.message, part)
        frame = str(self._metadata[plan.topic].get("frame_id", settings.frame_id))
        header = _header(stamps, frame, before)
        sent = []
        if plan.own is not None:
            whole = {"header": header, "ts": times, **column}
            packed = pack(plan.own.struct, whole, count, is_ros1=settings.is_ros1, room=settings.room)
            sent.append(Sent(plan.own, stamps, packed))
        for derived, outlet in plan.derived:
            rows = messages.present(plan.message, column, derived, count)
            rows, built = self._built(plan, derived, column, rows, times, header, before)
            if len(rows):
                packed = pack(outlet.struct, built, len(rows), is_ros1=settings.is_ros1, room=settings.room)
                sent.append(Sent(outlet, stamps[rows], packed))
        return sent

    def _built(
        self, plan: Plan, derived: Derived, column: Any, rows: Indices, times: Any, header: Any, before: int
    ) -> tuple[Indices, dict[str, Any]]:
        """Return the columns of a standard message and the rows that they are of."""
        header = {**header, "frame_id": Constant(str(derived.metadata.get("frame_id", "")))}
        while len(rows):
            found = messages.build(derived, column, rows, times, pick(header, rows))
            if not isinstance(found, messages.BadRows):
                return rows, found
            row = int(rows[int(np.argmax(found.which))])
            where = f"topic {plan.topic!r}, row {before + row} (_ts={float(times[row])!r})"
            if self._settings.on_bad == "raise" and (derived.is_asked or not found.is_other):
                raise ConversionError(
                    f"{where}: {found.what}, so {derived.topic} cannot be written; pass on_bad='lossless' to leave such"
                    f" rows out of it, mapping={{{plan.topic!r}: {{{_suffix(plan, derived)!r}: None}}}} to leave it"
                    " out, or profile='lossless'"
                )
            self._warn(f"topic {plan.topic!r}: {derived.topic} lacks rows that it cannot say", f"{where}: {found.what}")
            rows = rows[~found.which]
        return rows, {}

    def _stamps(self, plan: Plan, times: npt.NDArray[np.float64], before: int) -> npt.NDArray[np.uint64]:
        stamps = clock.to_nanoseconds_each(times).astype(np.int64) + round(self._settings.time_offset * clock.NS_PER_S)
        bad = (stamps < 0) | (stamps >= _END_S * clock.NS_PER_S)
        if bad.any():
            row = int(np.argmax(bad))
            raise ConversionError(
                f"topic {plan.topic!r}, row {before + row} (_ts={float(times[row])!r}): a bag's times lie between 0 and"
                f" {_END_S} s (1970 to 2038), and with time_offset={self._settings.time_offset!r} this one does not;"
                " pass another"
            )
        return stamps.astype(np.uint64)

    def _warn(self, what: str, first: str = "") -> None:
        if what not in self._warned:
            self._warned.add(what)
            warnings.warn(f"{what}; the first: {first}" if first else what, ConversionWarning, stacklevel=2)


def _suffix(plan: Plan, derived: Derived) -> str:
    base = (plan.own.topic if plan.own is not None else names.topic(plan.topic)) + "/"
    return derived.topic.removeprefix(base)


def _metadata(job: Job, topic: str) -> dict[str, Any]:
    return dict(job.topics[topic].metadata)


def _take_in(form: Form, part: Part) -> Form:
    if isinstance(part, list):
        return forms.of_rows(part, form)
    blocks.take_in(form, part)
    return form


def _times(part: Part) -> npt.NDArray[np.float64]:
    if isinstance(part, list):
        return np.array([row[TIME_KEY] for row in part], np.float64)
    found: npt.NDArray[np.float64] = part.columns[TIME_KEY].array.to_numpy(zero_copy_only=False)
    return found


_Waiting = tuple[float, int, Part, Iterator[Part]]


def _push(waiting: list[_Waiting], number: int, part: Part | None, parts: Iterator[Part]) -> None:
    if part is not None:
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


def _header(stamps: npt.NDArray[np.uint64], frame: str, before: int) -> dict[str, Any]:
    sec, nanosec = np.divmod(stamps, np.uint64(clock.NS_PER_S))
    return {
        "seq": np.arange(before, before + len(stamps), dtype=np.int64).astype(np.uint32),
        "stamp": {"sec": sec.astype(np.int32), "nanosec": nanosec.astype(np.uint32)},
        "frame_id": Constant(frame),
    }


def to_text(about: Mapping[str, Any]) -> str:
    """Say what the way back wants to know as JSON."""
    return json.dumps(about)


def write_package(folder: Path, outgoing: Outgoing) -> None:
    """Write the interface package of a bag's messages that say all, if there are any."""
    messages = outgoing.own_messages
    for path, text in interfaces.files(messages, folder.name).items() if messages else ():
        place = folder / path
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(text, encoding="utf-8")


__all__ = ["MisfitError", "Outgoing", "Outlet", "Sent", "Settings", "to_text", "write_package"]
