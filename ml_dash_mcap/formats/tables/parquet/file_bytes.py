"""Rows as the Parquet file that ml-dash's `read` returns."""

from __future__ import annotations

from typing import cast

from ....query.topic_part import TopicPart
from ..row_entries import TIME_NAME


def render(part: TopicPart) -> bytes:
    """Return a Parquet file (zstd) with the column `timestamp`, a double in seconds, first.

    Nested dicts are dotted columns; what a row does not have is null. `ml_dash_mcap.rows.table` says which types the
    columns get.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    from ....rows.table import to_table

    table = to_table(list(part.blocks(TIME_NAME)), time_name=TIME_NAME, topic=part.topic)
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd")
    return cast(bytes, sink.getvalue().to_pybytes())
