"""Rows in the formats of others: one module each, and two tables of them."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

from ..errors import FormatError, UsageError
from ..read.topics import TopicInfo
from ..suggestions import did_you_mean
from . import json_rows, jsonl, mcap, mocap, parquet
from .job import Job
from .selection import Selection

FORMATS: Mapping[str, Callable[[Selection], Any]] = {
    "json": json_rows.render,
    "jsonl": jsonl.render,
    "mcap": mcap.render,
    "mocap": mocap.render,
    "parquet": parquet.render,
}
"""What `read(format=...)` takes, to what makes it of a selection."""

EXPORTERS: Mapping[str, str] = {
    "parquet": "parquet_files",
    "csv": "csv_files",
    "jsonl": "jsonl_files",
    "dreamlake": "dreamlake",
    "mocap": "mocap_files",
    "sto": "sto",
    "trc": "trc",
    "qtm": "qtm",
    "vicon": "vicon",
    "c3d": "c3d",
    "rosbag1": "rosbag1",
    "rosbag2": "rosbag2",
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

STREAMS: Mapping[str, str] = {"csv": "csv_files", "jsonl": "jsonl_files"}
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
    write = import_module(f".{module}", __name__).export
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
    parameters = inspect.signature(import_module(f".{EXPORTERS[format]}", __name__).export).parameters
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
    import_module(f".{module}", __name__).stream(selection, info, out)


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
