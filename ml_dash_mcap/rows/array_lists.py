"""Converts the arrays of rows into an Arrow column of lists."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from . import zero_copy


def has_arrays(values: Sequence[Any]) -> bool:
    """Whether there is an array among some values."""
    return any(isinstance(value, np.ndarray) for value in values)


def of(values: Sequence[Any]) -> pa.Array | None:
    """Return arrays, or None for a row without one, as lists of their numbers, of the type that these have.

    An element that is masked is null. None comes back where types or numbers of dimensions differ.
    """
    present = [value for value in values if value is not None]
    if not all(isinstance(value, np.ndarray) for value in present):
        return None
    dtypes = {array.dtype.newbyteorder("=") for array in present}
    dimensions = {array.ndim for array in present}
    if len(dtypes) != 1 or len(dimensions) != 1 or 0 in dimensions:
        return None
    elements = _elements(present, dtypes.pop())
    for level in reversed(range(dimensions.pop())):
        lengths = np.array([array.shape[level] for array in present], np.int64)
        repeats = np.array([int(np.prod(array.shape[:level])) for array in present], np.int64)
        is_present = None
        if level == 0 and len(present) < len(values):
            is_present = np.array([value is not None for value in values])
        elements = _listed(elements, lengths, repeats, is_present)
    return elements


def lists(values: Sequence[Any]) -> list[Any]:
    """Return values with lists in the place of arrays."""
    return [value.tolist() if isinstance(value, np.ndarray) else value for value in values]


def _elements(present: Sequence[Any], dtype: np.dtype[Any]) -> pa.Array:
    """Return all elements of arrays, one behind the other."""
    flat = [np.ma.getdata(array).reshape(-1).astype(dtype, copy=False) for array in present]
    numbers = flat[0] if len(flat) == 1 else np.concatenate(flat)
    if any(np.ma.is_masked(array) for array in present):
        mask = np.concatenate([np.ma.getmaskarray(array).reshape(-1) for array in present])
        return pa.array(numbers, mask=mask)
    # Arrow has a bit for a boolean and numpy a byte, so booleans are converted.
    return pa.array(numbers) if dtype.kind == "b" else zero_copy.to_arrow(numbers)


def _listed(
    elements: pa.Array,
    lengths: npt.NDArray[np.int64],
    repeats: npt.NDArray[np.int64],
    is_present: npt.NDArray[np.bool_] | None,
) -> pa.Array:
    """Cut elements into lists.

    Args:
        elements: Of all lists.
        lengths: Of the lists of each array.
        repeats: How many lists each array has.
        is_present: Which rows have an array, if some do not; each has one list then.
    """
    is_number = pa.types.is_integer(elements.type) or pa.types.is_floating(elements.type)
    is_fixed = is_present is None and is_number and not elements.null_count and len(set(lengths.tolist())) == 1
    if is_fixed and lengths[0]:
        return pa.FixedSizeListArray.from_arrays(elements, int(lengths[0]))
    every = np.repeat(lengths, repeats)
    if is_present is not None:
        every = np.zeros(len(is_present), np.int64)
        every[is_present] = lengths
    offsets = zero_copy.to_arrow(np.concatenate(([0], np.cumsum(every))).astype(np.int32))
    return pa.ListArray.from_arrays(offsets, elements, mask=None if is_present is None else pa.array(~is_present))
