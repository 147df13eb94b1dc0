"""Spells rows as JSON lines."""

from __future__ import annotations

from ....query.topic_part import Row, TopicPart
from ....rows.json_text import dumps, exact_as_read
from ....rows.plain_row import TIME_KEY

_NO_TIME = b',"_ts":null}'


def render(part: TopicPart, time_name: str = TIME_KEY) -> bytes:
    """Return one line a row, `{"_ts": s, "q": ...}`, without a newline after the last.

    Each line is valid JSON: a non-finite number is null, bytes are base64 text, and the side key `_exact` says which
    (`ml_dash_mcap.rows.plain_row` describes it).

    Args:
        part: The rows.
        time_name: The first key, that of the time stamp.
    """
    return b"\n".join(line(row) for row in part.flat_rows(time_name))


def line(row: Row) -> bytes:
    """Encode one flat row, whose time stamp comes first."""
    try:
        encoded = dumps(row)
    except TypeError:  # it has bytes, or lone surrogates
        return _exact_line(row)
    return _exact_line(row) if b"null" in encoded else encoded  # orjson writes NaN as null


def _exact_line(row: Row) -> bytes:
    """Encode a flat row with a side key; `exact_as_read` puts `_ts` last, so it is put in front afterwards."""
    fields = {name: value for name, value in row.items() if name != TIME_KEY}
    encoded = exact_as_read(fields).removesuffix(_NO_TIME) + b"}"
    return encoded if len(fields) == len(row) else dumps({TIME_KEY: row[TIME_KEY]})[:-1] + b"," + encoded[1:]
