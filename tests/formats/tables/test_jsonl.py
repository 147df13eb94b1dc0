"""JSON lines become a recording: ours as the rows that they were, those of others object by object."""

from __future__ import annotations

import json
import math
import tempfile
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ml_dash_mcap import Recorder, Recording, convert
from ml_dash_mcap.errors import ConversionWarning, ForeignFileError, UsageError
from ml_dash_mcap.formats.tables.jsonl import read as jsonl
from tests.formats.tables.test_parquet import normal, rows
from tests.support.examples import examples
from tests.support.row_shapes import typed


def written(folder: Path, *lines: Any, name: str = "table.jsonl") -> Path:
    texts = [line if isinstance(line, str) else json.dumps(line, ensure_ascii=False) for line in lines]
    (folder / name).write_text("\n".join(texts) + "\n", encoding="utf-8")
    return folder / name


def test_each_object_is_a_row_with_all_that_it_says(tmp_path: Path) -> None:
    lines = [
        {"t": 0.5, "x": None, "a.b": {"c": [1, None, "ü"]}, "on": True},
        {"t": 0.5, "n": 2**64 - 1},
        '{"t": 1, "x": NaN}',
    ]
    found = rows(written(tmp_path, *lines[:1], "", *lines[1:]))
    assert typed(found[:2]) == typed(
        [{"x": None, "a.b": {"c": [1, None, "ü"]}, "on": True, "_ts": 0.5}, {"n": 2**64 - 1, "_ts": 0.5}]
    )
    assert math.isnan(found[2]["x"]) and found[2]["_ts"] == 1.0


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("timestamp", 1_700_000_000_500, 1_700_000_000.5),
        ("time_ns", 1_500_000_000, 1.5),
        ("ts", "2024-01-01T00:00:00.25Z", 1_704_067_200.25),
    ],
)
def test_what_is_no_time_in_seconds_stays_a_field(tmp_path: Path, name: str, value: Any, expected: float) -> None:
    assert rows(written(tmp_path, {name: value, "x": 1})) == [{name: value, "x": 1, "_ts": expected}]


@pytest.mark.parametrize(
    ("lines", "what"),
    [
        (['{"t": 0.5, "x": 1}', "", '{"t": 0.5'], "line 3: the line is no JSON"),
        (['{"t": 0.5, "x": 1}', "[1, 2]"], r"line 2: the line is '\[1, 2\]', which is no JSON object"),
        (['{"t": 0.5, "x": 1}', '{"x": 2}'], "line 2: the time is None under the key 't'.*on_bad='missing'"),
        (['{"t": -0.5, "x": 1}'], "line 1: the time is -0.5.*pass start="),
        (['{"a": 0.5, "b": "x"}'], r"pass time_column= to convert\(\), one of a \(double\), b \(string\)"),
        (['{"t": 5, "x": 1}'], "the integers 5 to 5.*pass time_unit="),
    ],
)
def test_what_is_wrong_is_said_with_its_line(tmp_path: Path, lines: list[str], what: str) -> None:
    with pytest.raises(ForeignFileError, match=f"table.jsonl.*{what}"):
        convert(written(tmp_path, *lines), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_what_is_no_row_can_be_left_out(tmp_path: Path) -> None:
    path = written(tmp_path, {"t": 0.5, "x": 1}, "oops", {"x": 2}, {"t": 1.5, "x": 3})
    with pytest.warns(ConversionWarning, match="2 lines without a row or a time were left out"):
        convert(path, tmp_path / "run", on_bad="missing")
    assert [row["x"] for row in rows(tmp_path / "run")] == [1, 3]


def test_a_file_without_rows_says_so(tmp_path: Path) -> None:
    with pytest.warns(ConversionWarning, match=r"table\.jsonl: the file has no rows"):
        convert(written(tmp_path, "", ""), tmp_path / "run")
    with Recording(tmp_path / "run") as recording:
        assert list(recording.topics) == []


def test_options_say_what_the_file_does_not(tmp_path: Path) -> None:
    path = written(tmp_path, {"when": 500, "_ts": 1, "x": 2})
    convert(path, tmp_path / "run", time_column="when", time_unit="ms", topic="arm", start=1.0)
    with Recording(tmp_path / "run") as recording:
        assert list(recording["arm"].rows()) == [{"when": 500, "fields._ts": 1, "x": 2, "_ts": 1.5}]
    with pytest.raises(UsageError, match="has no option 'tme'"):
        convert(path, tmp_path / "no", tme=1)


def test_a_field_timestamp_before_ts_is_not_the_time(tmp_path: Path) -> None:
    path = tmp_path / "t.jsonl"
    path.write_bytes(b'{"timestamp":1700000000,"x":0,"_ts":0.1}\n{"timestamp":1700000001,"x":1,"_ts":1}\n')
    assert rows(path) == [
        {"timestamp": 1_700_000_000, "x": 0, "_ts": 0.1},
        {"timestamp": 1_700_000_001, "x": 1, "_ts": 1.0},
    ]


def test_a_ts_that_comes_late_in_a_file_of_an_earlier_release_is_kept_as_a_field(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jsonl, "_SAMPLE", 1)
    path = tmp_path / "t.jsonl"
    path.write_bytes(b'{"timestamp":0.5,"p.x":0}\n{"timestamp":1.5,"fields.timestamp":7,"_ts":3}\n')
    assert rows(path) == [{"p": {"x": 0}, "_ts": 0.5}, {"timestamp": 7, "fields._ts": 3, "_ts": 1.5}]


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_tables_with_a_column_timestamp_before_ts_keep_both(tmp_path: Path, suffix: str) -> None:
    frame = pd.DataFrame({"timestamp": [1_700_000_000, 1_700_000_001], "x": [0, 1], "_ts": [0.1, 0.2]})
    path = tmp_path / f"t.{suffix}"
    frame.to_csv(path, index=False) if suffix == "csv" else frame.to_parquet(path, index=False)
    assert rows(path) == [
        {"timestamp": 1_700_000_000, "x": 0, "_ts": 0.1},
        {"timestamp": 1_700_000_001, "x": 1, "_ts": 0.2},
    ]


def test_pandas_writes_what_is_read(tmp_path: Path) -> None:
    frame = pd.DataFrame({"time": [0.5, 1.5], "x": [1, 2], "s": ["a", None]})
    frame.to_json(tmp_path / "t.jsonl", orient="records", lines=True)
    assert rows(tmp_path / "t.jsonl") == [{"x": 1, "s": "a", "_ts": 0.5}, {"x": 2, "s": None, "_ts": 1.5}]


@pytest.mark.parametrize("size", [1, 100])
def test_the_rows_are_the_same_however_many_are_taken_at_a_time(
    tmp_path: Path, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jsonl, "_BATCH_BYTES", size)
    path = written(tmp_path, *({"t": at / 2, "x": at} for at in range(50)))
    assert rows(path) == [{"x": at, "_ts": at / 2} for at in range(50)]


OWN = st.fixed_dictionaries(
    {},
    optional={
        "v": st.lists(st.floats() | st.none() | st.integers(-5, 5), max_size=3),
        "s": st.text(st.characters(exclude_categories=["Cs"]), max_size=5),
        "raw": st.binary(max_size=4),
        "p": st.fixed_dictionaries({"x": st.floats()}, optional={"y": st.none() | st.text("ab"), "z": st.binary(max_size=2)}),
        "odd": st.integers(0, 3) | st.text("xy") | st.none() | st.just({}),
        "timestamp": st.integers(0, 5),
    },
)  # fmt: skip


@settings(max_examples=examples(40), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(drawn=st.lists(OWN, min_size=1, max_size=6))
def test_any_rows_of_ours_come_back(drawn: list[dict[str, Any]]) -> None:
    given_rows = [{**row, "_ts": at / 8} for at, row in enumerate(drawn)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with Recorder(folder / "run") as recorder:
            recorder.topic("robot/arm").append_batch(given_rows)
        with (
            Recording(folder / "run") as recording,
            Recording(recording.export(folder / "out", format="jsonl")) as back,
        ):
            found = list(back["robot/arm"].rows())
    assert typed(normal(found)) == typed(normal(given_rows))
