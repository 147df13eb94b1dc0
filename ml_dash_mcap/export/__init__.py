"""Rows in the formats of others: one module each, and a table of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from . import json_rows, jsonl, mcap, mocap, parquet
from .selection import Selection

FORMATS: Mapping[str, Callable[[Selection], Any]] = {
    "json": json_rows.render,
    "jsonl": jsonl.render,
    "mcap": mcap.render,
    "mocap": mocap.render,
    "parquet": parquet.render,
}
"""What `read(format=...)` takes, to what makes it of a selection."""

__all__ = ["FORMATS", "Selection"]
