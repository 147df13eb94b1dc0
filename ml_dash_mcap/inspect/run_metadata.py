"""Reads from metadata records and statistics what a recording says of its run, its parameters and its times."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import orjson

from ..file_names import ABOUT_RECORD, PARAMETERS_RECORD, RUN_RECORD
from ..mcap import audit
from ..query.file import File


def metadata(files: Sequence[File]) -> list[tuple[str, dict[str, str]]]:
    """Return all metadata records, name and values, in the order of writing."""
    return [(record.name, dict(record.values)) for file in files for record in file.metadata()]


def run(files: Sequence[File]) -> dict[str, str]:
    """Return the run's metadata by name; the value that was recorded last counts."""
    merged: dict[str, str] = {}
    for file in files:
        if any(entry.name == RUN_RECORD for entry in file.glance.metadata):
            for record in file.metadata():
                if record.name == RUN_RECORD:
                    merged.update(record.values)
    return merged


def parameters(files: Sequence[File]) -> dict[str, Any]:
    """Return the parameters by dotted name; the value that was set last counts."""
    parameters_by_name: dict[str, Any] = {}
    for name, values in metadata(files):
        if name == ABOUT_RECORD:  # each segment repeats what was set before it
            repeated = _from_json(values.get("parameters", "{}"))
            parameters_by_name.update(repeated if isinstance(repeated, dict) else {})
        elif name == PARAMETERS_RECORD:
            parameters_by_name.update({name: _from_json(text) for name, text in values.items()})
    return parameters_by_name


def spans(files: Sequence[File]) -> list[tuple[int, int]]:
    """Return the first and last log time, in ns, of each file that has messages."""
    return [span for span in (audit.span(file) for file in files) if span is not None]


def _from_json(text: str) -> Any:
    """Return the value of a parameter's text, which is JSON or a literal such as NaN; any other text stays as it is."""
    try:
        return orjson.loads(text)
    except orjson.JSONDecodeError:
        pass
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text
