"""The wide layout: every number of some topics, with its exact time stamp."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ml_dash_mcap.errors import ConversionError
from tests.formats.mocap.support import Rows, read_back, record
from tests.support.examples import examples

finite = st.floats(allow_nan=False, allow_infinity=False)


@st.composite
def topics(draw: st.DrawFn) -> Rows:
    high = draw(st.sampled_from([1.0, 1e6, 2e9]))
    drawn = st.lists(st.floats(0, high), min_size=1, max_size=8, unique_by=lambda time: int(time * 1e6))
    times = sorted(draw(drawn))
    vector = st.lists(finite, min_size=2, max_size=2)
    rows = [{"q": draw(vector), "m": draw(st.lists(vector, min_size=2, max_size=2)), "_ts": time} for time in times]
    return {"imu": [{"temp": draw(finite), "_ts": times[0]}], "robot": rows}


@settings(max_examples=examples(20), deadline=None)
@given(take=topics())
def test_any_times_and_numbers_come_back_bit_for_bit(take: Rows, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("take")
    with record(folder / "run", take) as recording:
        file = recording.export(folder / "x.csv", format="mocap", layout="wide")
    assert read_back(file, folder / "back") == take


def test_pandas_reads_it_as_one_table(tmp_path: Path) -> None:
    rows = {
        "imu": [
            {"accel": [1.0, 2.0, 9.8], "ok": step, "heat": step / 2, "name": "x", "_ts": 5.0 + step / 10}
            for step in range(3)
        ]
    }
    with record(tmp_path / "run", rows) as recording:
        table = pd.read_csv(recording.export(tmp_path / "x.csv", format="mocap", layout="wide"))
        again = pd.read_csv(recording.export(tmp_path / "y.csv", format="mocap", layout="wide", rate=20))
    assert list(table.columns) == ["frame", "time", "accel.0", "accel.1", "accel.2", "ok", "heat"]
    assert table["time"].tolist() == [5.0, 5.1, 5.2]
    assert again["heat"].tolist() == pytest.approx([0, 0.25, 0.5, 0.75, 1])
    assert again["ok"].tolist() == [0, 0, 1, 1, 2], "a whole number is held"


def test_a_topic_without_numbers_is_an_error(tmp_path: Path) -> None:
    rows = {"notes": [{"text": "x", "_ts": 0.0}]}
    with record(tmp_path / "run", rows) as recording, pytest.raises(ConversionError, match="no numbers in the topics"):
        recording.export(tmp_path / "x.csv", format="mocap", layout="wide")
