"""Lays a topic's columns out in a Parquet file: their types, their structs, and the metadata of each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
import orjson
import pyarrow as pa

from .... import clock
from ....inspect.topics import TopicInfo
from ....rows.arrow_types import element_type, stored_type, type_of, vector_lengths
from ....rows.dotted import FIELD_PREFIX, flatten, free_names
from ....rows.field_choice import is_wanted
from ....rows.plain_row import TIME_KEY, encodable
from ....rows.shape import NOTHING, ONLY_NULL, Shape
from ....rows.table import Block
from ....rows.to_data_frames import nanoseconds
from ....rows.typed_columns import ENCODING_KEY, Column, cast_to_file, shape_of, whole
from .. import nested_columns
from ..table_about import OTHER_CLOCK, UNIT_KEY, WALL_CLOCK, properties_of, shape_metadata

Make = Callable[[pa.Array], pa.Array]


class ParquetLayout:
    """The columns of a topic, which widen block by block. By them, blocks become tables of one schema."""

    def __init__(self, info: TopicInfo, columns: Sequence[str] | None = None, *, flat: bool) -> None:
        """Begin with what the topic's schema says.

        Args:
            info: The topic.
            columns: Dotted names of those wanted; None for all.
            flat: Whether vectors are a column an element, and nested fields columns with dotted names.
        """
        self._flat = flat
        self._shapes = {name: values for name, values in _expected(info) if is_wanted(name, columns)}
        in_order = info.fields if columns is None else ()
        self._places = {encodable(name): place for place, name in enumerate(in_order)}
        self._literal = {name for name in properties_of(info.schema) if "." in name}
        units = info.metadata.get("units")
        self._units = flatten({**units, TIME_KEY: "s"}, TIME_KEY) if isinstance(units, Mapping) else {}
        # Instants of 1970 would be wrong for a clock that starts near 0, so it gets plain nanoseconds.
        self._time_name = WALL_CLOCK if clock.is_epoch_like(info.start or 0.0) else OTHER_CLOCK
        self._rows = False

    def add(self, block: Block) -> None:
        """Widen the columns by the values of a block."""
        self._shapes = self._widened(block)
        self._rows = True

    def holds(self, block: Block) -> bool:
        """Whether a block's values fit the columns."""
        widened = self._widened(block)
        return widened.keys() == self._shapes.keys() and all(
            values is self._shapes[name] or _are_stored_alike(values, self._shapes[name])
            for name, values in widened.items()
        )

    def schema(self) -> pa.Schema:
        """Return the schema of all tables."""
        return self._plan()[0]

    def tables(self) -> Callable[[Block], pa.Table]:
        """Return what makes a table of a block, by the columns as they are now."""
        schema, tree, columns = self._plan()
        kept = self._kept()
        time_type = schema.field(1).type

        def make(block: Block) -> pa.Table:
            cast = {name: cast_to_file(_values(block, name), values) for name, values in kept.items()}
            flat = {name: take(cast[source]) for name, (source, _, take) in columns.items()}
            times = whole(block.columns[TIME_KEY].array)
            stamps = nanoseconds(times).cast(time_type)
            return pa.Table.from_arrays(
                [times, stamps, *nested_columns.arrays(list(schema)[2:], tree, flat)], schema=schema
            )

        return make

    def _widened(self, block: Block) -> dict[str, Shape]:
        new = ONLY_NULL if self._rows else NOTHING
        widened: dict[str, Shape] = {}
        for name in {**self._shapes, **{name: None for name in block.columns if name != TIME_KEY}}:
            widened[name] = self._shapes.get(name, new) | shape_of(_values(block, name))
        # Not all that the schema names has lengths there: which do differs between the encodings of rows.
        return dict(sorted(widened.items(), key=lambda item: self._places.get(item[0], len(self._places))))

    def _kept(self) -> dict[str, Shape]:
        """Return the columns; a field that was None in some rows and a dict in others has those of its keys."""
        parents = {name[:at] for name in self._shapes for at, letter in enumerate(name) if letter == "."}
        return {name: values for name, values in self._shapes.items() if values.value_kinds or name not in parents}

    def _plan(self) -> tuple[pa.Schema, nested_columns.Tree, dict[str, tuple[str, pa.Field, Make]]]:
        """Return the schema, where the columns lie in it, and of each: what it is made of, its field, and how."""
        made = [column for source, values in self._kept().items() for column in self._columns(source, values)]
        names = [FIELD_PREFIX + field.name if field.name == self._time_name else field.name for _, field, _ in made]
        columns = dict(zip(free_names(names), made, strict=True))
        literal = {FIELD_PREFIX + self._time_name, *self._literal}
        tree = nested_columns.tree(columns, columns if self._flat else literal).renamed(
            {self._time_name: FIELD_PREFIX + self._time_name}
        )
        time_type = pa.timestamp("ns", tz="UTC") if self._time_name == WALL_CLOCK else pa.int64()
        times = [
            pa.field(TIME_KEY, pa.float64(), nullable=False, metadata={UNIT_KEY: b"s"}),
            pa.field(self._time_name, time_type, metadata=None if self._time_name == WALL_CLOCK else {UNIT_KEY: b"ns"}),
        ]
        return pa.schema([*times, *nested_columns.fields(tree, lambda name: columns[name][1])]), tree, columns

    def _columns(self, name: str, values: Shape) -> Iterator[tuple[str, pa.Field, Make]]:
        """Yield the columns of a field: its name, the Arrow field, and what makes the column of its values."""
        about = {ENCODING_KEY: b"json"} if type_of(values) is None else {}
        unit = self._units.get(name)
        if unit is not None:
            about[UNIT_KEY] = (unit if isinstance(unit, str) else orjson.dumps(unit).decode()).encode()
        lengths = vector_lengths(values)
        if not (self._flat and lengths):
            shape = shape_metadata(lengths)
            yield name, pa.field(name, stored_type(values), metadata={**about, **shape} or None), lambda array: array
            return
        for place, index in enumerate(np.ndindex(*lengths)):
            element = ".".join(map(str, (name, *index)))
            yield name, pa.field(element, element_type(values), metadata=about or None), _element(place, lengths)


def _expected(info: TopicInfo) -> Iterator[tuple[str, Shape]]:
    """Yield the columns that the schema is sure of."""
    for name, field in info.fields.items():
        values = field.least_shape()
        if values is not None and (not field.shape or field.type in ("integer", "number")):
            yield encodable(name), values


def _are_stored_alike(first: Shape, second: Shape) -> bool:
    alike = (stored_type(first), vector_lengths(first), type_of(first) is None)
    return alike == (stored_type(second), vector_lengths(second), type_of(second) is None)


def _values(block: Block, name: str) -> Column:
    return block.columns.get(name) or Column(pa.nulls(block.count))


def _element(place: int, lengths: tuple[int, ...]) -> Make:
    """Return what takes one element, by its number, of each vector or matrix."""
    size = int(np.prod(lengths))

    def take(array: pa.Array) -> pa.Array:
        if array.null_count == 0:
            return array.flatten().take(pa.array(np.arange(place, len(array) * size, size)))
        present = array.is_valid().to_numpy(zero_copy_only=False)
        where = (np.cumsum(present) - 1) * size + place
        return array.flatten().take(pa.array(where, mask=~present))

    return take
