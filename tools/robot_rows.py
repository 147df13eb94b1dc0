"""The rows that the benchmarks log and read: a robot arm's, 29 floats in 6 fields, all digits of each in use."""

from __future__ import annotations

from collections.abc import Iterator
from random import Random
from typing import Any

WIDTHS = {"q": 7, "qd": 7, "tau": 7, "ee_pos": 3, "ee_quat": 4, "gripper": 1}
SEED = 20_240
START_S = 1_700_000_000.0
PERIOD_S = 0.001
TOPICS = [f"arm{number}" for number in range(10)]
BLOCK_ROWS = 10_000  # rows in one append_columns()

SCHEMA: dict[str, Any] = {
    "title": "robot",
    "type": "object",
    "properties": {
        name: {"type": "array", "items": {"type": "number"}} if width > 1 else {"type": "number"}
        for name, width in WIDTHS.items()
    },
}

Row = tuple[Any, ...]  # the six fields, then t (s), t_ns, and the JSON bytes or None


def fresh_rows(count: int, *, ready: bool, per_tick: int = 1) -> Iterator[Row]:
    """Make rows, 1 ms (and a loop's jitter) apart; new floats and lists for every one.

    Args:
        count: How many rows.
        ready: Whether to make the JSON bytes too.
        per_tick: How many rows in turn have the same time.
    """
    rng = Random(SEED).random
    if ready:
        from orjson import dumps
    t = START_S
    for i in range(count):
        if i % per_tick == 0:
            t = START_S + i // per_tick * PERIOD_S + rng() * 1e-5
        q, qd, tau = [rng() for _ in range(7)], [rng() for _ in range(7)], [rng() for _ in range(7)]
        ee_pos, ee_quat, gripper = [rng() for _ in range(3)], [rng() for _ in range(4)], rng()
        encoded = None
        if ready:
            encoded = dumps(dict(zip(WIDTHS, (q, qd, tau, ee_pos, ee_quat, gripper), strict=True)))
        yield q, qd, tau, ee_pos, ee_quat, gripper, t, int(t * 1e9), encoded


def fresh_blocks(count: int, *, rows: int = BLOCK_ROWS) -> Iterator[Row]:
    """Make the same as arrays of some rows: q [N, 7], ..., gripper [N], t [N]."""
    import numpy

    rng = numpy.random.default_rng(SEED)
    for first in range(0, count, rows):
        size = min(rows, count - first)
        fields = [rng.random((size, width) if width > 1 else size) for width in WIDTHS.values()]
        yield *fields, START_S + numpy.arange(first, first + size) * PERIOD_S + rng.random(size) * 1e-5, None, None
