"""Parquet files hold what was recorded, typed, for every reader of Parquet."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import orjson
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ml_dash_mcap import Recorder, Recording
from ml_dash_mcap.errors import UsageError
from ml_dash_mcap.query import topic_columns
from ml_dash_mcap.rows.dotted import flatten
from ml_dash_mcap.rows.json_text import exact
from ml_dash_mcap.rows.typed_columns import ENCODING_KEY, Column, values_of
from tests.read.test_columns import ROWS
from tests.support.examples import examples
from tests.support.files import save

Rows = Sequence[Mapping[str, Any]]


@pytest.fixture(autouse=True, scope="module")
def _a_block_a_chunk() -> Iterator[None]:
    """Read each chunk by itself, so that a few rows are many blocks."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(topic_columns, "_FIRST_BYTES", 1)
        patch.setattr(topic_columns, "_MOST_BYTES", 1)
        yield


def recording(folder: Path, *chunks: Rows, **how: Any) -> Recording:
    """A recording whose topic `robot` lies in these chunks: each is a block for the exporter."""
    encoded = [{"robot": [orjson.loads(exact(dict(row), "robot")) for row in rows]} for rows in chunks]
    return Recording(save(folder / "run.mcap", encoded, **how))


def exported(rec: Recording, **options: Any) -> Path:
    return rec.export(rec.path.parent / "robot.parquet", format="parquet", topics=["robot"], **options)


def steps(count: int, start: float = 0.0, **fields: Any) -> list[dict[str, Any]]:
    return [{**fields, "_ts": start + step / 8} for step in range(count)]


def test_a_topic_is_a_typed_table_in_time_order(tmp_path: Path) -> None:
    row = {
        "q": [0.5, 1.5, 2.5],
        "pose": {"xyz": [1.0, 2.0, 3.0], "frame": "base"},
        "m": [[1.0, 2.0], [3.0, 4.0]],
        "n": 3,
        "on": True,
        "raw": b"\x00",
        "tags": ["a", "b"],
    }
    rec = recording(tmp_path, steps(2, 0.5, **row), steps(2, 0.0, **row))
    table = pq.read_table(exported(rec))
    assert [(field.name, field.type) for field in table.schema] == [
        ("_ts", pa.float64()),
        ("timestamp_ns", pa.int64()),
        ("q", pa.list_(pa.float64(), 3)),
        ("pose", pa.struct([("xyz", pa.list_(pa.float64(), 3)), ("frame", pa.string())])),
        ("m", pa.list_(pa.float64(), 4)),
        ("n", pa.int64()),
        ("on", pa.bool_()),
        ("raw", pa.binary()),
        ("tags", pa.list_(pa.string())),
    ]
    assert table["_ts"].to_pylist() == [0.0, 0.125, 0.5, 0.625]
    assert table["timestamp_ns"].to_pylist() == [0, 125_000_000, 500_000_000, 625_000_000]
    assert table.to_pylist()[0] == {**row, "m": [1.0, 2.0, 3.0, 4.0], "_ts": 0.0, "timestamp_ns": 0}
    assert table.schema.field("m").metadata == {b"ml_dash.shape": b"[2,2]"}


def test_wall_clock_times_are_instants_beside_the_exact_doubles(tmp_path: Path) -> None:
    times = [1.7e9 + step / 3 for step in range(4)]
    rec = recording(tmp_path, [{"n": 1, "_ts": time} for time in times])
    path = exported(rec)
    table = pq.read_table(path)
    assert table.schema.field("timestamp").type == pa.timestamp("ns", tz="UTC")
    assert table["_ts"].to_pylist() == times
    said = table["timestamp"].cast(pa.int64()).to_pylist()
    assert all(abs(ns - time * 1e9) <= 256 for ns, time in zip(said, times, strict=True))
    assert pd.read_parquet(path)["timestamp"][0] == pd.Timestamp("2023-11-14T22:13:20Z")
    assert pl.read_parquet(path).schema["timestamp"] == pl.Datetime("ns", "UTC")
    assert duckdb.sql(f"select epoch_ns(timestamp) // 1000 from '{path}'").fetchall() == [(ns // 1000,) for ns in said]


READERS = {
    "pandas": lambda path: pd.read_parquet(path).to_dict("records"),
    "polars": lambda path: pl.read_parquet(path).to_dicts(),
    "duckdb": lambda path: duckdb.sql(f"select * from '{path}'").to_arrow_table().to_pylist(),
}


def plain(value: Any) -> Any:
    """What a reader gives for a value, as Python's own; all that is missing is None."""
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(element) for element in value]
    if isinstance(value, dict):
        return {key: plain(inner) for key, inner in value.items()}
    return None if isinstance(value, float) and math.isnan(value) else value


@pytest.mark.parametrize("flat", [False, True], ids=["nested", "flat"])
@pytest.mark.parametrize("reader", READERS)
def test_other_readers_see_the_values_and_what_is_missing(tmp_path: Path, reader: str, flat: bool) -> None:
    first = {"q": [0.5, 1.5], "p": {"xyz": [1.0, 2.0], "frame": "base"}, "n": 1, "nothing": None, "tags": []}
    second = {"n": 2.5, "p": None, "late": "x", "tags": ["a"], "m": [[1.0, 2.0], [3.0, 4.0]]}
    path = exported(recording(tmp_path, steps(1, 0.0, **first), steps(1, 1.0, **second)), flatten=flat)
    flat_first = {"q.0": 0.5, "q.1": 1.5, "p.xyz.0": 1.0, "p.xyz.1": 2.0, "p.frame": "base", "n": 1.0, "tags": []}
    flat_second = {"n": 2.5, "late": "x", "tags": ["a"], "m.0.0": 1.0, "m.0.1": 2.0, "m.1.0": 3.0, "m.1.1": 4.0}
    names = {**flat_first, **flat_second, "nothing": None} if flat else {**first, **second}
    times: list[dict[str, Any]] = [{"_ts": 0.0, "timestamp_ns": 0}, {"_ts": 1.0, "timestamp_ns": 10**9}]
    wanted = [flat_first, flat_second] if flat else [first, {**second, "m": [1.0, 2.0, 3.0, 4.0]}]
    seen = [plain(row) for row in READERS[reader](path)]
    if reader == "polars" and not flat:
        assert seen[1]["p"] in (None, {"xyz": None, "frame": None})
        seen[1]["p"] = None
    assert seen == [{**dict.fromkeys(names), **time, **row} for time, row in zip(times, wanted, strict=True)]


def values(table: pa.Table) -> list[dict[str, Any]]:
    """Rows with dotted names, without what is missing; matrices in their shape, JSON text read."""
    found: dict[str, list[Any]] = {}

    def put(name: str, field: pa.Field, array: pa.Array) -> None:
        said = field.metadata or {}
        if pa.types.is_struct(field.type):
            for at, child in enumerate(array.flatten()):
                put(f"{name}.{field.type.field(at).name}", field.type.field(at), child)
            return
        shape = orjson.loads(said.get(b"ml_dash.shape", b"[]"))
        listed = values_of(Column(array, ENCODING_KEY in said))
        found[name] = [value if value is None or not shape else shaped(value, shape) for value in listed]

    for field in table.schema:
        put(field.name, field, table[field.name].combine_chunks())
    del found["timestamp_ns"]
    rows = [dict(zip(found, row, strict=True)) for row in zip(*found.values(), strict=True)]
    return [{name: value for name, value in row.items() if value is not None} for row in rows]


def shaped(value: list[Any], shape: list[int]) -> list[Any]:
    if len(shape) == 1:
        return value
    size = len(value) // shape[0]
    return [shaped(value[at : at + size], shape[1:]) for at in range(0, len(value), size)]


def canonical(value: Any) -> Any:
    if type(value) is int and abs(value) <= 2**53:
        return float(value)
    if isinstance(value, list):
        return [canonical(element) for element in value]
    return {key: canonical(value[key]) for key in sorted(value)} if isinstance(value, dict) else value


def comparable(rows: list[dict[str, Any]]) -> list[dict[str, str]]:
    return [{name: repr(canonical(value)) for name, value in row.items() if value is not None} for row in rows]


CHUNKS = st.lists(st.lists(ROWS, min_size=1, max_size=3), min_size=1, max_size=4)


@settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(CHUNKS)
def test_every_row_comes_back_whatever_the_blocks_hold(chunks: list[list[dict[str, Any]]]) -> None:
    numbers = iter(range(100))
    timed = [[{**row, "_ts": float(next(numbers))} for row in rows] for rows in chunks]
    with tempfile.TemporaryDirectory() as folder:
        rec = recording(Path(folder), *timed)
        table = pq.read_table(exported(rec))
        flat = [flatten(row, "_ts") for row in rec["robot"].rows()]
        rec.close()
    assert comparable(values(table)) == comparable(flat)


def test_a_block_that_does_not_fit_widens_the_columns_of_those_before(tmp_path: Path) -> None:
    chunks = [
        steps(2, 0.0, n=1, q=[1, 2], kind=1),
        steps(2, 1.0, n=2, q=[1, 2], kind=2),
        steps(2, 2.0, n=0.5, q=[1.5, 2.0], kind="three"),
        steps(2, 3.0, n=1, q=[1.0], new={"a": 1}),
    ]
    table = pq.read_table(exported(recording(tmp_path, *chunks)))
    assert table.column_names == ["_ts", "timestamp_ns", "n", "q", "kind", "new"]
    assert table.schema.field("n").type == pa.float64()
    assert table.schema.field("q").type == pa.list_(pa.float64())
    assert table.schema.field("kind").metadata == {b"ml_dash.encoding": b"json"}
    assert table["kind"].to_pylist() == ["1", "1", "2", "2", '"three"', '"three"', None, None]
    assert table["new"].to_pylist() == [None] * 6 + [{"a": 1}] * 2


def test_a_schema_that_says_what_comes_later_saves_the_second_pass(tmp_path: Path) -> None:
    schema = {"type": "object", "properties": {"n": {"type": "number"}, "late": {"type": "string"}}}
    chunks = [steps(2, 0.0, n=1), steps(2, 1.0, n=0.5, late="x")]
    rec = recording(tmp_path, *chunks, schemas={"robot": schema})
    said: list[tuple[int, int]] = []
    table = pq.read_table(exported(rec, progress=lambda *done: said.append(done)))
    assert table.schema.field("n").type == pa.float64()
    assert said == [(2, 4), (4, 4), (4, 4)]


def test_a_vector_that_rows_lack_is_a_list_that_older_readers_know_nulls_of(tmp_path: Path) -> None:
    chunks = [steps(1, 0.0, q=[1.0, 2.0], p={"q": [1.0]}), steps(1, 1.0, n=1)]
    table = pq.read_table(exported(recording(tmp_path, *chunks)))
    assert table.schema.field("q").type == pa.list_(pa.float64())
    assert table.schema.field("q").metadata[b"ml_dash.shape"] == b"[2]"
    assert table.schema.field("p").type == pa.struct([("q", pa.list_(pa.float64()))])
    assert table["q"].to_pylist() == [[1.0, 2.0], None]
    assert table["p"].to_pylist() == [{"q": [1.0]}, None]


def test_a_key_with_a_dot_in_it_stays_a_column_of_its_own(tmp_path: Path) -> None:
    schema = {"type": "object", "properties": {"a.b": {"type": "integer"}}}
    rec = recording(tmp_path, steps(1, **{"a.b": 1, "c": {"d": 2}}), schemas={"robot": schema})
    assert pq.read_table(exported(rec)).column_names == ["_ts", "timestamp_ns", "a.b", "c"]


def test_a_name_that_is_a_value_here_and_a_dict_there_stays_flat(tmp_path: Path) -> None:
    table = pq.read_table(exported(recording(tmp_path, steps(1, 0.0, cam=1), steps(1, 1.0, cam={"pos": 2}))))
    assert table.column_names == ["_ts", "timestamp_ns", "cam", "cam.pos"]


def test_a_field_that_is_called_like_the_column_of_times_keeps_its_values(tmp_path: Path) -> None:
    table = pq.read_table(exported(recording(tmp_path, steps(1, timestamp_ns="x", timestamp="y"))))
    assert table.column_names == ["_ts", "timestamp_ns", "fields.timestamp_ns", "timestamp"]
    assert table["fields.timestamp_ns"].to_pylist() == ["x"]


def test_elements_never_take_the_name_of_another_field(tmp_path: Path) -> None:
    table = pq.read_table(exported(recording(tmp_path, steps(1, **{"q.0": 7, "q": [1.0, 2.0]})), flatten=True))
    assert table.to_pylist() == [{"_ts": 0.0, "timestamp_ns": 0, "q.0": 7, "q.0#2": 1.0, "q.1": 2.0}]


def test_the_metadata_says_what_the_rows_are_and_where_they_come_from(tmp_path: Path) -> None:
    about = {
        "units": {"q": "rad", "pose": {"xyz": "m"}},
        "joint_names": ["a", "b"],
        "quat_order": "xyzw",
        "maker": "me",
    }
    with Recorder(tmp_path / "run", prefix="alice/arm") as recorder:
        recorder.set_parameters({"lr": 0.1})
        topic = recorder.topic("robot", description="an arm", tags=["x"], metadata=about)
        topic.append(q=[0.0, 1.0], pose={"xyz": [1.0, 2.0, 3.0]}, _ts=0.0)
    with Recording(tmp_path / "run") as rec:
        path = rec.export(tmp_path / "out", format="parquet") / "robot.parquet"
    schema = pq.read_schema(path)
    said = orjson.loads(schema.metadata[b"ml_dash"])
    assert said["topic"] == "robot"
    assert (said["units"], said["joint_names"], said["quat_order"]) == (about["units"], ["a", "b"], "xyzw")
    assert (said["description"], said["tags"], said["metadata"]) == ("an arm", ["x"], {"maker": "me"})
    assert said["schema"]["properties"]["q"]["maxItems"] == 2
    assert said["run"]["params"] == {"lr": 0.1}
    assert said["source"]["prefix"] == "alice/arm"
    assert schema.field("q").metadata == {b"ml_dash.unit": b"rad", b"ml_dash.shape": b"[2]"}
    assert schema.field("pose").type.field("xyz").metadata == {b"ml_dash.unit": b"m", b"ml_dash.shape": b"[3]"}
    assert schema.field("_ts").metadata == {b"ml_dash.unit": b"s"}


def test_row_groups_are_large_compressed_and_said_to_be_sorted(tmp_path_factory: pytest.TempPathFactory) -> None:
    count, tmp_path = 140_000, tmp_path_factory.mktemp("large")
    with Recorder(tmp_path / "run") as recorder:
        recorder.topic("robot").append_columns(_ts=np.arange(count) / 1e3, n=np.arange(count))
    with Recording(tmp_path / "run") as rec:
        path = rec.export(tmp_path / "robot.parquet", format="parquet")
    file = pq.ParquetFile(path)
    groups = [file.metadata.row_group(at) for at in range(file.metadata.num_row_groups)]
    assert [group.num_rows for group in groups] == [131072, count - 131072]
    assert {group.column(at).compression for group in groups for at in range(3)} == {"ZSTD"}
    assert all(group.sorting_columns == (pq.SortingColumn(0),) for group in groups)
    assert file.read()["n"].to_numpy().tolist() == list(range(count))


def test_a_range_without_rows_gives_a_table_without_rows(tmp_path: Path) -> None:
    schema = {"type": "object", "properties": {"n": {"type": "number"}}}
    rec = recording(tmp_path, steps(2, n=1.0), schemas={"robot": schema})
    table = pq.read_table(exported(rec, start=5.0))
    assert (table.num_rows, table.column_names) == (0, ["_ts", "timestamp_ns", "n"])


def test_flatten_is_a_switch(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="pass True or False"):
        exported(recording(tmp_path, steps(1, n=1)), flatten="yes")


def test_a_dict_called_like_the_column_of_instants_does_not_share_its_name(tmp_path: Path) -> None:
    stamp = {"secs": 1, "nsecs": 2}
    rec = recording(tmp_path, steps(2, 1.7e9, timestamp=stamp, x=1))
    path = exported(rec)
    table = pq.read_table(path)
    assert table.column_names == ["_ts", "timestamp", "fields.timestamp", "x"]
    assert table["fields.timestamp"].to_pylist() == [stamp, stamp]
    assert pd.read_parquet(path)["fields.timestamp"].tolist() == [stamp, stamp]
    with Recording(path) as back:
        assert [row["timestamp"] for row in back["robot"].rows()] == [stamp, stamp]
