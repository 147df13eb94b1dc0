"""Finds the column of times of a table, and returns its times in seconds."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from ...clock import END_S
from ...errors import ForeignFileError, OptionError
from ...rows.plain_row import TIME_KEY
from ...rows.shape import EXACT_INTEGER
from ...suggestions import not_found

UNITS = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
"""Units of time, to how many of them a second has."""

NAMES = (
    *(TIME_KEY, "timestamp", "time", "stamp", "t", "ts", "datetime", "date_time", "elapsed", "elapsed_time"),
    *("unix_time", "epoch", "log_time", "sim_time", "rosbagtimestamp", "seconds", "nanoseconds", "date"),
)
"""Names of columns of time, the likeliest first; a unit may stand behind them: `time_ns`, `Time (s)`, `t [ms]`, and
`%`, `#` or `_` before them: `%time`, `__time`."""

_WORDS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec", "msecs", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("us", "\u00b5s", "\u03bcs", "usec", "usecs", "microsecond", "microseconds"), "us"),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanosecond", "nanoseconds"), "ns"),
}
_BEHIND = re.compile(r"[\s_]*(?:[\s_]|[(\[])\s*(" + "|".join(_WORDS) + r")\s*[)\]]?$")
_PLAIN_S = (631_152_000, 4_102_444_800)
"""1990 and 2100, in s since 1970: numbers between them, in some unit, are wall-clock times in that unit."""

_LEAVE_OUT = "on_bad='missing' to convert() to leave out what has no time"
_ZONE = r"(Z|[+\-]\d\d:?\d\d)$"

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TimeColumn:
    """The column of times."""

    name: str
    unit: str
    """One of `UNITS`, of numbers; for text and for types of time "ns" and what the type says."""
    is_seconds: bool
    """Whether its numbers are the seconds themselves, so that `_ts` says all that it says."""
    is_number: bool
    """Whether it holds numbers, rather than text or a type of time."""


def find(
    path: Path,
    schema: pa.Schema,
    range_of: Callable[[str], tuple[Any, Any]],
    *,
    time_column: str | None,
    time_unit: str | None,
    units: Mapping[str, str],
) -> TimeColumn:
    """Find a table's column of times.

    Args:
        path: The file, for the errors.
        schema: Its columns.
        range_of: Returns the least and the greatest value of a column of numbers; both None if it has none.
        time_column: What the caller says it is called.
        time_unit: What the caller says its numbers count.
        units: The units of columns that the file states.

    Raises:
        ForeignFileError: There is none, or its numbers' unit is not plain.
        NotFoundError: There is no `time_column`.
        OptionError: `time_unit` is no unit, or contradicts the column's type.
    """
    if time_unit is not None and time_unit not in UNITS:
        raise OptionError(f"time_unit={time_unit!r}: pass {', '.join(map(repr, UNITS))}")
    name = _named(path, schema, time_column)
    type_ = schema.field(schema.names.index(name)).type
    if pa.types.is_dictionary(type_):
        type_ = type_.value_type
    if pa.types.is_timestamp(type_) or pa.types.is_duration(type_) or pa.types.is_date(type_) or _is_text(type_):
        unit = type_.unit if pa.types.is_timestamp(type_) or pa.types.is_duration(type_) else "ns"
        if time_unit not in (None, unit):
            raise OptionError(f"{path}: the column {name!r} is {type_}, which says its unit; leave out time_unit=")
        return TimeColumn(name, unit, False, False)
    if not (pa.types.is_integer(type_) or pa.types.is_floating(type_)):
        raise _none(path, schema, f"the column {name!r} is {type_}, which is no time")
    unit = time_unit or _WORDS.get(units.get(name, "").strip().lower()) or _unit_behind(name)
    if unit is None:
        unit = _plain_unit(path, name, type_, range_of)
    return TimeColumn(name, unit, unit == "s" and pa.types.is_floating(type_), True)


def seconds(path: Path, array: pa.Array, column: TimeColumn) -> Floats:
    """Return times in s, each the double nearest to the column's value, [N]; NaN where it has none.

    Raises:
        ForeignFileError: Text is no time as ISO 8601 has it.
    """
    type_ = array.type
    if pa.types.is_dictionary(type_):
        array, type_ = array.dictionary_decode(), type_.value_type
    if _is_text(type_):
        array = _parsed(path, array, column.name)
    elif pa.types.is_date(type_):
        array = array.cast(pa.timestamp("s")).cast(pa.timestamp("ns"))
    if pa.types.is_floating(type_):
        numbers = np.array(array.cast(pa.float64()).to_numpy(zero_copy_only=False), np.float64)
        return numbers if column.unit == "s" else numbers / UNITS[column.unit]
    counts = array if pa.types.is_integer(type_) else array.cast(pa.int64())
    present = counts.is_valid().to_numpy(zero_copy_only=False)
    numbers = counts.fill_null(0).to_numpy(zero_copy_only=False)
    return np.where(present, _divided(numbers, UNITS[column.unit]), np.nan)


def is_likely(name: str) -> bool:
    """Whether a column is called like a time."""
    return _rank(name) is not None


def hint(time: float) -> str:
    """Return advice about a value that is no time stamp."""
    return f"pass {'start= to convert() to shift the times' if time < 0 else _LEAVE_OUT}"


def are_times(times: Floats) -> npt.NDArray[np.bool_]:
    """Tell which are times that a recording can hold, [N]."""
    return (times >= 0) & (times < END_S)


def _divided(numbers: npt.NDArray[Any], by: int) -> Floats:
    """Divide integers, each rounded once."""
    if by == 1 or not len(numbers) or (int(numbers.min()) >= -EXACT_INTEGER and int(numbers.max()) <= EXACT_INTEGER):
        return numbers.astype(np.float64) / by
    # Python divides integers with one rounding; numpy would first round those above 2**53 to doubles.
    return np.array([number / by for number in numbers.tolist()])


def _named(path: Path, schema: pa.Schema, time_column: str | None) -> str:
    names: list[str] = list(dict.fromkeys(schema.names))
    if time_column is not None:
        if time_column not in names:
            raise not_found("column", time_column, names)
        return time_column
    likely = {name: _rank(name) for name in names if _may_be_time(schema.field(schema.names.index(name)).type)}
    ranked = {name: rank for name, rank in likely.items() if rank is not None}
    if ranked:
        return min(ranked, key=ranked.__getitem__)
    typed: list[str] = [field.name for field in schema if pa.types.is_timestamp(field.type)]
    if len(typed) == 1:
        return typed[0]
    if typed:
        raise _none(path, schema, f"the columns {', '.join(map(repr, typed))} could be its time")
    raise _none(path, schema, "no column is called like a time")


def _none(path: Path, schema: pa.Schema, problem: str) -> ForeignFileError:
    """Return the error for a table without a time, which lists its columns."""
    shown = ", ".join(f"{field.name} ({field.type})" for field in list(schema)[:40])
    more = f" and {len(schema) - 40} more" if len(schema) > 40 else ""
    return ForeignFileError(path, f"{problem}; pass time_column= to convert(), one of {shown}{more}")


def _may_be_time(type_: pa.DataType) -> bool:
    if pa.types.is_dictionary(type_):
        return _may_be_time(type_.value_type)
    is_number = pa.types.is_integer(type_) or pa.types.is_floating(type_)
    is_time = pa.types.is_timestamp(type_) or pa.types.is_duration(type_) or pa.types.is_date(type_)
    return is_number or is_time or _is_text(type_)


def _is_text(type_: pa.DataType) -> bool:
    return bool(pa.types.is_string(type_) or pa.types.is_large_string(type_) or str(type_) == "string_view")


def _rank(name: str) -> int | None:
    """Return how likely a name is that of a time; less is likelier, None is not at all."""
    plain = name.strip().lower()
    for more, candidate in enumerate((plain, _bare(plain), _BEHIND.sub("", plain), _BEHIND.sub("", _bare(plain)))):
        if candidate in NAMES:
            # The name counts first; within it, the spelling as it is beats one without prefix or unit.
            return 4 * NAMES.index(candidate) + more
    return None


def _bare(name: str) -> str:
    """Return a name without what some tools put before it."""
    return name.lstrip("%#_ ")


def _unit_behind(name: str) -> str | None:
    plain = _bare(name.strip().lower())
    if plain in ("seconds", "nanoseconds"):
        return _WORDS[plain]
    if name == TIME_KEY:
        return "s"
    behind = _BEHIND.search(plain)
    return _WORDS[behind[1]] if behind and plain not in NAMES else None


def _plain_unit(path: Path, name: str, type_: pa.DataType, range_of: Callable[[str], tuple[Any, Any]]) -> str:
    low, high = range_of(name)
    # Only NaN is unequal to itself.
    if low is None or high is None or low != low or high != high:
        return "s"
    for unit, count in UNITS.items():
        if _PLAIN_S[0] * count <= low <= high < _PLAIN_S[1] * count:
            return unit
    if pa.types.is_floating(type_):
        return "s"
    raise ForeignFileError(
        path,
        f"the column {name!r} has the integers {low} to {high}, and nothing says what they count; pass time_unit= to"
        f" convert(), one of {', '.join(map(repr, UNITS))}, or time_column= if another column is the time",
    )


def _parsed(path: Path, texts: pa.Array, name: str) -> pa.Array:
    """Return what ISO 8601 says, as instants in ns."""
    trimmed = pc.utf8_trim_whitespace(texts.cast(pa.string()))
    zoned = pc.match_substring_regex(trimmed, r"\d[T ]\d.*" + _ZONE)
    zone = bool(pc.any(zoned).as_py())
    try:
        return trimmed.cast(pa.timestamp("ns", tz="UTC") if zone else pa.timestamp("ns"))
    except pa.ArrowInvalid as error:
        odd = next((text for text in trimmed.to_pylist() if text is not None and not _is_iso(text, zone)), "")
        raise ForeignFileError(
            path,
            f"the column {name!r} has the text {odd[:40]!r}, which is no time as ISO 8601 has it"
            f"{' with a zone, as others in it have' if zone else ''}; pass time_column= to convert() for another one",
        ) from error


def _is_iso(text: str, zone: bool) -> bool:
    try:
        pa.array([text]).cast(pa.timestamp("ns", tz="UTC") if zone else pa.timestamp("ns"))
    except pa.ArrowInvalid:
        return False
    return True
