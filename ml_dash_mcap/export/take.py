"""A take: what motion capture files hold of a recording, on one clock, window by window."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ..errors import ConversionError, ConversionWarning
from ..mocap import objects, quaternions, resample, space
from ..mocap.frames import longest_gap_s
from ..mocap.objects import Body, Joint, Marker, Objects, Source
from ..read.topics import TopicInfo
from .clocks import Clock, Rate
from .job import Counter, Job
from .mocap_options import check
from .samples import Samples

Floats = npt.NDArray[np.float64]
Thing = Body | Marker | Joint

WIDTHS: Mapping[type, int] = {Body: 8, Marker: 3, Joint: 1}
"""How many columns an object has: of a body x y z w, x y z, error."""

_WINDOW = 4096
_IDENTITY_FIRST = 0.999
_NEAR_S = 1e-5
"""A row's double and its log time are closer than this."""


@dataclass(frozen=True, slots=True)
class TakeOptions:
    """What the formats of motion capture have in common."""

    rate: Rate = None
    up: str | None = None
    canonical: bool = True
    quat_order: str | None = None
    on_bad: Literal["raise", "missing"] = "raise"

    def __post_init__(self) -> None:
        if self.up is not None:
            check("up", self.up, space.UPS)
        check("on_bad", self.on_bad, ("raise", "missing"))
        if self.quat_order is not None:
            check("quat_order", self.quat_order, tuple(quaternions.ORDERS))


@dataclass(frozen=True, slots=True)
class Window:
    """Some frames of a take."""

    frames: npt.NDArray[np.int64]
    """Their numbers, [N], from 0."""
    times: Floats
    """From the take's origin, [N], s."""
    values: Floats
    """[N, C], NaN where something is missing; `Take.columns` says which column is what."""
    is_row: npt.NDArray[np.bool_]
    """Which of them has a row in any topic, [N]."""


@dataclass
class Take:
    """What is to be written, and on which clock."""

    job: Job
    options: TakeOptions
    things: list[Thing]
    """In the order of their columns."""
    clock: Clock
    bad: int = field(default=0, init=False)
    """How many values were left out because they are no rotations."""

    def columns(self) -> list[tuple[Thing, int]]:
        """Return each object with its first column."""
        widths = [WIDTHS[type(thing)] for thing in self.things]
        return list(zip(self.things, np.cumsum([0, *widths]).tolist(), strict=False))

    def unit_of(self, thing: Thing) -> str:
        """Return the unit of an object's lengths, in which its values stand."""
        source = thing.value if isinstance(thing, Joint) else thing.position
        return space.unit_of(self.job.topics[thing.topic].metadata, source.columns[0])

    def windows(self) -> Iterator[Window]:
        """Yield all frames, some thousand at a time.

        Raises:
            ConversionError: A quaternion or matrix is no rotation, or a field changes its size.
        """
        counter = self.job.counter()
        topics = {topic: _Topic(self, topic, counter) for topic in dict.fromkeys(one.topic for one in self.things)}
        width = sum(WIDTHS[type(thing)] for thing in self.things)
        for first in range(0, self.clock.count, _WINDOW):
            part = self.clock.part(first, min(first + _WINDOW, self.clock.count))
            values = np.full((len(part.frames), width), np.nan)
            is_row = np.zeros(len(part.frames), np.bool_)
            for topic in topics.values():
                is_row |= topic.fill(values, part.times, first)
            yield Window(part.frames, part.times - self.clock.origin, values, is_row)
        counter.finish()
        if self.bad:
            warnings.warn(f"{self.bad} values that are no rotations were left out", ConversionWarning, stacklevel=2)


class _Topic:
    """One topic's part in a take."""

    def __init__(self, take: Take, topic: str, counter: Counter) -> None:
        self._take = take
        self._name = topic
        self._options = take.options
        metadata = take.job.topics[topic].metadata
        self._up = up_of(metadata)
        self._to = take.options.up or self._up
        self._metadata = metadata
        self._things = [(thing, at) for thing, at in take.columns() if thing.topic == topic]
        sources = [source for thing, _ in self._things for source in _sources(thing)]
        self._samples = Samples(take.job.selection(topic), sources, counter)
        self._last: dict[int, Floats | None] = {}
        self._is_first = True

    def fill(self, values: Floats, times: Floats, first: int) -> npt.NDArray[np.bool_]:
        """Put this topic's numbers, and its rows' exact times, into a window.

        Returns:
            Which of the window's frames have a row of it.
        """
        clock = self._take.clock
        gap = longest_gap_s(clock.medians_ns[self._name]) if clock.is_resampled else _NEAR_S
        found_times, found = self._samples.between(float(times[0]) - gap, float(times[-1]) + gap)
        if clock.is_resampled:
            rows = np.arange(len(times))
        else:
            frames = clock.frames_of(found_times, self._name)
            inside = (frames >= first) & (frames < first + len(times))
            rows, found_times, found = frames[inside] - first, found_times[inside], found[inside]
            times[rows] = found_times
        for thing, at in self._things:
            for source, offset, how in _parts(thing):
                numbers = found[:, self._samples.places(source)]
                numbers = self._prepared(thing, source, how, numbers, found_times)
                if how == "matrix":
                    parts: list[tuple[Floats, int, resample.How]] = [
                        (numbers[:, :4], 0, "slerp"),
                        (numbers[:, 4:], 4, "linear"),
                    ]
                else:
                    parts = [(numbers, offset, "slerp" if how == "slerp" else "linear")]
                for part, column, kind in parts:
                    if clock.is_resampled:
                        part = resample.at(found_times, part, times, gap, kind)
                    if kind == "slerp" and self._options.canonical:
                        part, self._last[at] = quaternions.continuous(part, self._last.get(at))
                    values[rows, at + column : at + column + part.shape[1]] = part
        is_row = np.zeros(len(times), np.bool_)
        is_row[rows] = True
        return is_row

    def _prepared(self, thing: Thing, source: Source, how: str, numbers: Floats, times: Floats) -> Floats:
        """Return numbers turned to the axes of the file; rotations as x y z w of length 1."""
        if how == "number":
            return numbers
        if how == "matrix":
            matrices = numbers.reshape(-1, 4, 4)
            rotations, bad = quaternions.of_matrices(matrices[:, :3, :3])
            self._judge(bad, numbers, thing, source, times)
            points = space.turned(matrices[:, :3, 3], self._up, self._to)
            both = np.concatenate((space.turned_rotations(rotations, self._up, self._to), points), axis=1)
            both[bad] = np.nan
            return both
        if how == "slerp":
            assert isinstance(thing, Body)
            bad = quaternions.bad(numbers)
            self._judge(bad, numbers, thing, source, times)
            self._suspect(thing, numbers)
            found = quaternions.normalised(quaternions.reorder(numbers, thing.order))
            found[bad] = np.nan
            return space.turned_rotations(found, self._up, self._to)
        return space.turned(numbers, self._up, self._to) if how == "point" else numbers

    def _judge(self, bad: npt.NDArray[np.bool_], numbers: Floats, thing: Thing, source: Source, times: Floats) -> None:
        """Raise, or count, what is no rotation."""
        if not bad.any():
            return
        if self._options.on_bad == "missing":
            self._take.bad += int(bad.sum())
            return
        row = int(bad.argmax())
        what = (
            "is no rotation" if len(numbers[row]) == 16 else f"has the length {np.linalg.norm(numbers[row]):.6g}, not 1"
        )
        raise ConversionError(
            f"topic {thing.topic!r}, field {source.columns[0]!r}, _ts={float(times[row])!r}:"
            f" {numbers[row].tolist()} {what}; pass on_bad='missing' to leave such values out"
        )

    def _suspect(self, thing: Body, numbers: Floats) -> None:
        """Warn if nobody said what a quaternion's order is and its first value looks like the other one."""
        if not self._is_first or not len(numbers):
            return
        self._is_first = False
        is_said = self._options.quat_order or self._metadata.get("quat_order")
        is_dict = thing.rotation is None or not thing.rotation.shape  # whose keys say what is what
        if not is_said and not is_dict and abs(numbers[0, 0]) > _IDENTITY_FIRST:
            warnings.warn(
                f"topic {thing.topic!r}: its quaternions start with {numbers[0].tolist()}, which looks like w x y z;"
                " they are taken as x y z w. Pass quat_order='wxyz' or 'xyzw', or say it in the topic's metadata",
                ConversionWarning,
                stacklevel=2,
            )


def _sources(thing: Thing) -> list[Source]:
    return [source for source, _, _ in _parts(thing)]


def _parts(thing: Thing) -> list[tuple[Source, int, str]]:
    """Return an object's sources, each with its first column among the object's and what kind of numbers it has."""
    if isinstance(thing, Joint):
        return [(thing.value, 0, "number")]
    if isinstance(thing, Marker):
        return [(thing.position, 0, "point")]
    error = [] if thing.error is None else [(thing.error, 7, "length")]
    if thing.rotation is None:
        return [(thing.position, 0, "matrix"), *error]
    return [(thing.rotation, 0, "slerp"), (thing.position, 4, "point"), *error]


def up_of(metadata: Mapping[str, Any]) -> str:
    """Return which axis points up as a topic's metadata says it; "z" if it does not.

    Raises:
        ConversionError: It says one that is not known.
    """
    up = str(metadata.get("up", "z")).lower()
    if up not in space.UPS:
        raise ConversionError(f"the topic's metadata says up={metadata['up']!r}; 'z' and 'y' are known")
    return up


def found_in(job: Job, quat_order: str | None) -> dict[str, Objects]:
    """Return the objects of each topic of a job, also of those that have none."""
    found: dict[str, Objects] = {}
    for topic, info in job.topics.items():
        if info.metadata.get("quat_order") not in (None, *quaternions.ORDERS):
            raise ConversionError(
                f"topic {topic!r}: its metadata says quat_order={info.metadata['quat_order']!r}; 'xyzw' and 'wxyz' are"
                " known. Pass quat_order="
            )
        found[topic] = objects.find(topic, numeric(info), info.metadata, quat_order)
    return found


def numeric(info: TopicInfo) -> dict[objects.Path, tuple[int, ...]]:
    """Return the fields of a topic that are numbers, by their keys, with their shapes."""
    found: dict[objects.Path, tuple[int, ...]] = {}
    for name, one in info.fields.items():
        shape = tuple(length for length in one.shape if length is not None)
        path = _path(name, info.schema)
        if one.type in ("number", "integer") and len(shape) == len(one.shape):
            found[path] = shape
        elif one.shape == (None,) and (expected := objects.expected(path)) is not None:
            found[path] = expected  # reading finds the row that differs
    return found


def _path(name: str, schema: Mapping[str, Any]) -> objects.Path:
    """Return the keys of a dotted name: a schema tells a dot inside a key from one between two."""
    properties = schema.get("properties", {})
    if name in properties or "." not in name:
        return (name,)
    for key, inner in properties.items():
        if name.startswith(f"{key}.") and isinstance(inner, dict):
            return (key, *_path(name[len(key) + 1 :], inner))
    return tuple(name.split("."))
