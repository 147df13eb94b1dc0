"""Renders what `read(format=...)` of a track returns: ml-dash's bytes where those of a recording's `read` differ.

In ml-dash's bytes the time stamp is called `timestamp`, as in its dict of entries, and its Parquet file is flat.
"""

from __future__ import annotations

from typing import Any

from ..formats.registry import load
from ..formats.tables.row_entries import TIME_NAME
from ..formats.writers import render
from ..query.topic_part import TopicPart


def render_track(part: TopicPart, format: str) -> Any:
    """Return a track's rows in a format.

    Raises:
        FormatError: ml-dash's "Unsupported format".
    """
    if format == "jsonl":
        return load("tables.jsonl.text:render")(part, TIME_NAME)
    if format == "parquet":
        return load("tables.parquet.file_bytes:render")(part)
    return render(part, format)
