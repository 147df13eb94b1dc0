"""Rows as a table at once, for tests of what tables are."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice
from typing import Any

import pyarrow as pa

from ml_dash_mcap.rows.plain_row import TIME_KEY
from ml_dash_mcap.rows.table import BLOCK_ROWS, block_of, to_table


def from_rows(rows: Iterable[dict[str, Any]], *, time_name: str = TIME_KEY) -> pa.Table:
    """Return flat rows as a table, by blocks of as many as readers make."""
    rows = iter(rows)
    blocks = []
    while block := list(islice(rows, BLOCK_ROWS)):
        blocks.append(block_of(block))
    return to_table(blocks, time_name=time_name)
