"""Reads tables that this library wrote back into their rows: the reverse of `formats.tables.parquet.layout`.

Null is a field that a row does not have; where a column has no value at all, every row had None there. Messages and
tables of others have all of their fields in each row: null is None there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ...capture.topic_registry import TopicAbout
from ...file_names import MESSAGE, TRACK
from ...recorder import Recorder, open_topic
from ...rows import numpy_columns, packed_arrays
from ...rows.dotted import FIELD_PREFIX
from ...rows.plain_row import TIME_KEY
from ...rows.typed_columns import ENCODING_KEY, from_text
from ...topic import Topic
from .. import vector_names
from .table_about import OTHER_CLOCK, UNIT_KEY, WALL_CLOCK, TableAbout, properties_of, shape_in

ABSENT: Any = object()

Make = Callable[[Any], Any]
"""Makes a row's value of what a column holds."""


class OurTable:
    """A table of this library, and the fields of rows that its columns were made of."""

    def __init__(self, schema: pa.Schema, about: TableAbout) -> None:
        """Look at the columns.

        Args:
            schema: Of the table.
            about: The description of the table in the file.
        """
        self._about = about
        self.time_name = about.time_name
        self._properties = properties_of(about.schema)
        taken = {self.time_name, *(field.name for field in list(schema)[1:2] if _is_derived(field))}
        self._fields = {field.name: field for field in schema if field.name not in taken}
        self._paths = {name: self._path(name, taken) for name in self._fields}
        self._vectors = self._grouped() if about.is_flat else {}
        grouped = {name for names, _ in self._vectors.values() for name in names}
        self._single = [name for name in self._fields if name not in grouped]
        self._nothing = None if about.kind == MESSAGE else ABSENT
        self._types = dict(_array_types(self._properties))
        self._makes = {name: self._maker(field) for name, field in self._fields.items()}

    def open(self, recorder: Recorder, name: str) -> Topic:
        """Open the topic of the table with its description, tags and metadata."""
        about = self._about
        params = about.run.get("params")
        if isinstance(params, Mapping) and params:
            recorder.set_parameters(params)
        kind = TRACK if about.kind == TRACK else MESSAGE  # messages never merge, so this is safe for an unknown kind
        return open_topic(
            recorder,
            name,
            kind,
            Topic,
            TopicAbout(description=about.description, tags=about.tags or None, metadata=about.metadata or None),
        )

    def append(self, topic: Topic, times: npt.NDArray[np.float64], batch: pa.RecordBatch) -> None:
        """Append some rows.

        Args:
            topic: Where to.
            times: Time stamps, [N], s.
            batch: Their columns.
        """
        columns = {name: batch.column(name) for name in self._fields}
        if not self._vectors:
            tree = self._arrays(columns)
            if tree is not None:
                topic.append_columns(_ts=times, **tree)
                return
        rows: list[dict[str, Any]] = [{} for _ in range(batch.num_rows)]
        for name in self._single:
            make, path = self._makes[name], self._paths[name]
            for row, value in zip(rows, columns[name].to_pylist(), strict=True):
                put(row, path, make(value))
        for base, (names, shape) in self._vectors.items():
            path, makes = self._paths_of(base), [self._makes[name] for name in names]
            vectors = zip(*(columns[name].to_pylist() for name in names), strict=True)
            for row, elements in zip(rows, vectors, strict=True):
                put(
                    row,
                    path,
                    self._vector([make(element) for make, element in zip(makes, elements, strict=True)], shape),
                )
        for row, time in zip(rows, times.tolist(), strict=True):
            row[TIME_KEY] = time
        topic.append_batch(rows)

    def _arrays(self, columns: Mapping[str, pa.Array]) -> dict[str, Any] | None:
        """Return nested dicts of numpy arrays, masked where a row lacks a field; None if not all are numbers."""
        tree: dict[str, Any] = {}
        for name, column in columns.items():
            is_nested = pa.types.is_struct(column.type)
            if self._nothing is None and (column.null_count or is_nested):  # a mask says that a row lacks the field
                return None
            array = _array(self._fields[name], column)
            if array is None or not self._is_packed_alike(name, array) or not put(tree, self._paths[name], array):
                return None
        return tree or None

    def _is_packed_alike(self, name: str, array: Any) -> bool:
        """Whether columns become arrays in the rows where arrays were, and lists where lists were."""
        if isinstance(array, dict):
            return all(self._is_packed_alike(f"{name}.{key}", inner) for key, inner in array.items())
        is_large = len(array) > 0 and array.ndim > 1 and packed_arrays.is_large(array[0])
        return bool(is_large == (name.removeprefix(FIELD_PREFIX) in self._types))

    def _maker(self, field: pa.Field) -> Make:
        return _maker(field, self._nothing, field.name.removeprefix(FIELD_PREFIX), self._types)

    def _vector(self, elements: list[Any], shape: tuple[int, ...]) -> Any:
        """Return the elements of a vector or a matrix in its shape; `ABSENT` if none is there."""
        flat = [None if element is ABSENT else element for element in elements]
        if all(element is None for element in flat):
            return self._nothing
        nested = _reshaped(flat, shape)
        return _trimmed(nested) if self._about.is_ragged else nested

    def _path(self, name: str, taken: set[str]) -> tuple[str, ...]:
        plain = name.removeprefix(FIELD_PREFIX)
        if name.startswith(FIELD_PREFIX) and plain in taken:
            return (plain,)
        return self._paths_of(name)

    def _paths_of(self, name: str) -> tuple[str, ...]:
        parts = tuple(name.split("."))
        return (name,) if name in self._properties or not all(parts) else parts

    def _grouped(self) -> dict[str, tuple[list[str], tuple[int, ...]]]:
        """Return the columns of each vector or matrix, and its shape, by its name."""
        names = [name for name in self._fields if name not in self._properties]
        return {
            base: elements
            for base, elements in vector_names.vectors(names).items()
            if base not in self._fields and self._type_of(base) != "object"
        }

    def _type_of(self, name: str) -> Any:
        """Return the type of a field in the rows' schema; None if it is not there."""
        inner: Any = {"properties": self._properties}
        for part in self._paths_of(name):
            inner = properties_of(inner).get(part)
        return inner.get("type") if isinstance(inner, Mapping) else None


def _is_derived(field: pa.Field) -> bool:
    """Whether a column repeats the time stamps in another form, for other readers."""
    if field.name == WALL_CLOCK:
        return bool(pa.types.is_timestamp(field.type))
    return field.name == OTHER_CLOCK and (field.metadata or {}).get(UNIT_KEY) == b"ns"


def put(row: dict[str, Any], path: tuple[str, ...], value: Any) -> bool:
    """Put a value into nested dicts; a key whose parent is no dict keeps its dots. Returns whether it is nested."""
    if value is ABSENT:
        return True
    inner = row
    for key in path[:-1]:
        child = inner.setdefault(key, {})
        if not isinstance(child, dict):
            row[".".join(path)] = value
            return False
        inner = child
    inner[path[-1]] = value
    return True


def _array_types(properties: Mapping[str, Any], parent: str = "") -> Iterator[tuple[str, str]]:
    """Yield the dotted names of fields that were large arrays, and the types of these."""
    for name, property_ in properties.items():
        description = (
            property_.get("description") if isinstance(property_, Mapping) and "contentEncoding" in property_ else None
        )
        array_type = packed_arrays.parse(description) if isinstance(description, str) else None
        if array_type is not None:
            yield parent + name, array_type[0]
        elif isinstance(property_, Mapping):
            yield from _array_types(properties_of(property_), f"{parent}{name}.")


def _large(value: Any, type_: str) -> Any:
    """Return nested lists as an array, if it is one that rows keep as an array; else the lists."""
    try:
        array = np.array(value, type_)
    except TypeError:  # None, where an element was masked
        objects = np.array(value, object)
        mask = np.reshape([element is None for element in objects.flat], objects.shape)
        array = np.ma.MaskedArray(np.where(mask, 0, objects).astype(type_), mask)
    except ValueError:  # ragged
        return value
    return array if packed_arrays.is_large(array) else value


def _maker(field: pa.Field, nothing: Any, name: str, types: Mapping[str, str]) -> Make:
    """Return what makes a row's value of a column's.

    Args:
        field: The column.
        nothing: What null is, `ABSENT` or None; it is None where the column's type has no other value.
        name: Of the field, dotted.
        types: Of the fields that were large arrays, by name.
    """
    metadata, type_ = field.metadata or {}, field.type
    if metadata.get(ENCODING_KEY) == b"json":
        return lambda value: nothing if value is None else from_text(value)
    if pa.types.is_null(type_):
        return lambda value: None
    shape = shape_in(metadata)
    if name in types:
        return lambda value: nothing if value is None else _large(_reshaped(value, shape), types[name])
    if len(shape) > 1:
        return lambda value: nothing if value is None else _reshaped(value, shape)
    if pa.types.is_struct(type_):
        return _struct_maker(type_, nothing, name, types)
    return lambda value: nothing if value is None else value


def _struct_maker(type_: pa.DataType, nothing: Any, name: str, types: Mapping[str, str]) -> Make:
    inner = [type_.field(at) for at in range(type_.num_fields)]
    makes = {child.name: _maker(child, nothing, f"{name}.{child.name}", types) for child in inner}
    has_values = _has_values(type_)

    def make(value: Any) -> Any:
        if value is None and has_values:
            return nothing
        made = {key: make_child((value or {}).get(key)) for key, make_child in makes.items()}
        return {key: inner for key, inner in made.items() if inner is not ABSENT}

    return make


def _has_values(type_: pa.DataType) -> bool:
    if pa.types.is_struct(type_):
        return any(_has_values(type_.field(at).type) for at in range(type_.num_fields))
    return not pa.types.is_null(type_)


def _reshaped(flat: list[Any], shape: tuple[int, ...]) -> list[Any]:
    for length in reversed(shape[1:]):
        flat = [flat[at : at + length] for at in range(0, len(flat), length)]
    return flat


def _trimmed(value: Any) -> Any:
    """Return lists without the missing elements at their ends."""
    if not isinstance(value, list):
        return value
    trimmed = [_trimmed(element) for element in value]
    while trimmed and (trimmed[-1] is None or trimmed[-1] == []):
        trimmed.pop()
    return trimmed


def _array(field: pa.Field, column: pa.Array) -> Any:
    """Return a column of numbers as numpy, [N, ...], or one of structs of such as a dict; None for all else."""
    if ENCODING_KEY in (field.metadata or {}):
        return None
    if pa.types.is_struct(field.type):
        inner = [field.type.field(at) for at in range(field.type.num_fields)]
        children = {
            child_field.name: _array(child_field, child)
            for child_field, child in zip(inner, column.flatten(), strict=True)
        }
        return children if children and all(child_field is not None for child_field in children.values()) else None
    shape, leaf = numpy_columns.common_shape(column)
    is_number = pa.types.is_integer(leaf.type) or pa.types.is_floating(leaf.type) or pa.types.is_boolean(leaf.type)
    if shape is None or not is_number or 0 in shape or (shape and leaf.null_count):
        return None
    present = column.is_valid().to_numpy(zero_copy_only=False)
    stated = shape_in(field.metadata or {}) or shape
    if len(shape) <= 1:
        shape = stated
    values = np.zeros((len(column), *shape), leaf.type.to_pandas_dtype())
    values[present] = (leaf.drop_null() if leaf.null_count else leaf).to_numpy(zero_copy_only=False).reshape(-1, *shape)
    if present.all():
        return values
    mask = np.broadcast_to(~present.reshape(-1, *([1] * len(shape))), values.shape)
    return np.ma.MaskedArray(values, mask)
