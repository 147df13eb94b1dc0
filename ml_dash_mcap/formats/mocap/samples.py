"""Reads a topic's numbers, time range by time range, as one matrix of doubles."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from ...errors import ConversionError
from ...meaning.mocap_objects import NumberSource
from ...query.topic_part import TopicPart
from ...rows import numpy_columns
from ...rows.arrow_types import is_list
from ...rows.plain_row import TIME_KEY
from ...rows.table import to_table
from ...rows.typed_columns import values_of
from ..export_job import RowCounter

if TYPE_CHECKING:
    from ...rows.table import Block

Floats = npt.NDArray[np.float64]


class Samples:
    """Reads a topic once, from its first row to its last; memory holds the rows of the last request."""

    def __init__(self, part: TopicPart, sources: Sequence[NumberSource], counter: RowCounter) -> None:
        self._topic = part.topic
        self._shapes = {column: source.shape for source in sources for column in source.columns}
        self._at: dict[str, int] = {}
        width = 0
        for column, shape in self._shapes.items():
            self._at[column] = width
            width += math.prod(shape)
        self._blocks = replace(part, columns=[*self._shapes]).blocks()
        self._counter = counter
        self._times: Floats = np.empty(0)
        self._values: Floats = np.empty((0, width))
        self._is_over = False

    def places(self, source: NumberSource) -> list[int]:
        """Return in which columns of the matrix a source's numbers stand."""
        size = math.prod(source.shape)
        every = [self._at[column] + number for column in source.columns for number in range(size)]
        return every[source.start : source.stop]

    def between(self, low: float, high: float) -> tuple[Floats, Floats]:
        """Return the rows with low <= time <= high; no later call may ask for rows before `low`.

        Returns:
            Their times, [N], s, and their numbers, [N, k], NaN where one is missing or not finite.

        Raises:
            ConversionError: A field's value has another shape than the others.
        """
        parts = [(self._times, self._values)]
        last = self._times[-1] if len(self._times) else -math.inf
        while last <= high and not self._is_over:
            block = next(self._blocks, None)
            if block is None:
                self._is_over = True
                break
            parts.append(self._matrix(block))
            last = parts[-1][0][-1]
            self._counter.add(block.count)
        times = np.concatenate([part for part, _ in parts])
        values = np.concatenate([part for _, part in parts])
        first, stop = np.searchsorted(times, low), np.searchsorted(times, high, side="right")
        self._times, self._values = times[first:], values[first:]
        return times[first:stop], values[first:stop]

    def all(self) -> Iterator[tuple[Floats, Floats]]:
        """Yield all rows, some at a time."""
        for block in self._blocks:
            self._counter.add(block.count)
            yield self._matrix(block)

    def _matrix(self, block: Block) -> tuple[Floats, Floats]:
        times = numpy_columns.from_table(to_table([_only(block, TIME_KEY)]))[TIME_KEY]
        values = np.full((block.count, self._values.shape[1]), np.nan)
        for name, shape in self._shapes.items():
            if name in block.columns:
                at = self._at[name]
                part = values[:, at : at + math.prod(shape)]
                if not _fill(part, block.columns[name].array, shape):
                    part[:] = self._column(block, name, shape, times)
        # The formats spell a missing number, but neither infinity.
        values[~np.isfinite(values)] = np.nan
        return times, values

    def _column(self, block: Block, name: str, shape: tuple[int, ...], times: Floats) -> Any:
        column, size = block.columns[name], math.prod(shape)
        if not column.is_text:
            array = numpy_columns.from_table(to_table([_only(block, name)]))[name]
            if array.dtype.kind in "fiub" and array.shape[1:] == shape:
                return numpy_columns.doubles(array).reshape(block.count, size)
        flat = np.full((block.count, size), np.nan)
        for row, value in enumerate(values_of(column)):
            if value is not None:
                flat[row] = self._odd(value, name, shape, float(times[row]))
        return flat

    def _odd(self, value: Any, name: str, shape: tuple[int, ...], time: float) -> Any:
        """Return the numbers of one row's value, which is no part of a plain array."""
        try:
            numbers = np.array(value, np.float64)
        except (TypeError, ValueError):
            numbers = np.empty(0)
        if numbers.shape != shape:
            wanted = f"{' x '.join(map(str, shape))} numbers" if shape else "a number"
            raise ConversionError(
                f"topic {self._topic!r}, field {name!r}, _ts={time!r}: {_short(value)} is not {wanted} as in the"
                " topic's other rows; leave these rows out by start= and end="
            )
        return numbers.reshape(-1)


def _only(block: Block, name: str) -> Block:
    return type(block)(block.count, {column: block.columns[column] for column in (TIME_KEY, name)})


def _fill(part: Floats, array: Any, shape: tuple[int, ...]) -> bool:
    """Put the numbers of a column of numbers, or of vectors of one length, where they belong; False for any other.

    Args:
        part: [N, k], NaN; stays so where one is missing.
        array: N values of pyarrow.
        shape: That each of them should have.
    """
    if isinstance(array, pa.ChunkedArray) or len(shape) > 1:
        return False
    leaf = array
    if shape:
        if not is_list(array.type):
            return False
        lengths = pc.min_max(pc.list_value_length(array)).as_py()
        if {*lengths.values()} != {shape[0]}:
            return False
        leaf = array.flatten()
    if not (pa.types.is_floating(leaf.type) or (pa.types.is_integer(leaf.type) and not leaf.null_count)):
        return False
    numbers = leaf.to_numpy(zero_copy_only=False).reshape(-1, part.shape[1])
    part[pc.is_valid(array).to_numpy(zero_copy_only=False) if shape and array.null_count else slice(None)] = numbers
    return True


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
