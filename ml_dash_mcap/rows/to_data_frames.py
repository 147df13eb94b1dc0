"""Converts Arrow tables into frames of pandas and polars, in which missing values change no others."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import pyarrow as pa

from .. import clock
from ..errors import OptionError, UsageError
from . import element_columns, numpy_columns, typed_columns
from .arrow_types import is_list
from .dotted import free_names
from .plain_row import TIME_KEY

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl

TimeForm = Literal["seconds", "datetime", "timedelta"]
"""How a frame says the time: the exact doubles in s; instants in UTC; or spans since the clock's 0, both in ns."""

_ARROW_TIMES = {"datetime": pa.timestamp("ns", tz="UTC"), "timedelta": pa.duration("ns")}


def shaped(table: pa.Table, *, flatten: bool, time: TimeForm) -> pa.Table:
    """Return a table of rows as a frame should have it.

    Args:
        table: With `_ts` in s.
        flatten: Whether lists of numbers become a column an element, see `element_columns`.
        time: The form that `_ts` takes.

    Raises:
        UsageError: `flatten` is neither True nor False.
        OptionError: There is no such `time`.
    """
    if not isinstance(flatten, bool):
        raise UsageError(f"flatten={flatten!r}: pass True or False")
    if time not in get_args(TimeForm):
        raise OptionError(f"time={time!r}: pass {', '.join(map(repr, get_args(TimeForm)))}")
    shaped_table = element_columns.of_table(table) if flatten else table
    if time == "seconds":
        return shaped_table
    stamps = nanoseconds(typed_columns.whole(shaped_table.column(TIME_KEY))).cast(_ARROW_TIMES[time])
    return shaped_table.set_column(shaped_table.column_names.index(TIME_KEY), TIME_KEY, stamps)


def to_pandas(table: pa.Table) -> pd.DataFrame:
    """Return a table as a pandas frame; instants or spans in `_ts` become its index.

    Integers and booleans among which some are missing have pandas' nullable types (`Int64`, `UInt64`, `boolean`);
    lists of such are arrays of objects. Columns of JSON text are the values that it says.
    """
    pandas = _module("pandas")
    nullable = {pa.int64(): pandas.Int64Dtype(), pa.uint64(): pandas.UInt64Dtype(), pa.bool_(): pandas.BooleanDtype()}
    odd: dict[str, Any] = {}
    gappy: list[str] = []
    for field, column in zip(table.schema, table.columns, strict=True):
        if typed_columns.is_json(field):
            odd[field.name] = numpy_columns.from_table(table.select([field.name]))[field.name]
        elif field.type in nullable:
            gappy += [field.name] * bool(column.null_count)
        elif pa.types.is_nested(field.type) and numpy_columns.is_large(column):
            odd[field.name] = numpy_columns.cells(column)
        elif pa.types.is_nested(field.type) and _has_gaps(typed_columns.whole(column)):
            odd[field.name] = _cells(column)
    parts = [
        table.drop_columns([*odd, *gappy]).to_pandas(),
        table.select(gappy).to_pandas(types_mapper=nullable.get),
        pandas.DataFrame({name: pandas.Series(values, dtype=object) for name, values in odd.items()}, dtype=object),
    ]
    parts = [part for part in parts if len(part.columns)]
    frame = parts[0] if len(parts) == 1 else pandas.concat(parts, axis=1)[table.column_names]
    return frame if pa.types.is_floating(table.schema.field(TIME_KEY).type) else frame.set_index(TIME_KEY)


def to_polars(table: pa.Table) -> pl.DataFrame:
    r"""Return a table as a polars frame; a NUL in a column's name, at which polars would end it, is spelled `\0`."""
    polars = _module("polars")
    names = free_names(name.replace("\0", "\\0") for name in table.column_names)
    frame: pl.DataFrame = polars.from_arrow(table.rename_columns(names))
    return frame


def nanoseconds(times: pa.Array) -> pa.Array:
    """Return time stamps in ns, as integers; null where 64 bits with a sign cannot hold them."""
    seconds = np.array(times.to_numpy(zero_copy_only=False), np.float64)
    fits = (seconds >= 0) & (seconds < clock.END_S)
    times_ns = clock.to_nanoseconds_each(np.where(fits, seconds, 0.0)).astype(np.int64)
    return pa.array(times_ns, mask=~fits)


def _has_gaps(array: pa.Array) -> bool:
    """Whether an integer or a boolean is missing in lists or dicts; pandas would make doubles of the others there."""
    type_ = array.type
    if pa.types.is_struct(type_):
        return any(map(_has_gaps, array.flatten()))
    if is_list(type_):
        return _has_gaps(array.flatten())
    return bool(array.null_count) and bool(pa.types.is_integer(type_) or pa.types.is_boolean(type_))


def _cells(column: pa.ChunkedArray) -> list[Any]:
    """Return lists as arrays of objects, as pandas has them; dicts and lists of such as they are."""
    values = column.to_pylist()
    return [
        np.array(value, object) if isinstance(value, list) and not _holds_dicts(value) else value for value in values
    ]


def _holds_dicts(values: list[Any]) -> bool:
    return any(isinstance(value, (dict, list)) for value in values)


def _module(name: str) -> Any:
    """Import a package that is no dependency of ours.

    Raises:
        ModuleNotFoundError: It is not installed; the message says how to install it.
    """
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name:
            raise
        raise ModuleNotFoundError(
            f"to_{name}() needs {name}, which is not installed: pip install {name}", name=name
        ) from error
