"""The columns of a CSV file that a topic's fields take."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import prod

import pyarrow as pa

from ....inspect.topics import TopicInfo
from ....rows import element_columns
from ....rows.dotted import free_names
from ....rows.element_columns import Lengths
from ....rows.field_choice import is_wanted
from ....rows.plain_row import TIME_KEY, encodable
from ....rows.shape import NOTHING, Shape
from ....rows.table import Block
from ....rows.typed_columns import Column, shape_of, whole
from . import cells


class CsvLayout:
    """How many cells each field takes, learnt block by block."""

    def __init__(self, info: TopicInfo, columns: Sequence[str] | None = None) -> None:
        """Begin with what the topic's schema says.

        Args:
            info: The topic.
            columns: Dotted names of those wanted; None for all.
        """
        self._shapes: dict[str, Shape] = {name: values for name, values in _expected(info) if is_wanted(name, columns)}
        in_order = info.fields if columns is None else ()
        self._places = {encodable(name): place for place, name in enumerate(in_order)}

    def add(self, block: Block) -> None:
        """Make room for the values of a block."""
        self._shapes = self._widened(block)

    def holds(self, block: Block) -> bool:
        """Whether there is room for the values of a block."""
        return _lengths(self._widened(block)) == _lengths(self._shapes)

    def header(self) -> bytes:
        """Return the first line."""
        names = [TIME_KEY]
        for field, lengths in self._kept().items():
            names += element_columns.names(field, lengths or ())
        return (",".join(map(cells.text, free_names(names))) + "\n").encode()

    def cells(self, block: Block) -> list[pa.Array]:
        """Return the text of a block's rows, for each column of the header."""
        columns = [cells.of(Column(whole(block.columns[TIME_KEY].array)))]
        for field, lengths in self._kept().items():
            column = block.columns.get(field) or Column(pa.nulls(block.count))
            columns += _spread(Column(whole(column.array), column.is_text), lengths or ())
        return columns

    def _widened(self, block: Block) -> dict[str, Shape]:
        widened = dict(self._shapes)
        for name, column in block.columns.items():
            if name != TIME_KEY:
                widened[name] = widened.get(name, NOTHING) | shape_of(column)
        # Not all that the schema names has lengths there: which do differs between the encodings of rows.
        return dict(sorted(widened.items(), key=lambda item: self._places.get(item[0], len(self._places))))

    def _kept(self) -> dict[str, Lengths | None]:
        """Return the lengths of the fields; one that was None here and a dict there has those of its keys."""
        parents = {name[:at] for name in self._shapes for at, letter in enumerate(name) if letter == "."}
        lengths = _lengths(self._shapes)
        return {name: lengths[name] for name in lengths if lengths[name] is not None or name not in parents}


def _lengths(shapes: Mapping[str, Shape]) -> dict[str, Lengths | None]:
    """Return how many cells each field takes; None for one that has had no value."""
    return {name: element_columns.lengths_of(values) for name, values in shapes.items()}


def _expected(info: TopicInfo) -> Iterator[tuple[str, Shape]]:
    """Yield the fields that the schema is sure of."""
    for name, field in info.fields.items():
        values = field.least_shape()
        if values is not None:
            yield encodable(name), values


def _spread(column: Column, lengths: Lengths) -> list[pa.Array]:
    """Return the text of a column's values in as many columns as they take."""
    if not lengths or pa.types.is_null(column.array.type):
        return [cells.of(column)] * prod(lengths)
    return [
        cells
        for place in range(lengths[0])
        for cells in _spread(Column(element_columns.elements(column.array, place)), lengths[1:])
    ]
