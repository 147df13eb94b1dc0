"""Prepares the samples of one topic and puts them into the frames of a take."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ...errors import ConversionError, ConversionWarning
from ...meaning import rotations, space
from ...meaning.mocap_objects import Body, Joint, Marker, NumberSource
from ...query.topic_part import TopicPart
from ..export_job import RowCounter
from . import resample
from .frame_numbers import longest_gap_s
from .samples import Samples
from .take_clock import Clock
from .take_options import TakeOptions

Floats = npt.NDArray[np.float64]
Thing = Body | Marker | Joint

# A recording often starts near the identity, whose number of size 1 is w; at the first place it suggests w x y z.
_IDENTITY_FIRST = 0.999
_NEAR_S = 1e-5
"""A row's double and its log time are closer than this."""


class TopicFrames:
    """Fills in what one topic has of a take's columns, window by window."""

    def __init__(
        self,
        part: TopicPart,
        metadata: Mapping[str, Any],
        things: Sequence[tuple[Thing, int]],
        clock: Clock,
        options: TakeOptions,
        counter: RowCounter,
        *,
        held: Collection[str] = (),
    ) -> None:
        """Begin to read a topic.

        Args:
            part: Its rows.
            metadata: Of the topic.
            things: Its objects, each with its first column in the take.
            clock: Of the take.
            options: Of the take.
            counter: Told how many rows were read.
            held: Dotted names of fields whose numbers are held where others are interpolated.
        """
        self.bad = 0
        """The number of values that were left out because they are no rotations."""
        self._name = part.topic
        self._clock = clock
        self._options = options
        self._metadata = metadata
        self._up = space.up_of(metadata)
        self._to = options.up or self._up
        self._samples = Samples(part, [source for thing, _ in things for source, _, _ in parts_of(thing)], counter)
        copied: list[tuple[int, int]] = []
        self._others: list[tuple[Thing, int, NumberSource, int, str]] = []
        for thing, at in things:
            for source, offset, how in parts_of(thing):
                places = self._samples.places(source)
                if how == "number" and source.columns[0] in held:
                    how = "held"
                is_same = how in ("number", "held", "length") or (how == "point" and self._up == self._to)
                if is_same and not clock.is_resampled:
                    copied += zip(places, range(at + offset, at + offset + len(places)), strict=True)
                else:
                    self._others.append((thing, at, source, offset, how))
        self._copied = _runs(copied)
        """Columns that only have to be copied: from, to."""
        self._last: dict[int, Floats | None] = {}
        self._is_first = True

    def fill(self, values: Floats, times: Floats, first: int) -> None:
        """Put the topic's numbers, and its rows' exact times, into a window.

        Args:
            values: Of the window, [N, C].
            times: Of its frames, [N], s, as `_ts`.
            first: The number of its first frame.
        """
        clock = self._clock
        gap = longest_gap_s(clock.medians_ns[self._name]) if clock.is_resampled else _NEAR_S
        found_times, numbers_read = self._samples.between(float(times[0]) - gap, float(times[-1]) + gap)
        rows: Any = slice(None)
        if not clock.is_resampled:
            frames = clock.frames_of(found_times, self._name)
            low, high = np.searchsorted(frames, (first, first + len(times)))
            rows, found_times, numbers_read = (
                _as_slice(frames[low:high] - first),
                found_times[low:high],
                numbers_read[low:high],
            )
            times[rows] = found_times
        for source_columns, columns in self._copied:
            # Columns side by side are copied as slices in one step; that holds for most columns of most takes.
            values[rows, columns] = numbers_read[:, source_columns]
        for thing, at, source, offset, how in self._others:
            numbers = self._prepared(thing, source, how, numbers_read[:, self._samples.places(source)], found_times)
            for part, column, kind in _split(numbers, offset, how):
                placed = resample.at(found_times, part, times, gap, kind) if clock.is_resampled else part
                if kind == "slerp" and self._options.canonical:
                    # Windows are filled one by one, so the sign of the last quaternion is carried into the next
                    # window.
                    placed, self._last[at] = rotations.continuous(placed, self._last.get(at))
                values[rows, at + column : at + column + placed.shape[1]] = placed

    def _prepared(self, thing: Thing, source: NumberSource, how: str, numbers: Floats, times: Floats) -> Floats:
        """Return numbers turned to the axes of the file; rotations as x y z w of length 1."""
        if how in ("number", "held"):
            return numbers
        if how == "matrix":
            matrices = numbers.reshape(-1, 4, 4)
            turns, bad = rotations.of_matrices(matrices[:, :3, :3])
            self._judge(bad, numbers, thing, source, times)
            points = space.turned(matrices[:, :3, 3], self._up, self._to)
            both = np.concatenate((space.turned_rotations(turns, self._up, self._to), points), axis=1)
            both[bad] = np.nan
            return both
        if how == "slerp":
            assert isinstance(thing, Body)
            bad = rotations.not_unit(numbers)
            self._judge(bad, numbers, thing, source, times)
            self._suspect(thing, numbers)
            quaternions = rotations.normalised(rotations.to_xyzw(numbers, thing.order))
            quaternions[bad] = np.nan
            return space.turned_rotations(quaternions, self._up, self._to)
        return space.turned(numbers, self._up, self._to) if how == "point" else numbers

    def _judge(
        self, bad: npt.NDArray[np.bool_], numbers: Floats, thing: Thing, source: NumberSource, times: Floats
    ) -> None:
        """Raise an error for values that are no rotations, or count them."""
        if not bad.any():
            return
        if self._options.on_bad == "missing":
            self.bad += int(bad.sum())
            return
        row = int(bad.argmax())
        problem = (
            "is no rotation" if len(numbers[row]) == 16 else f"has the length {np.linalg.norm(numbers[row]):.6g}, not 1"
        )
        raise ConversionError(
            f"topic {thing.topic!r}, field {source.columns[0]!r}, _ts={float(times[row])!r}:"
            f" {numbers[row].tolist()} {problem}; pass on_bad='missing' to leave such values out"
        )

    def _suspect(self, thing: Body, numbers: Floats) -> None:
        """Warn if a quaternion's order is not stated and its first value looks like the other order."""
        if not self._is_first or not len(numbers):
            return
        self._is_first = False
        is_stated = self._options.quat_order or self._metadata.get("quat_order")
        is_dict = thing.rotation is None or not thing.rotation.shape  # its keys name the numbers
        if not is_stated and not is_dict and abs(numbers[0, 0]) > _IDENTITY_FIRST:
            warnings.warn(
                f"topic {thing.topic!r}: its quaternions start with {numbers[0].tolist()}, which looks like w x y z;"
                " they are taken as x y z w. Pass quat_order='wxyz' or 'xyzw', or say it in the topic's metadata",
                ConversionWarning,
                stacklevel=2,
            )


def _runs(pairs: Sequence[tuple[int, int]]) -> list[tuple[slice, slice]]:
    """Join pairs of columns that lie side by side on both sides."""
    runs: list[tuple[slice, slice]] = []
    for place, column in pairs:
        if runs and (runs[-1][0].stop, runs[-1][1].stop) == (place, column):
            runs[-1] = slice(runs[-1][0].start, place + 1), slice(runs[-1][1].start, column + 1)
        else:
            runs.append((slice(place, place + 1), slice(column, column + 1)))
    return runs


def _as_slice(numbers: npt.NDArray[np.int64]) -> Any:
    """Return ascending, distinct numbers as a slice if none is left out between them, which numpy copies faster."""
    if len(numbers) and numbers[-1] - numbers[0] == len(numbers) - 1:
        return slice(int(numbers[0]), int(numbers[-1]) + 1)
    return numbers


def _split(numbers: Floats, offset: int, how: str) -> list[tuple[Floats, int, resample.How]]:
    """Return numbers by how they are resampled, each with its first column among its object's."""
    if how == "matrix":
        return [(numbers[:, :4], 0, "slerp"), (numbers[:, 4:], 4, "linear")]
    kinds: dict[str, resample.How] = {"slerp": "slerp", "held": "hold"}
    return [(numbers, offset, kinds.get(how, "linear"))]


def parts_of(thing: Thing) -> list[tuple[NumberSource, int, str]]:
    """Return an object's sources, each with its first column among the object's and what kind of numbers it has."""
    if isinstance(thing, Joint):
        return [(thing.value, 0, "number")]
    if isinstance(thing, Marker):
        return [(thing.position, 0, "point")]
    error = [] if thing.error is None else [(thing.error, 7, "length")]
    if thing.rotation is None:
        return [(thing.position, 0, "matrix"), *error]
    return [(thing.rotation, 0, "slerp"), (thing.position, 4, "point"), *error]
