"""Rows as a dict of entries."""

from __future__ import annotations

from ...query.topic_part import TopicPart
from ...rows.result_dicts import Entries

TIME_NAME = "timestamp"
"""The key of a row's time in ml-dash's entries."""


def render(part: TopicPart) -> Entries:
    """Return `{"entries": [{"timestamp": s, "q": ...}, ...], "count": n}`.

    Nested dicts come back with dotted names; fields that a row does not have are absent from it; non-finite numbers
    are Python's floats and bytes are bytes.
    """
    entries = list(part.flat_rows(TIME_NAME))
    return {"entries": entries, "count": len(entries)}
