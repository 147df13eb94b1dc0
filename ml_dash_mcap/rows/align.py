"""Brings the tables of several topics onto one clock, as one table."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import orjson
import pyarrow as pa
import pyarrow.compute as pc

from ..errors import AlignmentError
from . import interpolate, numpy_columns, typed_columns
from .align_methods import LINEAR, NEAREST, PREVIOUS, SLERP, Choice, Methods
from .dotted import free_name
from .plain_row import TIME_KEY
from .typed_columns import ENCODING_KEY

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Places = npt.NDArray[np.intp]

# 4 GiB of doubles.
_LONGEST_GRID = 2**29


def grid(start: float, end: float, hz: float) -> Floats:
    """Return times at a constant rate: `start + i / hz` up to `end`, which is the last one where it falls on the grid.

    Args:
        start: First time, in s.
        end: Last time, included, in s; before `start`, there are no times.
        hz: Times a second.

    Raises:
        AlignmentError: The rate is not a number above 0, or there would be too many times.
    """
    if not (math.isfinite(hz) and hz > 0):
        raise AlignmentError(f"hz={hz!r}: a rate is a number above 0")
    if not start <= end:
        return np.empty(0)
    steps = (end - start) * hz
    if steps > _LONGEST_GRID:
        raise AlignmentError(f"hz={hz!r} from {start!r} to {end!r} s makes {steps:.3g} times; set start= and end=")
    # One more than there are steps, and one in case the product was rounded down; what lies beyond the end is cut off.
    times: Floats = start + np.arange(math.floor(steps) + 2) / hz
    times = times[times <= end + 2 * np.spacing(abs(end))]
    return np.minimum(times, end)  # rounding may have led a little beyond


def align(
    times: Floats,
    tables: Mapping[str, pa.Table],
    methods: Methods,
    *,
    tolerance_s: float = math.inf,
    own: str | None = None,
) -> pa.Table:
    """Return one table: the times as `_ts`, and a column `topic.field` for each field of each table.

    A table's rows are the samples; of several rows of one time the last one counts. A field that the row
    lacks is missing there: no method looks past it.

    - previous: the last row at or before a time, not older than the tolerance;
    - nearest: the nearest row, the earlier one of two, not farther than the tolerance;
    - linear: on the line between the rows on both sides, which are not farther from each other than the tolerance;
      element by element for vectors and matrices. Integers become doubles. What is no number (text, booleans, bytes,
      lists of various lengths) takes the previous value, unless its column was named;
    - slerp: the same on the shortest arc, for quaternions.

    Args:
        times: [N], in s, in order.
        tables: Of topics, as `TopicReader.to_arrow` gives them: `_ts` first, in time order.
        methods: Of the columns.
        tolerance_s: In s; differences are compared to within the precision of the doubles.
        own: The topic whose rows the times are, if any; its columns stay as they are.

    Raises:
        AlignmentError: A named column has values for which its method is not made, or slerp others than 4-vectors.
    """
    columns: dict[str, Any] = {}
    fields = [pa.field(TIME_KEY, pa.float64(), nullable=False)]
    for topic, table in tables.items():
        near = None if topic == own else _Near.of(times, _times_of(table), tolerance_s)
        for field, column in zip(list(table.schema)[1:], table.columns[1:], strict=True):
            name = free_name(f"{topic}.{field.name}", columns)
            choice = methods.of(topic, field.name)
            aligned, is_same_kind = _apply(near, column, choice, name, is_text=ENCODING_KEY in (field.metadata or {}))
            columns[name] = aligned
            fields.append(pa.field(name, aligned.type, metadata=field.metadata if is_same_kind else None))
    about = {"ml_dash": orjson.dumps({"time": TIME_KEY, "topics": list(tables)})}
    return pa.table([pa.array(times), *columns.values()], schema=pa.schema(fields, metadata=about))


def _times_of(table: pa.Table) -> Floats:
    times: Floats = table.column(0).to_numpy()
    return times


@dataclass(frozen=True, slots=True)
class _Near:
    """Which rows of a topic lie around each time."""

    before: Places
    """The last row at or before each time, [N]; any row where there is none."""
    after: Places
    """The first row at or after it, [N]."""
    age: Floats
    """From the row before to the time, [N], in s; infinite where there is none."""
    wait: Floats
    """From the time to the row after, [N], in s."""
    tolerance_s: float

    @staticmethod
    def of(times: Floats, rows: Floats, tolerance_s: float) -> _Near:
        count = len(rows)
        last = np.searchsorted(rows, times, side="right") - 1
        has_last = last >= 0
        before = np.maximum(last, 0)
        # So that a time behind the last row has a row after it, infinitely late.
        padded = np.append(rows, math.inf)
        is_hit = has_last & (padded[before] == times)
        following = np.where(is_hit, last, last + 1)
        after = np.searchsorted(rows, padded[following], side="right") - 1  # the last one of that time
        latest = max(abs(float(times[-1])), abs(float(rows[-1]))) if len(times) and count else 0.0
        return _Near(
            before=before,
            after=np.clip(after, 0, max(count - 1, 0)),
            age=np.where(has_last, times - padded[before], math.inf),
            wait=padded[following] - times,
            tolerance_s=tolerance_s + 2 * float(np.spacing(latest)),
        )

    def at(self, method: str) -> tuple[Places, Flags]:
        """Return the row to take for each time, and whether there is one."""
        if method == NEAREST:
            distance = np.minimum(self.age, self.wait)
            which = np.where(self.wait < self.age, self.after, self.before)
        else:
            distance, which = self.age, self.before
        return which, np.isfinite(distance) & (distance <= self.tolerance_s)

    def between(self) -> tuple[Floats, Flags]:
        """Return how far on the way from the row before to that after each time lies, and whether there are both."""
        distance = self.age + self.wait
        usable = np.isfinite(distance) & (distance <= self.tolerance_s)
        is_inside = usable & (distance > 0)
        return np.where(is_inside, self.age, 0) / np.where(is_inside, distance, 1), usable


def _apply(near: _Near | None, column: Any, choice: Choice, name: str, *, is_text: bool) -> tuple[Any, bool]:
    """Return a column at the times, and whether its values are of the same kind as before."""
    method = choice.method
    numbers = _Numbers.of(column) if method in (LINEAR, SLERP) and not is_text else None
    if method in (LINEAR, SLERP) and not pa.types.is_null(column.type):
        if numbers is None and (choice.is_explicit or method == SLERP):
            raise AlignmentError(
                f"{name!r} holds {_described(column, is_text)}, for which there is no {method!r}; {_HINT}"
            )
        if numbers is not None and method == SLERP and numbers.shape != (4,):
            raise AlignmentError(f"{name!r} holds {_described(column, is_text)}; 'slerp' is for 4-vectors; {_HINT}")
    if near is None:
        return column, True
    if numbers is None:
        return _take(column, *near.at(PREVIOUS if method in (LINEAR, SLERP) else method)), True
    return numbers.between(near, interpolate.slerp if method == SLERP else interpolate.linear), False


_HINT = 'say how={"topic.field": "previous", ...} for it'


def _described(column: Any, is_text: bool) -> str:
    return "values of various types" if is_text else f"values of type {column.type}"


def _take(column: Any, which: Places, usable: Flags) -> Any:
    """Return some of a column's values, null where none is usable."""
    if not len(column):
        return pa.chunked_array([pa.nulls(len(which), column.type)])
    if usable.all():
        return column.take(pa.array(which))
    if pa.types.is_fixed_size_list(column.type):  # pyarrow before 26 cannot read nulls among those
        column = column.cast(pa.list_(column.type.value_type))
    return column.take(pa.array(which, mask=~usable))


@dataclass(frozen=True, slots=True)
class _Numbers:
    """A column of numbers, of vectors of one length, or of matrices of one shape."""

    shape: tuple[int, ...]
    """Of each value."""
    values: Floats
    """[N, *shape]; NaN where there is none."""
    present: Flags
    """Which rows have a value, [N]."""
    is_known: Flags
    """Which elements are a number and not None, [N, *shape]."""

    @staticmethod
    def of(column: Any) -> _Numbers | None:
        """Return a column as numbers; None if it holds something else."""
        array = typed_columns.whole(column)
        shape, leaf = numpy_columns.common_shape(array)
        if shape is None or 0 in shape or not (pa.types.is_integer(leaf.type) or pa.types.is_floating(leaf.type)):
            return None
        present = pc.is_valid(array).to_numpy(zero_copy_only=False)
        flat = leaf.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
        is_number = pc.is_valid(leaf).to_numpy(zero_copy_only=False)
        values, is_known = np.full((len(array), *shape), math.nan), np.zeros((len(array), *shape), np.bool_)
        which = slice(None) if not shape else present  # an inner array is only as long as there are lists
        values[which] = flat.reshape(-1, *shape)
        is_known[which] = is_number.reshape(-1, *shape)
        return _Numbers(shape, values, present, is_known)

    def between(self, near: _Near, method: Callable[[Floats, Floats, Floats], Floats]) -> Any:
        """Return the values at the times between the rows on both sides."""
        weight, usable = near.between()
        if not len(self.values):
            nothing = np.empty((0, *self.shape))
            return _to_arrow(nothing, usable, nothing.astype(np.bool_))
        before, after = near.before, near.after
        usable &= self.present[before] & self.present[after]
        before, after = before[usable], after[usable]
        values = method(self.values[before], self.values[after], weight[usable])
        is_number = self.is_known[before] & self.is_known[after]
        if method is interpolate.slerp:  # all four elements, or none
            usable[usable] = has_direction = is_number.all(axis=1) & ~np.isnan(values).any(axis=1)
            values, is_number = values[has_direction], is_number[has_direction]
        return _to_arrow(values, usable, is_number)


def _to_arrow(rows: Floats, usable: Flags, is_number: Flags) -> Any:
    """Return the values of the usable rows as a column, null in all other rows."""
    shape = rows.shape[1:]
    if not shape:
        values = np.zeros(len(usable))
        values[usable] = rows
        usable = usable.copy()
        usable[usable] = is_number
        return pa.chunked_array([pa.array(values, mask=~usable)])
    array = pa.array(rows.reshape(-1), mask=None if is_number.all() else ~is_number.reshape(-1))
    # From the innermost dimension outwards. The outermost one is added below, where rows may be missing.
    for size in shape[:0:-1]:
        array = pa.FixedSizeListArray.from_arrays(array, size)
    if usable.all() and len(shape) == 1:
        return pa.chunked_array([pa.FixedSizeListArray.from_arrays(array, shape[0])])
    ends = np.cumsum(usable * shape[0])
    offsets = pa.array(np.concatenate(([0], ends)).astype(np.int32))
    mask = None if usable.all() else pa.array(~usable)
    return pa.chunked_array([pa.ListArray.from_arrays(offsets, array, mask=mask)])
