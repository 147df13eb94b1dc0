"""Splits lists into a column for each element: which columns, their names, and their values."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from .dotted import free_names
from .shape import DICT, LIST, OPAQUE, Shape
from .typed_columns import ENCODING_KEY, Column, shape_of, whole

MOST_COLUMNS = 1000
"""A list that would take more columns stays one."""

Lengths = tuple[int, ...]
"""The greatest lengths of a field's lists, the outermost first; () for a field that takes one column."""

ONE_COLUMN: Lengths = ()


def lengths_of(values: Shape) -> Lengths | None:
    """Return how long the lists of some values are; None if there are no values, or only lists without elements."""
    lengths: list[int] = []
    while values.value_kinds == LIST and values.items is not None:
        lengths.append(values.longest)
        values = values.items
    if not all(lengths) or not (values.value_kinds or lengths):
        return None
    return ONE_COLUMN if values.value_kinds & (OPAQUE | DICT | LIST) else limited(tuple(lengths))


def limited(lengths: Lengths) -> Lengths:
    """Return the lengths, or `ONE_COLUMN` if they would take too many columns."""
    return lengths if 0 < math.prod(lengths) <= MOST_COLUMNS else ONE_COLUMN


def names(field: str, lengths: Lengths) -> Iterator[str]:
    """Yield the names of a field's columns: `q.0`, `q.1`, or `m.0.0`, `m.0.1`."""
    return (".".join((field, *map(str, index))) for index in itertools.product(*map(range, lengths)))


def elements(array: pa.Array, place: int) -> pa.Array:
    """Return the element at a place of each list; null where the list is shorter, or missing."""
    lengths_or_nulls = pc.list_value_length(array)
    lengths = (pc.fill_null(lengths_or_nulls, 0) if lengths_or_nulls.null_count else lengths_or_nulls).to_numpy()
    starts = np.cumsum(lengths) - lengths
    return array.flatten().take(pa.array(starts + place, mask=lengths <= place))


def columns(column: Column, lengths: Lengths) -> Iterator[pa.Array]:
    """Yield the columns that lists of such lengths become."""
    array = whole(column.array)
    if not lengths:
        yield array
        return
    for place in range(lengths[0]):
        inner = pa.nulls(len(array)) if pa.types.is_null(array.type) else elements(array, place)
        yield from columns(Column(inner), lengths[1:])


def of_table(table: pa.Table) -> pa.Table:
    """Return a table whose lists are a column an element, so that as little as possible in it is nested.

    Lists of various lengths have columns for the longest one, null where one is shorter.
    """
    names_of: list[str] = []
    fields: list[pa.Field] = []
    arrays: list[pa.Array] = []
    for field, array in zip(table.schema, table.columns, strict=True):
        column = Column(whole(array), is_text=ENCODING_KEY in (field.metadata or {}))
        lengths = lengths_of(shape_of(column)) or ONE_COLUMN
        names_of += names(field.name, lengths)
        parts = list(columns(column, lengths))
        fields += [field if not lengths else pa.field("", part.type) for part in parts]
        arrays += parts
    named = [field.with_name(name) for field, name in zip(fields, free_names(names_of), strict=True)]
    return pa.table(arrays, schema=pa.schema(named, metadata=table.schema.metadata))
