"""Rows of CBOR, block by block, as columns: rows of one layout are one matrix of bytes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ..rows import zero_copy
from ..rows.dotted import FIELD_PREFIX
from ..rows.encode import TIME_KEY
from .cbor_layouts import NULL, Bytes, Layout, Leaf
from .codec import Columns

_MOST_TEXT_BYTES = 2**31 - 1

_MOST_LEFT = 0.5
"""Rows are read as columns if fewer of them than this share are of other layouts than most."""


class CborColumnReader:
    """Reads the rows of one channel as columns."""

    def __init__(self, columns: Sequence[str] | None) -> None:
        """Begin to read.

        Args:
            columns: Dotted names of those that will be wanted; None for all.
        """
        self._columns = columns
        self._layouts: dict[int, Layout] = {}
        """The latest layout of rows of each size."""

    def read(self, payloads: Sequence[bytes]) -> Columns | None:
        """Return the columns of the rows that have the most frequent layout."""
        sizes = Counter(map(len, payloads))
        size, count = sizes.most_common(1)[0] if sizes else (0, 0)
        if count <= _MOST_LEFT * len(payloads):
            return None
        same = np.flatnonzero(np.fromiter(map(len, payloads), np.intp, len(payloads)) == size)
        data = np.frombuffer(b"".join([payloads[at] for at in same.tolist()]), np.uint8)
        layout, fits = self._layout(size, data, count)
        if layout is None or np.count_nonzero(fits) <= _MOST_LEFT * len(payloads):
            return None
        rows = data.reshape(count, size)
        arrays: dict[str, Any] = {}
        if any("." in name for name in layout.root):
            return None
        rows = rows if fits.all() else rows[fits]
        if not all(self._put(arrays, name, item, rows) for name, item in layout.root.items()):
            return None
        return Columns(arrays, np.setdiff1d(np.arange(len(payloads)), same[fits]))

    def read_exactly(self, payloads: Sequence[bytes]) -> dict[str, Any] | None:
        """Return the columns, if all rows are of one layout, and none has a null."""
        columns = self.read(payloads)
        if columns is None or len(columns.others) or any(array.null_count for array in columns.arrays.values()):
            return None
        return columns.arrays

    def _layout(self, size: int, data: Bytes, count: int) -> tuple[Layout | None, npt.NDArray[np.bool_]]:
        """Return the layout of most rows of a size, and which rows are of it."""
        starts = np.arange(count, dtype=np.intp) * size
        latest = self._layouts.get(size)
        fits = np.zeros(count, np.bool_) if latest is None else latest.fits(data, starts)
        if latest is not None and np.count_nonzero(fits) > _MOST_LEFT * count:
            return latest, fits
        try:
            new = self._layouts[size] = Layout(data[:size].tobytes())
        except ValueError:
            return None, fits
        return new, new.fits(data, starts)

    def _put(self, arrays: dict[str, Any], name: str, item: Any, rows: Bytes) -> bool:
        """Add the columns of a field; returns whether they hold it without loss."""
        if not self._is_wanted(name):
            return True
        if isinstance(item, dict):
            inner = [(key, f"{name}.{key}", value) for key, value in item.items()]
            return bool(inner) and all(
                "." not in key and self._put(arrays, path, value, rows) for key, path, value in inner
            )
        array = pa.nulls(len(rows)) if item is NULL else _array(item, rows)
        if array is not None:
            arrays[name] = array
        return array is not None

    def _is_wanted(self, name: str) -> bool:
        return (
            self._columns is None
            or name == TIME_KEY
            or any(
                name == wanted or name.startswith(f"{wanted}.") or wanted.startswith(f"{name}.")
                for column in self._columns
                for wanted in (column, column.removeprefix(FIELD_PREFIX))
            )
        )


def _array(item: Any, rows: Bytes) -> Any:
    """Return an Arrow array of what stands in each row; None for what is to be read row by row."""
    if isinstance(item, list):
        return _lists(item, rows)
    if not isinstance(item, Leaf):
        return None
    if item.kind in ("float", "int"):
        numbers = _numbers([item], rows)
        return None if numbers is None else zero_copy.to_arrow(numbers)
    if item.kind == "bool":
        bits = np.packbits(rows[:, item.at] & 1, bitorder="little")
        return pa.Array.from_buffers(pa.bool_(), len(rows), [None, pa.py_buffer(bits)])
    return _texts(item, rows)


def _texts(leaf: Leaf, rows: Bytes) -> Any:
    if len(rows) * leaf.size > _MOST_TEXT_BYTES:
        return None
    data = np.ascontiguousarray(rows[:, leaf.start : leaf.start + leaf.size])
    ends = np.arange(len(rows) + 1, dtype=np.int32) * np.int32(leaf.size)
    type_ = pa.string() if leaf.kind == "text" else pa.binary()
    array = pa.Array.from_buffers(type_, len(rows), [None, pa.py_buffer(ends), pa.py_buffer(data)])
    try:
        array.validate(full=True)
    except pa.ArrowInvalid:  # text that is no UTF-8, which reading row by row names
        return None
    return array


def _lists(items: list[Any], rows: Bytes) -> Any:
    """Return lists of numbers, and lists of such of one length, as `rows.table` has them."""
    lengths = [len(items)]
    while items and all(isinstance(item, list) and len(item) == len(items[0]) for item in items):
        lengths.append(len(items[0]))
        items = [inner for item in items for inner in item]
    if not items or not all(isinstance(item, Leaf) and item.kind in ("float", "int") for item in items):
        return None
    numbers = _numbers(items, rows) if len({leaf.kind for leaf in items}) == 1 else None
    if numbers is None:
        return None
    array = pa.FixedSizeListArray.from_arrays(zero_copy.to_arrow(numbers), lengths[-1])
    for length in reversed(lengths[:-1]):
        ends = np.arange(len(array) // length + 1, dtype=np.int32) * np.int32(length)
        array = pa.ListArray.from_arrays(zero_copy.to_arrow(ends), array)
    return array


def _numbers(leaves: Sequence[Leaf], rows: Bytes) -> npt.NDArray[Any] | None:
    """Return the numbers of one kind in each row, row by row; None if no type has room for all."""
    starts = np.array([leaf.start for leaf in leaves])
    if leaves[0].kind == "float":
        doubles = np.ascontiguousarray(rows[:, (starts[:, None] + np.arange(8)).reshape(-1)])
        return doubles.view(">f8").astype(np.float64).reshape(-1)
    columns = [_integers(leaf, rows) for leaf in leaves]
    numbers = np.stack([magnitude for _, magnitude in columns], axis=1).reshape(-1)
    is_negative = np.stack([sign for sign, _ in columns], axis=1).reshape(-1)
    if not len(numbers) or int(numbers.max()) < 2**63:
        signed = numbers.astype(np.int64)
        return np.where(is_negative, ~signed, signed)
    return None if is_negative.any() else numbers


def _integers(leaf: Leaf, rows: Bytes) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.uint64]]:
    """Return whether an integer is negative, and its number: of a negative integer, that is -1 minus it."""
    heads = rows[:, leaf.at]
    if not leaf.size:
        return heads >= 0x20, (heads & 0x1F).astype(np.uint64)
    wide = np.ascontiguousarray(rows[:, leaf.start : leaf.start + leaf.size]).view(f">u{leaf.size}")
    return heads >= 0x20, wide.reshape(-1).astype(np.uint64)
