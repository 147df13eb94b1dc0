"""Rows as a Parquet file."""

from __future__ import annotations

from typing import cast

from ...topic_part import Selection
from ..row_entries import TIME_NAME


def render(selection: Selection) -> bytes:
    """Return a Parquet file (zstd) with the column `timestamp`, a double in seconds, first.

    Nested dicts are dotted columns; what a row does not have is null. `ml_dash_mcap.rows.table` says which types the
    columns get.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    from ....rows.table import to_table

    table = to_table(list(selection.blocks(TIME_NAME)), time_name=TIME_NAME, topic=selection.topic)
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd")
    return cast(bytes, sink.getvalue().to_pybytes())
