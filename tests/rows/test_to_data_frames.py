"""pandas, polars and numpy get what was recorded: what is missing changes nothing about what is there."""

from __future__ import annotations

import datetime
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ml_dash_mcap import Recorder, Recording
from ml_dash_mcap.errors import OptionError, UsageError
from tests.support.examples import examples

NS = 1_700_000_000_123_456_789
"""A double rounds it: by 21 ns."""


def recorded(folder: Path, rows: list[dict[str, Any]]) -> Recording:
    with Recorder(folder / "run") as recorder:
        recorder.topic("robot").append_batch([{"_ts": float(at), **row} for at, row in enumerate(rows)])
    return Recording(folder / "run")


def x(folder: Path, *values: Any) -> Any:
    return recorded(folder, [{} if value is ... else {"x": value} for value in values])["robot"]


@pytest.mark.parametrize(
    ("values", "dtype"),
    [
        ([NS, None, NS + 1], "Int64"),
        ([NS, ..., NS + 1], "Int64"),
        ([2**64 - 1, None, 3], "UInt64"),
        ([True, None, False], "boolean"),
        ([NS, NS + 1], "int64"),
        ([2**64 - 1, 3], "uint64"),
        ([True, False], "bool"),
    ],
)
def test_integers_and_booleans_with_a_gap_stay_exact(tmp_path: Path, values: list[Any], dtype: str) -> None:
    topic = x(tmp_path, *values)
    expected = [None if value is ... else value for value in values]
    column = topic.to_pandas()["x"]
    assert column.dtype == dtype
    assert [None if one is pd.NA else one for one in column.tolist()] == expected
    array = topic.to_numpy()["x"]
    assert array.tolist() == expected
    assert isinstance(array, np.ma.MaskedArray) == (None in expected)
    assert topic.to_polars()["x"].to_list() == expected


def test_vectors_of_integers_with_gaps_are_masked_arrays_and_arrays_of_objects(tmp_path: Path) -> None:
    values = [[NS, 1], [2, None], None, [3, NS]]
    topic = x(tmp_path, *values)
    array = topic.to_numpy()["x"]
    assert (array.shape, array.dtype) == ((4, 2), np.dtype(np.int64))
    assert array.tolist() == [[NS, 1], [2, None], [None, None], [3, NS]]
    cells = topic.to_pandas()["x"].tolist()
    assert [None if cell is None else cell.tolist() for cell in cells] == values
    assert topic.to_pandas(flatten=True)[["x.0", "x.1"]].dtypes.tolist() == ["Int64", "Int64"]


def test_a_missing_vector_of_whole_ones_is_masked(tmp_path: Path) -> None:
    array = x(tmp_path, [[NS], [2]], ..., [[3], [4]]).to_numpy()["x"]
    assert array.tolist() == [[[NS], [2]], [[None], [None]], [[3], [4]]]


def test_what_is_under_a_mask_shows_if_the_mask_is_taken_away(tmp_path: Path) -> None:
    assert np.asarray(x(tmp_path, 5, None).to_numpy()["x"])[1] == np.iinfo(np.int64).min


def test_integers_inside_dicts_of_a_list_stay_integers(tmp_path: Path) -> None:
    values = [[{"id": NS}, {"id": None}], [{"id": 3}]]
    assert x(tmp_path, *values).to_pandas()["x"].tolist() == values


def test_fractions_with_a_gap_are_nan(tmp_path: Path) -> None:
    topic = x(tmp_path, 1.5, None, 2.5)
    for found in (topic.to_numpy()["x"], topic.to_pandas()["x"].to_numpy()):
        assert found.dtype == np.float64 and found[0::2].tolist() == [1.5, 2.5] and math.isnan(found[1])


def test_text_with_a_gap_is_text(tmp_path: Path) -> None:
    for values in (["a", None, ""], ["a", ..., ""]):
        topic = x(tmp_path / str(len(values[1:2])) / str(values[1]), *values)
        assert topic.to_arrow()["x"].type == "string"
        assert topic.to_arrow()["x"].to_pylist() == ["a", None, ""]
        assert topic.to_pandas()["x"].isna().tolist() == [False, True, False]


def test_values_of_several_kinds_are_the_values(tmp_path: Path) -> None:
    values = [NS, 0.5, None, "x", [1, 2]]
    topic = x(tmp_path, *values)
    assert topic.to_numpy()["x"].tolist() == values
    assert topic.to_pandas()["x"].tolist() == values


def test_lists_that_are_always_empty_are_arrays_without_elements(tmp_path: Path) -> None:
    assert x(tmp_path / "a", [], []).to_numpy()["x"].shape == (2, 0)
    assert x(tmp_path / "b", [], None, []).to_numpy()["x"].shape == (3, 0)


def test_flatten_gives_the_columns_of_the_csv_file(tmp_path: Path) -> None:
    rows = [
        {"q": [0.5, 1.5], "pose": {"m": [[1, 2], [3, 4]], "frame": "base"}, "tags": ["a"], "q.0": 7},
        {"q": [2.5, None], "tags": ["b", "c"], "parts": [{"id": 1}]},
    ]
    rec = recorded(tmp_path, rows)
    frame = rec["robot"].to_pandas(flatten=True)
    file = rec.export(tmp_path / "robot.csv", format="csv")
    assert sorted(frame.columns) == sorted(pd.read_csv(file).columns)
    assert sorted(frame.columns) == sorted(rec["robot"].to_polars(flatten=True).columns)
    assert frame["pose.m.1.0"].tolist() == [3, pd.NA] and frame["pose.m.1.0"].dtype == "Int64"
    assert frame["tags.1"].isna().tolist() == [True, False]
    assert frame["parts"].tolist()[1] == [{"id": 1}]


def test_times_are_instants_in_utc_if_that_is_asked_for(tmp_path: Path) -> None:
    topic = recorded(tmp_path, [{"x": 1, "_ts": 1.7e9}, {"x": 2, "_ts": 1.7e9 + 0.25}])["robot"]
    frame = topic.to_pandas(time="datetime")
    assert isinstance(frame.index, pd.DatetimeIndex) and frame.index.name == "_ts" and list(frame.columns) == ["x"]
    assert str(frame.index.dtype) == "datetime64[ns, UTC]"
    assert frame.index.tolist() == [pd.Timestamp("2023-11-14T22:13:20Z"), pd.Timestamp("2023-11-14T22:13:20.25Z")]
    assert frame.resample("1s").sum()["x"].tolist() == [3]
    lazy = topic.to_polars(time="datetime")
    assert lazy.schema["_ts"] == pl.Datetime("ns", "UTC")
    assert lazy["_ts"][1] == datetime.datetime(2023, 11, 14, 22, 13, 20, 250000, datetime.timezone.utc)


def test_times_of_a_clock_near_0_can_be_spans(tmp_path: Path) -> None:
    topic = recorded(tmp_path, [{"x": 1}, {"x": 2, "_ts": 1.5}])["robot"]
    frame = topic.to_pandas(time="timedelta")
    assert isinstance(frame.index, pd.TimedeltaIndex)
    assert frame.index.tolist() == [pd.Timedelta(0), pd.Timedelta("1.5s")]
    assert topic.to_polars(time="timedelta")["_ts"].to_list()[1] == datetime.timedelta(seconds=1.5)


def test_without_rows_there_is_a_frame_without_rows(tmp_path: Path) -> None:
    topic = x(tmp_path, [1.0, 2.0])
    frame = topic.to_pandas(5.0, flatten=True, time="datetime")
    assert len(frame) == 0 and isinstance(frame.index, pd.DatetimeIndex)


def test_what_they_do_not_know_is_an_error(tmp_path: Path) -> None:
    topic = x(tmp_path, 1)
    with pytest.raises(OptionError, match="time='date': pass 'seconds', 'datetime', 'timedelta'"):
        topic.to_pandas(time="date")
    with pytest.raises(UsageError, match="flatten='yes': pass True or False"):
        topic.to_polars(flatten="yes")


KINDS = {
    "int": st.integers(-(2**63), 2**63 - 1),
    "uint": st.integers(0, 2**64 - 1),
    "bool": st.booleans(),
    "text": st.text(st.characters(exclude_categories=["Cs"]), max_size=4),
    "float": st.floats(allow_nan=False),
}


@settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data(), kind=st.sampled_from(sorted(KINDS)))
def test_any_column_with_gaps_is_what_its_rows_say(
    data: st.DataObject, kind: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    values = data.draw(st.lists(KINDS[kind] | st.none() | st.just(...), min_size=1, max_size=8))
    topic = x(tmp_path_factory.mktemp("run"), *values)
    expected = [None if value is ... else value for value in values]
    if all(value is ... for value in values):
        return
    found = {
        "numpy": topic.to_numpy()["x"].tolist(),
        "pandas": topic.to_pandas()["x"].astype(object).tolist(),
        "polars": topic.to_polars()["x"].to_list(),
    }
    for name, column in found.items():
        if name == "polars" and kind == "uint" and not all(-(2**63) <= (one or 0) < 2**64 for one in expected):
            continue
        assert [None if one is pd.NA or one != one else one for one in column] == expected, name
