"""Reads JSON rows as columns, block by block, with pyarrow's reader where that loses nothing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import orjson
import pyarrow as pa
import pyarrow.compute as pc

from ..rows.plain_row import EXACT_KEY
from . import payloads as payload_arrays
from .codec import Columns
from .json_lines import LineReader, joined
from .json_pattern_reader import PatternReader
from .payloads import Payloads

_EXACT = f'"{EXACT_KEY}"'.encode()
_DOT = ord(".")
_NONE = np.empty(0, np.intp)


class JsonColumnReader:
    """Reads the rows of one channel as columns; rows with a side key are left to Python objects."""

    def __init__(self, columns: Sequence[str] | None) -> None:
        """Begin to read.

        Args:
            columns: Dotted names of the wanted columns; None for all.
        """
        self._patterns = PatternReader(columns)
        self._lines = LineReader(columns)

    def read(self, payloads: Sequence[bytes]) -> Columns | None:
        """Return the columns of rows, and which of them are left out."""
        columns = None
        if not payload_arrays.are_large(payloads):
            columns = self._patterns.read(_in_one_array(payloads))
        return self._read_lines(list(payloads)) if columns is None else columns

    def _read_lines(self, payloads: Sequence[bytes]) -> Columns | None:
        lines = joined(payloads)
        arrays = None if lines is None else self._lines.read(lines)
        if lines is None or arrays is not None:
            return None if arrays is None else Columns(arrays, _NONE)
        others = _with_side_key(payloads, lines.text)
        if not len(others):
            return None
        lines = joined([payloads[at] for at in np.setdiff1d(np.arange(len(payloads)), others).tolist()])
        arrays = None if lines is None else self._lines.read(lines)
        return None if arrays is None else Columns(arrays, others)

    def read_exactly(self, payloads: Sequence[bytes]) -> dict[str, Any] | None:
        """Return columns that tell all that the rows do.

        That they do can be proven from the bytes: there is no null, no key with a dot, and as many dots as doubles.
        """
        if not payload_arrays.are_large(payloads):
            in_one_array = _in_one_array(payloads)
            columns = self._patterns.read(in_one_array)
            if columns is not None and not len(columns.others):
                return columns.arrays if _say_all(in_one_array.data.tobytes(), columns.arrays) else None
        lines = joined(list(payloads))
        arrays = None if lines is None else self._lines.read(lines)
        return arrays if lines is not None and arrays is not None and _say_all(lines.text, arrays) else None


def _in_one_array(payloads: Sequence[bytes]) -> Payloads:
    return payloads if isinstance(payloads, Payloads) else payload_arrays.of_list(payloads)


def _with_side_key(payloads: Sequence[bytes], text: bytes) -> npt.NDArray[np.intp]:
    """Return the numbers of the payloads in which the side key's name stands somewhere."""
    return np.array([at for at, payload in enumerate(payloads) if _EXACT in payload] if _EXACT in text else [], np.intp)


def _say_all(lines: bytes, arrays: dict[str, Any]) -> bool:
    """Whether columns have no null, no key with a dot, and no double that was written without one, as integers are."""
    # The bytes cannot tell a key with a dot from a dict in a dict, so each key that such a name could be is looked for.
    if any(orjson.dumps(key) in lines for name in arrays for key in _keys_with_dots(name)):
        return False
    dots = 0
    for array in arrays.values():
        in_array = _dots(array)
        if in_array is None:
            return False
        dots += in_array
    return dots == int(np.count_nonzero(np.frombuffer(lines, np.uint8) == _DOT))


def _keys_with_dots(name: str) -> Iterator[str]:
    """Yield the parts of a dotted name that may be single keys with dots in them."""
    parts = name.split(".")
    for start in range(len(parts)):
        for end in range(start + 2, len(parts) + 1):
            yield ".".join(parts[start:end])


def _dots(array: Any) -> int | None:
    """Return how many dots the JSON of an array's values has if all its doubles have one; None if there is a null."""
    type_ = array.type
    if array.null_count or pa.types.is_null(type_):
        return None
    if pa.types.is_floating(type_):
        return len(array)
    if pa.types.is_string(type_):
        return int(pc.sum(pc.count_substring(array, ".")).as_py() or 0)
    if not type_.num_fields:
        return 0
    if any("." in type_.field(at).name for at in range(type_.num_fields)):
        return None
    counts = [_dots(inner) for inner in ([*array.flatten()] if pa.types.is_struct(type_) else [array.flatten()])]
    return None if None in counts else sum(count for count in counts if count is not None)
