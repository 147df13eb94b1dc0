"""Which columns of a CSV file a topic's fields take."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from ..read.topics import TopicInfo
from ..rows import kinds
from ..rows.columns import free_names
from ..rows.encode import TIME_KEY
from ..rows.table import Block, Column
from . import csv_cells

MOST_CELLS = 1000
"""A list that would take more columns is one cell of JSON."""

Lengths = tuple[int, ...]
"""The greatest lengths of a field's lists, the outermost first; () for a field that takes one cell."""

_ONE_CELL: Lengths = ()
_SPREAD = {"boolean", "integer", "number", "string", "bytes"}


class Layout:
    """How many cells each field takes, learnt block by block."""

    def __init__(self, info: TopicInfo, columns: Sequence[str] | None = None) -> None:
        """Begin with what the topic's schema says.

        Args:
            info: The topic.
            columns: Dotted names of those wanted; None for all.
        """
        self._lengths: dict[str, Lengths | None] = {
            name: lengths for name, lengths in _expected(info) if columns is None or _is_wanted(name, columns)
        }
        """None for a field that has had no value."""

    def add(self, block: Block) -> None:
        """Make room for the values of a block."""
        self._lengths = self._widened(block)

    def holds(self, block: Block) -> bool:
        """Whether there is room for the values of a block."""
        return self._widened(block) == self._lengths

    def header(self) -> bytes:
        """Return the first line."""
        names = [TIME_KEY]
        for field, lengths in self._kept().items():
            names += _names(field, lengths or ())
        return (",".join(map(csv_cells.text, free_names(names))) + "\n").encode()

    def cells(self, block: Block) -> list[pa.Array]:
        """Return the text of a block's rows, for each column of the header."""
        found = [csv_cells.of(Column(kinds.whole(block.columns[TIME_KEY].array)))]
        for field, lengths in self._kept().items():
            column = block.columns.get(field) or Column(pa.nulls(block.count))
            found += _spread(Column(kinds.whole(column.array), column.is_text), lengths or ())
        return found

    def _widened(self, block: Block) -> dict[str, Lengths | None]:
        widened = dict(self._lengths)
        for name, column in block.columns.items():
            if name != TIME_KEY:
                widened[name] = _longest(widened.get(name), _lengths(column))
        return widened

    def _kept(self) -> dict[str, Lengths | None]:
        """Return the fields without dicts that were None here and there, whose keys are there."""
        parents = {name[:at] for name in self._lengths for at, letter in enumerate(name) if letter == "."}
        return {name: lengths for name, lengths in self._lengths.items() if lengths is not None or name not in parents}


def _expected(info: TopicInfo) -> Iterator[tuple[str, Lengths]]:
    """Yield the fields that the schema is sure of."""
    for name, said in info.fields.items():
        if said.type in _SPREAD and all(said.shape):
            yield name, _limited(tuple(length or 0 for length in said.shape))


def _is_wanted(name: str, columns: Sequence[str]) -> bool:
    return any(name == column or name.startswith(column + ".") for column in columns)


def _lengths(column: Column) -> Lengths | None:
    """Return how long the lists of some values are; None if there are no values, or only lists without elements."""
    array, lengths = kinds.whole(column.array), []
    while pa.types.is_list(array.type) or pa.types.is_fixed_size_list(array.type):
        lengths.append(pc.max(pc.list_value_length(array)).as_py() or 0)
        array = array.flatten()
    if not all(lengths) or (pa.types.is_null(array.type) and not lengths):
        return None
    return _ONE_CELL if column.is_text or pa.types.is_struct(array.type) else _limited(tuple(lengths))


def _limited(lengths: Lengths) -> Lengths:
    return lengths if 0 < math.prod(lengths) <= MOST_CELLS else _ONE_CELL


def _longest(first: Lengths | None, second: Lengths | None) -> Lengths | None:
    if first is None or second is None:
        return first if second is None else second
    if len(first) != len(second):
        return _ONE_CELL
    return _limited(tuple(map(max, first, second)))


def _names(field: str, lengths: Lengths) -> Iterator[str]:
    return (".".join((field, *map(str, index))) for index in itertools.product(*map(range, lengths)))


def _spread(column: Column, lengths: Lengths) -> list[pa.Array]:
    """Return the text of a column's values in as many columns as they take."""
    if not lengths or pa.types.is_null(column.array.type):
        return [csv_cells.of(column)] * math.prod(lengths)
    return [
        cells for place in range(lengths[0]) for cells in _spread(Column(_elements(column.array, place)), lengths[1:])
    ]


def _elements(array: pa.Array, place: int) -> pa.Array:
    """Return the element at a place of each list; null where the list is shorter, or missing."""
    said = pc.list_value_length(array)
    lengths = (pc.fill_null(said, 0) if said.null_count else said).to_numpy()
    starts = np.cumsum(lengths) - lengths
    return array.flatten().take(pa.array(starts + place, mask=lengths <= place))
