"""Reads the rows of a table as those of one topic: each a sample of its own, at the time that a column states."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import orjson
import pyarrow as pa

from ...capture.topic_registry import TopicAbout
from ...errors import ConversionWarning, ForeignFileError
from ...file_names import MESSAGE
from ...meaning.units import UNITS
from ...recorder import Recorder, open_topic
from ...rows import numpy_columns, typed_columns
from ...rows.dotted import FIELD_PREFIX, free_names
from ...rows.plain_row import EXACT_KEY, TIME_KEY
from ...rows.typed_columns import Column, values_of
from ...topic import Topic
from ..registry import Progress
from . import arrow_values, table_times
from .our_tables import OurTable
from .table_about import UNIT_KEY, TableAbout
from .table_options import TableReadOptions

_IN_BRACKETS = re.compile(r"[(\[]\s*([^()\[\]]+?)\s*[)\]]\s*$")
_KNOWN_UNITS = {
    *(unit for units in UNITS.values() for unit in units),
    *table_times.UNITS,
    *("V", "mV", "A", "mA", "W", "J", "Hz", "kHz", "Pa", "hPa", "kPa", "bar", "kg", "N/m", "%", "px"),
}
"""Words in brackets behind a column's name that are taken for its unit. Other words there may mean anything."""

UNIT_KEYS = (UNIT_KEY, b"unit", b"units")
"""The keys of a column's metadata that may hold its unit."""


class TableFile(Protocol):
    """One file with a table in it."""

    path: Path
    schema: pa.Schema
    """Its columns. The metadata of the schema and of its fields are what the file says of them."""
    about: TableAbout | None
    """The description that this library wrote into the file; None for a file of others."""

    def range_of(self, column: str) -> tuple[Any, Any]:
        """Return the least and the greatest value of a column of numbers; both None if it has none."""

    def batches(self) -> Iterator[pa.RecordBatch]:
        """Yield the rows, some at a time."""

    def place(self, row: int) -> str:
        """Return where in the file a row stands, in words; the first row is 0."""

    def close(self) -> None:
        """Close the file."""


class TableProgress:
    """Reports the progress of reading several files."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress = progress
        self._total = total
        self._done = 0

    def add(self, rows: int) -> None:
        """Count rows that are done."""
        self._done += rows
        self._total = max(self._total, self._done)
        if self._progress is not None:
            self._progress(self._done, self._total)

    def finish(self) -> None:
        """Report that all rows are done."""
        if self._progress is not None and self._done < self._total:
            self._progress(self._total, self._total)


def record(file: TableFile, name: str, recorder: Recorder, options: TableReadOptions, counter: TableProgress) -> None:
    """Append a table to a recorder.

    Args:
        file: The table.
        name: What to call the topic, where nothing else says it.
        recorder: Where to.
        options: How to read it.
        counter: Told of the rows that are done.

    Raises:
        ForeignFileError: No column is the time, a row has none, or a column's type is one that no row holds.
    """
    is_ours = file.about is not None and options.time_column in (None, file.about.time_name)
    intake = _Own(file, name, recorder, options) if is_ours else _Foreign(file, name, recorder, options)
    for batch in file.batches():
        intake.add(batch)
        counter.add(batch.num_rows)
    if not intake.rows:
        problem = f"{file.path}: the table has no rows, so there is no topic of it"
        warnings.warn(problem, ConversionWarning, stacklevel=4)
    if intake.left_out:
        warnings.warn(
            f"{file.path}: {intake.left_out} rows without a time were left out", ConversionWarning, stacklevel=4
        )


class _Intake:
    """The common part of reading our own tables and those of others: picks the rows that have a time."""

    def __init__(self, file: TableFile, options: TableReadOptions) -> None:
        self._file, self._options = file, options
        self.rows = 0
        self.left_out = 0

    def _timed(
        self, batch: pa.RecordBatch, times: npt.NDArray[np.float64], name: str
    ) -> tuple[pa.RecordBatch, npt.NDArray[np.float64]]:
        """Return the rows that have a time, with their times."""
        if self._options.start:
            times = times + self._options.start
        good = table_times.are_times(times)
        first = self.rows
        self.rows += batch.num_rows
        if good.all():
            # Adding 0.0 turns -0.0 into 0.0, which the recorder stores.
            return batch, times + 0.0
        if self._options.on_bad == "raise":
            at = int((~good).argmax())
            value = batch.column(name)[at].as_py()
            hint = table_times.hint(float(times[at]))
            problem = f"the time is {value!r} in the column {name!r}, which is no time stamp; {hint}"
            raise ForeignFileError(self._file.path, f"{self._file.place(first + at)}: {problem}")
        self.left_out += int((~good).sum())
        return batch.filter(pa.array(good)), times[good]


class _Foreign(_Intake):
    """A table of another program: all columns become fields, null becomes None, and no rows merge."""

    def __init__(self, file: TableFile, name: str, recorder: Recorder, options: TableReadOptions) -> None:
        super().__init__(file, options)
        units = _units(file.schema)
        self._time = table_times.find(
            file.path,
            file.schema,
            file.range_of,
            time_column=options.time_column,
            time_unit=options.time_unit,
            units=units,
        )
        at = file.schema.names.index(self._time.name)
        kept = [number for number in range(len(file.schema)) if number != at or not self._time.is_seconds]
        self._columns = dict(zip(_field_names([file.schema.names[number] for number in kept]), kept, strict=True))
        metadata = _metadata_of(file, self._columns, self._time, units)
        self._topic = open_topic(recorder, options.topic or name, MESSAGE, Topic, TopicAbout(metadata=metadata))
        self._json = {name for name, at in self._columns.items() if typed_columns.is_json(file.schema.field(at))}

    def add(self, batch: pa.RecordBatch) -> None:
        at = batch.schema.names.index(self._time.name)
        batch, times = self._timed(
            batch, table_times.seconds(self._file.path, batch.column(at), self._time), self._time.name
        )
        if batch.num_rows:
            columns = {name: self._plain(batch, at) for name, at in self._columns.items()}
            append(self._topic, times, columns, self._json)

    def _plain(self, batch: pa.RecordBatch, at: int) -> pa.Array:
        try:
            return arrow_values.plain(batch.column(at))
        except (TypeError, pa.ArrowException) as error:
            name = batch.schema.names[at]
            raise ForeignFileError(self._file.path, f"the column {name!r} cannot be read: {error}") from error


class _Own(_Intake):
    """A table of this library: it becomes the rows that it was written from."""

    def __init__(self, file: TableFile, name: str, recorder: Recorder, options: TableReadOptions) -> None:
        super().__init__(file, options)
        assert file.about is not None
        self._table = OurTable(file.schema, file.about)
        self._topic = self._table.open(recorder, options.topic or file.about.topic or name)

    def add(self, batch: pa.RecordBatch) -> None:
        name = self._table.time_name
        batch, times = self._timed(batch, _doubles(batch.column(name)), name)
        if batch.num_rows:
            self._table.append(self._topic, times, batch)


def _doubles(column: pa.Array) -> npt.NDArray[np.float64]:
    """Return a column's numbers; NaN for a value that is none, such as a text among the times."""
    try:
        return np.array(column.cast(pa.float64()).to_numpy(zero_copy_only=False), np.float64)
    except pa.ArrowException:
        return np.array([_double(value) for value in column.to_pylist()])


def _double(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        return math.nan


def append(
    topic: Topic, times: npt.NDArray[np.float64], columns: Mapping[str, pa.Array], json: Collection[str]
) -> None:
    """Append rows, null as None.

    Args:
        topic: Where to.
        times: Time stamps, [N], s.
        columns: By field, [N], of types that rows have.
        json: The fields whose columns are JSON text, because no one type holds their values.
    """
    arrays_by_field = {name: numbers(array) for name, array in columns.items()}
    if columns and all(array is not None for array in arrays_by_field.values()):
        topic.append_columns(_ts=times, **arrays_by_field)
        return
    values = [values_of(Column(array, is_text=name in json)) for name, array in columns.items()]
    stamps = times.tolist()
    rows = zip(*values, stamps, strict=True)
    names = (*columns, TIME_KEY)
    topic.append_batch([dict(zip(names, row, strict=True)) for row in rows])


def numbers(array: pa.Array) -> npt.NDArray[Any] | None:
    """Return numbers, booleans, or vectors of one shape as numpy, [N, ...]; None for all else, and with any null."""
    if array.null_count:
        return None
    shape, leaf = numpy_columns.common_shape(array)
    if shape is None or leaf.null_count or 0 in shape:
        return None
    if not (pa.types.is_integer(leaf.type) or pa.types.is_floating(leaf.type) or pa.types.is_boolean(leaf.type)):
        return None
    flat: npt.NDArray[Any] = leaf.to_numpy(zero_copy_only=False)
    return flat.reshape(len(array), *shape)


def _field_names(names: list[str]) -> list[str]:
    """Return names that fields may have: none is reserved, and none is there twice."""
    return free_names(FIELD_PREFIX + name if name in (TIME_KEY, EXACT_KEY) else name for name in names)


def _units(schema: pa.Schema) -> dict[str, str]:
    """Return the units that columns say in their metadata, or in brackets behind their names, by dotted name."""
    units: dict[str, str] = {}

    def look(field: pa.Field, name: str) -> None:
        stated = next((field.metadata[key] for key in UNIT_KEYS if key in (field.metadata or {})), None)
        if stated is not None:
            units[name] = stated.decode("utf-8", "replace")
        elif pa.types.is_duration(field.type):
            units[name] = field.type.unit
        elif (behind := _IN_BRACKETS.search(name)) and behind[1] in _KNOWN_UNITS:
            units[name] = behind[1]
        if pa.types.is_struct(field.type):
            for at in range(field.type.num_fields):
                look(field.type.field(at), f"{name}.{field.type.field(at).name}")

    for field in schema:
        look(field, field.name)
    return units


def _metadata_of(
    file: TableFile, columns: Mapping[str, int], time: table_times.TimeColumn, units: Mapping[str, str]
) -> dict[str, Any]:
    """Return a topic's metadata: units, Arrow types that values do not show, the file's metadata, the time column."""
    about: dict[str, Any] = {"source": file.path.name, "time_column": time.name}
    if units:
        about["units"] = {name: unit for name, unit in units.items() if name != time.name or not time.is_seconds}
    types = {name: arrow_values.meaning(file.schema.field(at).type) for name, at in columns.items()}
    if any(types.values()):
        about["arrow_types"] = {name: type_ for name, type_ in types.items() if type_ is not None}
    metadata = file.schema.metadata or {}
    if metadata:
        about["file_metadata"] = {_text(key): _json_or_text(value) for key, value in metadata.items()}
    return about


def _json_or_text(value: bytes) -> Any:
    try:
        return orjson.loads(value)
    except orjson.JSONDecodeError:
        return _text(value)


def _text(value: bytes) -> str:
    return value.decode("utf-8", "replace")
