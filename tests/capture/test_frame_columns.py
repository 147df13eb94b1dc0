"""Frames of pandas, polars and pyarrow go in as they are, and come back so: gaps as None, rows by position."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ml_dash_mcap import Recorder, Recording
from tests.support.examples import examples

DATE = pd.Timestamp("2024-01-01T00:00:00.000000001Z")


def rows(folder: Path, **columns: Any) -> list[dict[str, Any]]:
    with Recorder(folder) as recorder:
        recorder.topic("table").append_columns(**columns)
    with Recording(folder) as recording:
        return list(recording["table"].rows())


COLUMNS: dict[str, tuple[Any, list[Any]]] = {
    "str": (pd.Series(["a", None, ""]), ["a", None, ""]),
    "object": (pd.Series(["a", np.nan, "c"], dtype=object), ["a", None, "c"]),
    "objects": (pd.Series([1, pd.NA, "c"], dtype=object), [1, None, "c"]),
    "string": (pd.Series(["a", pd.NA, "c"], dtype="string"), ["a", None, "c"]),
    "string[pyarrow]": (pd.Series(["a", None, "c"], dtype="string[pyarrow]"), ["a", None, "c"]),
    "Int64": (pd.Series([2**53 + 1, None, -3], dtype="Int64"), [2**53 + 1, None, -3]),
    "Int64 without gap": (pd.Series([2**53 + 1, 2, -3], dtype="Int64"), [2**53 + 1, 2, -3]),
    "Int8": (pd.array([1, None, -3], dtype="Int8"), [1, None, -3]),
    "UInt64": (pd.Series([2**64 - 1, None, 3], dtype="UInt64"), [2**64 - 1, None, 3]),
    "int64[pyarrow]": (pd.Series([2**53 + 1, None, 3], dtype="int64[pyarrow]"), [2**53 + 1, None, 3]),
    "double[pyarrow]": (pd.Series([0.5, 1.5, 2.5], dtype="double[pyarrow]"), [0.5, 1.5, 2.5]),
    "Float64": (pd.Series([0.5, None, 2.0], dtype="Float64"), [0.5, None, 2.0]),
    "boolean": (pd.Series([True, None, False], dtype="boolean"), [True, None, False]),
    "bool": (pd.Series([True, True, False]), [True, True, False]),
    "category": (pd.Series(["a", None, "c"], dtype="category"), ["a", None, "c"]),
    "category of integers": (pd.Series([7, 5, 7], dtype="category"), [7, 5, 7]),
    "datetime": (pd.Series([DATE, pd.NaT, DATE]), [DATE.isoformat(), None, DATE.isoformat()]),
    "timedelta": (
        pd.Series(pd.to_timedelta([1, None, 3], unit="ns")),
        ["P0DT0H0M0.000000001S", None, "P0DT0H0M0.000000003S"],
    ),
    "period": (pd.Series(pd.period_range("2024-01", periods=3, freq="M")), ["2024-01", "2024-02", "2024-03"]),
    "sparse": (pd.Series(pd.arrays.SparseArray([0, 0, 3])), [0, 0, 3]),
    "index": (pd.Index(["a", "b", "c"]), ["a", "b", "c"]),
    "range": (pd.RangeIndex(3), [0, 1, 2]),
    "lists": (pd.Series([[1, 2], None, [3]]), [[1, 2], None, [3]]),
    "frame": (pd.DataFrame({"x": [0.5, 1.5, 2.5], "y": [3, 4, 5]}), [[0.5, 3.0], [1.5, 4.0], [2.5, 5.0]]),
    "frame with a gap": (pd.DataFrame({"x": ["a", None, "c"], "y": [3, 4, 5]}), [["a", 3], [None, 4], ["c", 5]]),
    "polars text": (pl.Series(["a", None, "c"]), ["a", None, "c"]),
    "polars integers": (pl.Series([2**53 + 1, None, 3]), [2**53 + 1, None, 3]),
    "polars fractions": (pl.Series([0.5, 1.5, 2.5]), [0.5, 1.5, 2.5]),
    "pyarrow text": (pa.array(["a", None, "c"]), ["a", None, "c"]),
    "pyarrow chunks": (pa.chunked_array([[2**53 + 1], [2, 3]]), [2**53 + 1, 2, 3]),
    "pyarrow integers": (pa.array([2**53 + 1, None, 3]), [2**53 + 1, None, 3]),
    "pyarrow booleans": (pa.array([True, False, True]), [True, False, True]),
    "numpy times": (np.array(["2024-01-01", "NaT", "2024-01-02"], "M8[D]"), ["2024-01-01", None, "2024-01-02"]),
}


@pytest.mark.parametrize("name", COLUMNS)
def test_a_column_goes_in_as_it_is(tmp_path: Path, name: str) -> None:
    column, expected = COLUMNS[name]
    found = [row["x"] for row in rows(tmp_path / "run", _ts=np.arange(3.0), x=column)]
    assert [(type(one), one) for one in found] == [(type(one), one) for one in expected]


def test_nan_of_a_float_column_is_nan(tmp_path: Path) -> None:
    found = [row["x"] for row in rows(tmp_path / "run", _ts=np.arange(3.0), x=pd.Series([0.5, np.nan, 2.5]))]
    assert found[0::2] == [0.5, 2.5] and found[1] != found[1]


def test_a_filtered_frame_is_taken_by_position(tmp_path: Path) -> None:
    frame = pd.DataFrame({"t": [0.0, 1.0, 2.0, 3.0], "name": ["a", "b", None, "d"], "n": [0, 1, 2, 3]})
    chosen = frame[frame["n"] > 0].sort_values("t", ascending=False)
    found = rows(tmp_path / "run", _ts=chosen["t"], **chosen.drop(columns="t"))
    assert found == [
        {"name": "b", "n": 1, "_ts": 1.0},
        {"name": None, "n": 2, "_ts": 2.0},
        {"name": "d", "n": 3, "_ts": 3.0},
    ]


def test_times_may_be_of_a_nullable_type(tmp_path: Path) -> None:
    assert [row["_ts"] for row in rows(tmp_path / "run", _ts=pd.Series([1, 2], dtype="Int64"), x=[1, 2])] == [1.0, 2.0]


def test_a_dict_of_columns_is_a_dict_in_each_row(tmp_path: Path) -> None:
    inner = {"a": pd.Series([1, 2], index=[7, 8]), "b": pd.Series([0.5, 1.5], index=[7, 8])}
    found = rows(tmp_path / "run", _ts=[0.0, 1.0], x=inner)
    assert [row["x"] for row in found] == [{"a": 1, "b": 0.5}, {"a": 2, "b": 1.5}]


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (pd.NA, None),
        (pd.NaT, None),
        (np.datetime64("NaT"), None),
        ([1, pd.NA], [1, None]),
        ({"a": pd.NA, "b": [pd.NaT]}, {"a": None, "b": [None]}),
        (DATE, DATE.isoformat()),
        (pd.Timedelta("1s"), "P0DT0H0M1S"),
        (pd.Series(["a", None]), ["a", None]),
        (pd.Series([1, None], dtype="Int64"), [1, None]),
        (pd.Categorical(["a", None]), ["a", None]),
        (pl.Series([1, None]), [1, None]),
        (pa.array(["a", None]), ["a", None]),
        (datetime.date(2024, 1, 1), "2024-01-01"),
    ],
)
def test_append_takes_single_values_alike(tmp_path: Path, value: Any, expected: Any) -> None:
    with Recorder(tmp_path / "run") as recorder:
        recorder.topic("table").append(x=value, n=1, _ts=0.0)
    with Recording(tmp_path / "run") as recording:
        assert list(recording["table"].rows()) == [{"x": expected, "n": 1, "_ts": 0.0}]


CELLS: dict[str, st.SearchStrategy[Any]] = {
    "Int64": st.integers(-(2**63), 2**63 - 1),
    "UInt64": st.integers(0, 2**64 - 1),
    "boolean": st.booleans(),
    "string": st.text(st.characters(exclude_categories=["Cs"]), max_size=3),
    "Float64": st.floats(allow_nan=False, allow_infinity=False),
    "category": st.sampled_from("abc"),
    "object": st.text("xyz", max_size=2) | st.integers(0, 5),
}


@settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_a_frame_comes_back_as_it_was(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    count = data.draw(st.integers(1, 6))
    kinds = data.draw(st.lists(st.sampled_from(sorted(CELLS)), min_size=1, max_size=4, unique=True))
    cells = {kind: data.draw(st.lists(CELLS[kind] | st.none(), min_size=count, max_size=count)) for kind in kinds}
    labels = data.draw(st.permutations(range(count)))
    frame = pd.DataFrame({kind: pd.Series(cells[kind], dtype=kind, index=labels) for kind in kinds})
    folder = tmp_path_factory.mktemp("frame") / "run"
    found = rows(folder, _ts=np.arange(float(count)), **frame)
    assert found == [{**{kind: cells[kind][at] for kind in kinds}, "_ts": float(at)} for at in range(count)]
    with Recording(folder) as recording:
        back = recording["table"].to_pandas()
    for kind in kinds:
        column = back[kind].astype(object)
        assert [None if is_gap else one for one, is_gap in zip(column, column.isna(), strict=True)] == cells[kind]
