"""The options of reading and writing tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ...errors import OptionError, UsageError
from ..text.headers import check_on_bad


@dataclass(frozen=True, kw_only=True)
class TableReadOptions:
    """How tables of any tool are read, and all there is to say of JSON lines."""

    time_column: str | None = None
    """The column or key of times; found by its name and type by default, see `table_times`."""
    time_unit: Literal["s", "ms", "us", "ns"] | None = None
    """What its numbers count; by default what the column's type, metadata or name says, or what is plain from numbers
    of wall-clock time (of JSON lines those of the first 1,000 rows); seconds for other fractions."""
    topic: str | None = None
    """The name of the topic; by default the name that the file states, or else the file's name."""
    start: float = 0.0
    """The time stamp of the table's time 0, in s."""
    on_bad: Literal["raise", "missing"] = "raise"
    """What to do with rows without a time, with lines that are no JSON object, and with rows of CSV that have fewer
    cells than the header: "raise", or "missing" to take the cells that are there and leave out rows without a time."""

    def __post_init__(self) -> None:
        check_on_bad(self.on_bad)


@dataclass(frozen=True, kw_only=True)
class CsvReadOptions(TableReadOptions):
    """How CSV files are read."""

    separator: str | None = None
    """What stands between cells; by default that of `,`, `;`, tab and `|` of which all rows have the same number."""
    decimal: Literal[".", ","] | None = None
    """What stands before the fraction; found out by default, and never "," where that separates."""
    encoding: str = "utf-8"
    """The encoding of the text. A byte order mark at the file's beginning comes first."""

    def __post_init__(self) -> None:
        is_text = self.separator is None or isinstance(self.separator, str)
        if not is_text or (self.separator is not None and not _is_separator(self.separator)):
            raise OptionError(f"separator={self.separator!r}: pass one letter, such as ';'")
        if self.decimal not in (None, ".", ","):
            raise OptionError(f"decimal={self.decimal!r}: pass '.' or ','")
        super().__post_init__()


@dataclass(frozen=True, kw_only=True)
class ParquetReadOptions(TableReadOptions):
    """How Parquet files are read."""

    on_damage: Literal["raise", "skip"] = "raise"
    """What to do if a row group is damaged: "raise", or "skip" to leave out the rest of it and warn."""

    def __post_init__(self) -> None:
        if self.on_damage not in ("raise", "skip"):
            raise OptionError(f"on_damage={self.on_damage!r}: it must be 'raise' or 'skip'")
        super().__post_init__()


@dataclass(frozen=True, kw_only=True)
class ParquetWriteOptions:
    """How Parquet files are written."""

    flatten: bool = False
    """Make each element of a vector a column of its own, `q.0`, `q.1`, ..., and nested dicts columns with dotted names,
    for tools that plot columns."""

    def __post_init__(self) -> None:
        if not isinstance(self.flatten, bool):
            raise UsageError(f"flatten={self.flatten!r}: pass True or False")


def _is_separator(text: str) -> bool:
    return len(text.encode()) == 1 and text not in '"\r\n'
