"""Which columns of a CSV file a topic's fields take."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import prod

import pyarrow as pa

from ....inspect.topics import TopicInfo
from ....rows import element_columns, kinds
from ....rows.dotted import free_names
from ....rows.element_columns import Lengths
from ....rows.encode import TIME_KEY, encodable
from ....rows.table import Block, Column
from . import cells

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
            names += element_columns.names(field, lengths or ())
        return (",".join(map(cells.text, free_names(names))) + "\n").encode()

    def cells(self, block: Block) -> list[pa.Array]:
        """Return the text of a block's rows, for each column of the header."""
        found = [cells.of(Column(kinds.whole(block.columns[TIME_KEY].array)))]
        for field, lengths in self._kept().items():
            column = block.columns.get(field) or Column(pa.nulls(block.count))
            found += _spread(Column(kinds.whole(column.array), column.is_text), lengths or ())
        return found

    def _widened(self, block: Block) -> dict[str, Lengths | None]:
        widened = dict(self._lengths)
        for name, column in block.columns.items():
            if name != TIME_KEY:
                widened[name] = element_columns.longest(widened.get(name), element_columns.lengths_of(column))
        return widened

    def _kept(self) -> dict[str, Lengths | None]:
        """Return the fields without dicts that were None here and there, whose keys are there."""
        parents = {name[:at] for name in self._lengths for at, letter in enumerate(name) if letter == "."}
        return {name: lengths for name, lengths in self._lengths.items() if lengths is not None or name not in parents}


def _expected(info: TopicInfo) -> Iterator[tuple[str, Lengths]]:
    """Yield the fields that the schema is sure of."""
    for name, said in info.fields.items():
        if said.type in _SPREAD and all(said.shape):
            yield encodable(name), element_columns.limited(tuple(length or 0 for length in said.shape))


def _is_wanted(name: str, columns: Sequence[str]) -> bool:
    return any(name == column or name.startswith(column + ".") for column in columns)


def _spread(column: Column, lengths: Lengths) -> list[pa.Array]:
    """Return the text of a column's values in as many columns as they take."""
    if not lengths or pa.types.is_null(column.array.type):
        return [cells.of(column)] * prod(lengths)
    return [
        cells
        for place in range(lengths[0])
        for cells in _spread(Column(element_columns.elements(column.array, place)), lengths[1:])
    ]
