"""Rows as JSON, one a line."""

from __future__ import annotations

from ....query.topic_part import Row, TopicPart
from ....rows.json_text import dumps, exact_as_read
from ..row_entries import TIME_NAME

_NO_TIME = b',"_ts":null}'


def render(part: TopicPart) -> bytes:
    """Return one line a row, `{"timestamp": s, "q": ...}`, without a newline after the last.

    Each line is valid JSON: a non-finite number is null, bytes are base64 text, and the side key `_exact` says which
    (`ml_dash_mcap.rows.encode` describes it).
    """
    return b"\n".join(line(row) for row in part.flat_rows(TIME_NAME))


def line(row: Row) -> bytes:
    """Encode one flat row."""
    try:
        encoded = dumps(row)
    except TypeError:  # it has bytes, or lone surrogates
        return _exact_line(row)
    return _exact_line(row) if b"null" in encoded else encoded  # orjson writes NaN as null


def _exact_line(row: Row) -> bytes:
    return exact_as_read(row).removesuffix(_NO_TIME) + b"}"
