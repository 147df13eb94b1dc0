"""Rows in the formats of others: one module each, and two tables of them."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

from ..errors import FormatError, UsageError
from ..inspect.topics import TopicInfo
from ..suggestions import did_you_mean
from . import mcap_rows
from .export_job import Job
from .mocap import mocap_dict
from .tables import row_entries
from .tables.jsonl import text as jsonl
from .tables.parquet import file_bytes
from .topic_part import Selection

FORMATS: Mapping[str, Callable[[Selection], Any]] = {
    "json": row_entries.render,
    "jsonl": jsonl.render,
    "mcap": mcap_rows.render,
    "mocap": mocap_dict.render,
    "parquet": file_bytes.render,
}
"""What `read(format=...)` takes, to what makes it of a selection."""

EXPORTERS: Mapping[str, str] = {
    "parquet": "tables.parquet.write",
    "csv": "tables.csv.write",
    "jsonl": "tables.jsonl.write",
    "dreamlake": "dreamlake",
    "mocap": "mocap.csv_layouts",
    "sto": "mocap.sto.write",
    "trc": "mocap.trc.write",
    "qtm": "mocap.qtm.write",
    "vicon": "mocap.vicon.write",
    "c3d": "mocap.c3d.write",
    "rosbag1": "ros.write_ros1",
    "rosbag2": "ros.write_ros2",
}
"""What `Recording.export(format=...)` takes, to the module here whose `export(job, **options)` does it."""

SUFFIXES: Mapping[str, str] = {
    ".bag": "rosbag1",
    ".parquet": "parquet",
    ".csv": "csv",
    ".jsonl": "jsonl",
    ".trc": "trc",
    ".sto": "sto",
    ".tsv": "qtm",
    ".c3d": "c3d",
}
"""What a destination's suffix says about its format, for `export` and `convert`."""

STREAMS: Mapping[str, str] = {"csv": "tables.csv.write", "jsonl": "tables.jsonl.write"}
"""What `TopicReader.write(format=...)` takes, to the module here whose `stream(selection, info, out)` does it."""


def export(job: Job, format: str, options: Mapping[str, Any]) -> Path:
    """Write a recording in another format; returns where the result is.

    Raises:
        FormatError: There is no such format.
        UsageError: The format has no such option.
    """
    module = EXPORTERS.get(format)
    if module is None:
        raise FormatError(f"export() knows no format {format!r}; {format_hint(format, EXPORTERS)}")
    write = import_module(f".{module}", __package__).export
    known = options_of(format)
    for name in options:
        if name not in known:
            what = f"it has {', '.join(known) or 'none'}. {did_you_mean(name, known, spelling='{}=')}".rstrip(" .")
            raise UsageError(f"export(format={format!r}) has no option {name!r}; {what}")
    result: Path = write(job, **options)
    return result


def options_of(format: str) -> list[str]:
    """Return the options that writing a format has; none if there is no such format."""
    if format not in EXPORTERS:
        return []
    parameters = inspect.signature(import_module(f".{EXPORTERS[format]}", __package__).export).parameters
    return [name for name, one in parameters.items() if one.kind is one.KEYWORD_ONLY]


def format_of(dest: Path) -> str:
    """Return the format that a destination's suffix says.

    Raises:
        FormatError: It says none; the message names all formats and suffixes.
    """
    named = SUFFIXES.get(dest.suffix.lower())
    if named is None:
        suffixes = ", ".join(f"{suffix} ({name})" for suffix, name in SUFFIXES.items())
        raise FormatError(
            f"{str(dest)!r} does not say which format to write: pass format=, one of {', '.join(sorted(EXPORTERS))};"
            f" or end it with {suffixes}"
        )
    return named


def format_hint(name: object, known: Iterable[str]) -> str:
    """Return what to say of a format that is not known: the one that was meant, and all there are."""
    return f"{did_you_mean(name, known)} the formats are {', '.join(sorted(known))}".strip()


def stream(selection: Selection, info: TopicInfo, out: BinaryIO, format: str) -> None:
    """Write rows to an open file or pipe.

    Raises:
        FormatError: There is no such format.
    """
    module = STREAMS.get(format)
    if module is None:
        raise FormatError(f"write() knows no format {format!r}; {format_hint(format, STREAMS)}")
    import_module(f".{module}", __package__).stream(selection, info, out)


__all__ = [
    "EXPORTERS",
    "FORMATS",
    "STREAMS",
    "SUFFIXES",
    "Job",
    "Selection",
    "export",
    "format_hint",
    "format_of",
    "options_of",
    "stream",
]
