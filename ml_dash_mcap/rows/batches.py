"""Blocks of rows as tables of one size."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import pyarrow as pa

from .encode import TIME_KEY
from .table import Block, to_table


def of_size(
    blocks: Iterable[Block], rows: int, *, time_name: str = TIME_KEY, topic: str | None = None
) -> Iterator[pa.Table]:
    """Yield tables of `rows` rows, the last one of what is left.

    Args:
        blocks: One behind the other.
        rows: 1 or more.
        time_name: The column of time stamps.
        topic: For the tables' metadata.
    """
    waiting: list[Block] = []
    count = 0
    for block in blocks:
        at = 0
        while count + block.count - at >= rows:
            waiting.append(block.slice(at, rows - count))
            at += rows - count
            yield to_table(waiting, time_name=time_name, topic=topic)
            waiting, count = [], 0
        if at < block.count:
            waiting.append(block.slice(at, block.count - at))
            count += block.count - at
    if waiting:
        yield to_table(waiting, time_name=time_name, topic=topic)
