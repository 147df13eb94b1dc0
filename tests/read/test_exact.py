"""Columns stand for rows only where they say exactly the same."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ml_dash_mcap.options import RecorderOptions
from ml_dash_mcap.query import exact_blocks
from ml_dash_mcap.query.stored_topic import StoredTopic
from ml_dash_mcap.recorder import Recorder
from ml_dash_mcap.recording import Recording
from ml_dash_mcap.rows.table import Block
from tests.support.examples import examples
from tests.support.row_shapes import tables, typed

Row = dict[str, Any]


def parts_of(folder: Path, low: float = -1.0, high: float = 1e9) -> list[Block | list[Row]]:
    with Recording(folder) as recording:
        return list(exact_blocks.read(StoredTopic(recording._opened(), "t"), low, high))


def as_rows(parts: list[Block | list[Row]]) -> list[Row]:
    """Unfold blocks in the plain way."""
    found: list[Row] = []
    for part in parts:
        if isinstance(part, list):
            found += part
            continue
        names = list(part.columns)
        for values in zip(*(part.columns[name].array.to_pylist() for name in names), strict=True):
            row: Row = {}
            for name, value in zip(names, values, strict=True):
                *path, last = name.split(".")
                inner = row
                for key in path:
                    inner = inner.setdefault(key, {})
                inner[last] = value
            found.append(row)
    return found


@given(tables(), st.integers(1, 3), st.booleans())
@settings(max_examples=examples(30), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_rows_come_back_exactly(
    tmp_path_factory: pytest.TempPathFactory, rows: list[Row], repeats: int, buffered: bool
) -> None:
    folder = tmp_path_factory.mktemp("exact")
    rows = [{**row, "_ts": 0.1 * number} for number, row in enumerate(rows * repeats)]
    with Recorder(folder, RecorderOptions(buffered=buffered)) as recorder:
        recorder.topic("t").append_batch(rows)
    assert typed(as_rows(parts_of(folder))) == typed(rows)


def test_numbers_come_as_columns(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        times = np.arange(5000) / 100
        recorder.topic("t").append_columns(_ts=times, q=np.ones((5000, 7)), n=np.arange(5000))
    parts = parts_of(tmp_path, 1.0, 2.0)
    assert [type(part) for part in parts] == [Block] * len(parts)
    assert [row["_ts"] for row in as_rows(parts)] == [number / 100 for number in range(100, 201)]


@pytest.mark.parametrize(
    "row",
    [
        {"x": 0, "y": 0.5},
        {"x": None, "y": 0.5},
        {"y": 0.5},
        {"x": 1.0, "y": 0.5, "a.b": 1.0},
        {"x": float("nan"), "y": 0.5},
        {"x": b"\0", "y": 0.5},
        {"x": 1.0, "y": 0.5, "e": {}},
    ],
)
def test_a_row_that_columns_cannot_say_comes_as_a_row(tmp_path: Path, row: Row) -> None:
    rows = [{"x": 0.5, "y": 0.5, "_ts": 1.0}, {**row, "_ts": 2.0}]
    with Recorder(tmp_path) as recorder:
        recorder.topic("t").append_batch(rows)
    parts = parts_of(tmp_path)
    assert [type(part) for part in parts] == [list]
    assert typed(parts) == typed([rows])


def test_rows_of_one_time_stamp_are_merged_across_chunks(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        topic = recorder.topic("t")
        topic.append(x=0.5, _ts=1.0).flush()
        topic.append(y=0.5, _ts=1.0).append(x=0.25, y=0.25, _ts=0.5)
    assert as_rows(parts_of(tmp_path)) == [{"x": 0.25, "y": 0.25, "_ts": 0.5}, {"x": 0.5, "y": 0.5, "_ts": 1.0}]
