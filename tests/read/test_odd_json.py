"""JSON of others that is odd is what `json.loads` says it is, in rows and in columns, and never ends the process."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from ml_dash_mcap import Recording
from tests.support import odd_json

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(("first", "count"), [(0, 0), (1000, 60)])
def test_every_path_over_columns_gives_what_json_says_and_none_crashes(first: int, count: int) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tests.support.odd_json", str(first), str(count)],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False, timeout=100,
    )  # fmt: skip
    assert done.returncode == 0, f"exit code {done.returncode}: {done.stdout[-500:]}{done.stderr[-2000:]}"


def test_a_payload_that_is_null_is_a_row_and_not_the_end_of_the_process(tmp_path: Path) -> None:
    odd_json.write(tmp_path / "a.mcap", [b"null", b'{"a":1}', b"null"])
    with Recording(tmp_path / "a.mcap") as recording:
        table = recording[odd_json.TOPIC].to_arrow()
    assert table.to_pydict() == {"_ts": [1.0, 1.25, 1.5], "value": [None] * 3, "a": [None, 1, None]}


def test_text_with_lone_surrogates_comes_back_from_columns_and_lines(tmp_path: Path) -> None:
    odd_json.write(tmp_path / "a.mcap", [b'{"a":"\\ud800x"}', b'{"a":"y"}'])
    with Recording(tmp_path / "a.mcap") as recording:
        reader = recording[odd_json.TOPIC]
        assert [row["a"] for row in reader.rows()] == ["\ud800x", "y"]
        assert reader.to_arrow().column("a").to_pylist() == ['"\\ud800x"', '"y"']
        assert reader.to_numpy()["a"].tolist() == ["\ud800x", "y"]
        assert reader.read(format="jsonl") == b'{"_ts":1.0,"a":"\\ud800x"}\n{"_ts":1.25,"a":"y"}'
        recording.export(tmp_path / "csv", format="csv")
    (csv,) = (tmp_path / "csv").rglob("*.csv")
    assert csv.read_text().splitlines() == ["_ts,a", "1.0,\\ud800x", "1.25,y"]


def test_an_integer_beyond_64_bits_is_the_nearest_double_beside_nan_too(tmp_path: Path) -> None:
    odd_json.write(tmp_path / "a.mcap", [b'{"a":123456789012345678901}', b'{"a":123456789012345678901,"b":NaN}'])
    with Recording(tmp_path / "a.mcap") as recording:
        assert recording[odd_json.TOPIC].to_arrow().column("a").to_pylist() == [1.2345678901234568e20] * 2


@pytest.mark.parametrize("depth", [10, 18, 19, 20, 45, 50, 90, 120])
@pytest.mark.parametrize(("begin", "end"), [(b'{"a":', b"}"), (b"[", b"]"), (b'[{"a":', b"}]")])
def test_values_however_deep_make_a_parquet_file_that_pyarrow_reads(
    tmp_path: Path, depth: int, begin: bytes, end: bytes
) -> None:
    payload = b'{"a":' + begin * depth + b"1" + end * depth + b"}"
    odd_json.write(tmp_path / "a.mcap", [payload, payload])
    with Recording(tmp_path / "a.mcap") as recording:
        recording.export(tmp_path / "out", format="parquet")
        (whole,) = recording[odd_json.TOPIC].to_arrow().column_names[1:]
        pq.read_table(io.BytesIO(recording[odd_json.TOPIC].read(format="parquet")))
    (path,) = (tmp_path / "out").rglob("*.parquet")
    assert pq.read_table(path).num_rows == 2
    assert whole == "a" if begin != b'{"a":' else whole == ".".join("a" * (depth + 1))
