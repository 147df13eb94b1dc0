"""Merges the rows of one topic and one time stamp; at the top level, later fields win."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


def merge(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Merge rows of one time stamp, the earliest first; associative, and the last one wins.

    Args:
        rows: Restored rows (no side key); none is changed.
    """
    merged: dict[str, Any] = {}
    for row in rows:
        merged.update(row)
    return merged
