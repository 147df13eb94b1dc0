"""Rows as a dict of entries."""

from __future__ import annotations

from ...rows.result_dicts import Entries
from ..topic_part import Selection

TIME_NAME = "timestamp"
"""What ml-dash calls a row's time."""


def render(selection: Selection) -> Entries:
    """Return `{"entries": [{"timestamp": s, "q": ...}, ...], "count": n}`.

    Nested dicts come back with dotted names; fields that a row does not have are absent from it; non-finite numbers
    are Python's floats and bytes are bytes.
    """
    entries = list(selection.flat_rows(TIME_NAME))
    return {"entries": entries, "count": len(entries)}
