"""Converts numbers between Arrow and numpy arrays over the same bytes.

pyarrow's own conversions load pandas where it is installed, which takes half a second and 26 MB.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa


def to_numpy(array: pa.Array | pa.ChunkedArray) -> npt.NDArray[Any]:
    """Return an array of integers or floats without nulls as numpy, [N], without a copy if it lies in one piece.

    Raises:
        ValueError: It has nulls.
    """
    if array.null_count:
        raise ValueError(f"{array.null_count} of {len(array)} values are null")
    if isinstance(array, pa.ChunkedArray):
        parts = [to_numpy(chunk) for chunk in array.chunks] or [to_numpy(pa.array([], array.type))]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)
    kind = "f" if pa.types.is_floating(array.type) else "i" if pa.types.is_signed_integer(array.type) else "u"
    values = array.buffers()[1]
    dtype = np.dtype(f"{kind}{array.type.bit_width // 8}")
    if values is None:
        return np.empty(0, dtype)
    # A slice of an Arrow array shares the buffer of the whole, and begins at its offset.
    return np.frombuffer(values, dtype, len(array), array.offset * dtype.itemsize)


def to_arrow(array: npt.NDArray[Any]) -> pa.Array:
    """Return an array of integers or floats, [N], as Arrow, without a copy if it lies in one piece."""
    values = pa.py_buffer(np.ascontiguousarray(array))
    return pa.Array.from_buffers(pa.from_numpy_dtype(array.dtype), len(array), [None, values])
