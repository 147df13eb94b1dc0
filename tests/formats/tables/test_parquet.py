"""Parquet becomes a recording: ours as the rows that it was, that of others row by row with all that it says."""

from __future__ import annotations

import datetime
import decimal
import math
import tempfile
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ml_dash_mcap import Recorder, Recording, convert
from ml_dash_mcap.errors import ConversionWarning, ForeignFileError, NotFoundError, OptionError, UsageError
from tests.support.examples import examples
from tests.support.row_shapes import typed

READS_GAPS = int(pa.__version__.split(".")[0]) >= 26
"""Whether pyarrow reads nulls among lists of fixed size."""

EPOCH_NS = 1_700_000_000_123_456_789


def written(folder: Path, columns: Any, name: str = "table.parquet", **how: Any) -> Path:
    table = columns if isinstance(columns, pa.Table) else pa.table(columns)
    pq.write_table(table, folder / name, **how)
    return folder / name


def rows(path: Path) -> list[dict[str, Any]]:
    with Recording(path) as recording:
        (topic,) = recording.topics
        return list(recording[topic].rows())


def converted(path: Path, **options: Any) -> list[dict[str, Any]]:
    return rows(convert(path, path.with_suffix(""), **options))


# -- the column of times ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "values", "expected"),
    [
        ("_ts", [0.5, 1.5], [0.5, 1.5]),
        ("timestamp", [0.5, 1.5], [0.5, 1.5]),
        ("t", pa.array([0, 1 / 30], pa.float32()), [0.0, float(np.float32(1 / 30))]),
        ("Time (s)", [0.5, 1.5], [0.5, 1.5]),
        ("time_ms", [500, 1500], [0.5, 1.5]),
        ("t [us]", [500_000, 1_500_000], [0.5, 1.5]),
        ("stamp_ns", [EPOCH_NS, EPOCH_NS + 5], [EPOCH_NS / 1e9, (EPOCH_NS + 5) / 10**9]),
        ("seconds", [1, 2], [1.0, 2.0]),
        ("timestamp", [1_700_000_000, 1_700_000_001], [1.7e9, 1_700_000_001.0]),
        ("timestamp", [1_700_000_000_500, 1_700_000_001_500], [1_700_000_000.5, 1_700_000_001.5]),
        ("timestamp", [1_700_000_000_500_000, 1_700_000_001_500_000], [1_700_000_000.5, 1_700_000_001.5]),
        ("timestamp", [EPOCH_NS], [EPOCH_NS / 1e9]),
        ("timestamp", [1_700_000_000_500.0], [1_700_000_000.5]),
        ("%time", [EPOCH_NS], [EPOCH_NS / 1e9]),
        ("__time", [0.5], [0.5]),
        ("rosbagTimestamp", [EPOCH_NS], [EPOCH_NS / 1e9]),
        ("TIME_US", [500_000], [0.5]),
        ("when", pa.array([EPOCH_NS], pa.timestamp("ns")), [EPOCH_NS / 1e9]),
        ("when", pa.array([EPOCH_NS], pa.timestamp("ns", "Europe/Berlin")), [EPOCH_NS / 1e9]),
        ("time", pa.array([1_700_000_000_500], pa.timestamp("ms")), [1_700_000_000.5]),
        ("elapsed", pa.array([1500], pa.duration("ms")), [1.5]),
        ("time", pa.array([datetime.date(2024, 1, 1)]), [1_704_067_200.0]),
        ("time", ["2024-01-01T00:00:00.25Z", "2024-01-01T01:00:01+01:00"], [1_704_067_200.25, 1_704_067_201.0]),
        ("datetime", ["2024-01-01 00:00:00"], [1_704_067_200.0]),
        ("time", pa.array(["2024-01-01", "2024-01-01"]).dictionary_encode(), [1_704_067_200.0] * 2),
    ],
)
def test_the_time_is_found_by_its_name_and_type(tmp_path: Path, name: str, values: Any, expected: list[float]) -> None:
    path = written(tmp_path, {"x": list(range(len(expected))), name: values})
    found = rows(path)
    assert [row["_ts"] for row in found] == expected
    assert [row["x"] for row in found] == list(range(len(expected)))


def test_the_likeliest_of_several_names_is_taken(tmp_path: Path) -> None:
    columns = {"date": ["2024-01-01"], "t": [1.0], "time_ns": [2 * 10**9], "time": [3.0], "timestamp": [4.0]}
    assert rows(written(tmp_path, columns))[0]["_ts"] == 4.0
    del columns["timestamp"]
    assert rows(written(tmp_path, columns))[0] == {"date": "2024-01-01", "t": 1.0, "time_ns": 2 * 10**9, "_ts": 3.0}
    del columns["time"]
    assert rows(written(tmp_path, columns))[0]["_ts"] == 2.0


def test_a_unit_in_the_metadata_counts(tmp_path: Path) -> None:
    schema = pa.schema([pa.field("t", pa.int64(), metadata={"unit": "ms"}), pa.field("x", pa.int64())])
    assert [row["_ts"] for row in rows(written(tmp_path, pa.table([[500], [1]], schema=schema)))] == [0.5]


def test_times_that_doubles_round_stay_a_field_too(tmp_path: Path) -> None:
    stamps = [EPOCH_NS + 50 * at for at in range(8)]
    found = rows(written(tmp_path, {"timestamp": stamps, "n": list(range(8))}))
    assert [(row["timestamp"], row["n"]) for row in found] == [(stamp, at) for at, stamp in enumerate(stamps)]


def test_seconds_are_the_time_stamps_and_no_field(tmp_path: Path) -> None:
    assert rows(written(tmp_path, {"time": [0.5], "x": [1]})) == [{"x": 1, "_ts": 0.5}]


def test_integers_that_may_count_anything_need_a_unit(tmp_path: Path) -> None:
    path = written(tmp_path, {"time": [0, 10, 20], "x": [1, 2, 3]})
    with pytest.raises(
        ForeignFileError, match=r"table.parquet: the column 'time' has the integers 0 to 20.*time_unit="
    ):
        Recording(path)
    assert [row["_ts"] for row in converted(path, time_unit="ms")] == [0.0, 0.01, 0.02]


def test_a_table_without_a_time_says_what_it_has(tmp_path: Path) -> None:
    path = written(tmp_path, {"a": [1.5], "b": ["x"]})
    with pytest.raises(ForeignFileError, match=r"pass time_column= to convert\(\), one of a \(double\), b \(string\)"):
        Recording(path)
    with pytest.raises(ForeignFileError, match="could be its time"):
        Recording(written(tmp_path, {"a": pa.array([1], pa.timestamp("s")), "b": pa.array([1], pa.timestamp("s"))}))
    assert converted(written(tmp_path, {"a": [1.5], "b": ["x"]}), time_column="a") == [{"b": "x", "_ts": 1.5}]


@pytest.mark.parametrize(
    ("options", "error", "what"),
    [
        ({"time_column": "tme"}, NotFoundError, "no column 'tme'.*'time'"),
        ({"time_unit": "min"}, OptionError, "pass 's', 'ms', 'us', 'ns'"),
        ({"time_column": "text"}, ForeignFileError, "'hello', which is no time as ISO 8601"),
        ({"time_column": "list"}, ForeignFileError, "is list.*which is no time"),
        ({"time_colum": "time"}, UsageError, "has no option 'time_colum'"),
        ({"on_bad": "skip"}, OptionError, "pass 'raise' or 'missing'"),
    ],
)
def test_what_an_option_cannot_be_is_said_and_nothing_is_left(
    tmp_path: Path, options: dict[str, Any], error: type[Exception], what: str
) -> None:
    path = written(tmp_path, {"time": [0.5], "text": ["hello"], "list": [[1]]})
    with pytest.raises(error, match=what):
        convert(path, tmp_path / "run", **options)
    assert [one.name for one in tmp_path.iterdir()] == ["table.parquet"]


def test_a_row_without_a_time_is_named(tmp_path: Path) -> None:
    path = written(tmp_path, {"time": [0.5, None, math.nan, 1.5], "x": [1, 2, 3, 4]})
    with pytest.raises(ForeignFileError, match=r"row 1: the time is None in the column 'time'.*on_bad='missing'"):
        Recording(path)
    with pytest.warns(ConversionWarning, match="2 rows without a time were left out"):
        assert [row["x"] for row in converted(path, on_bad="missing")] == [1, 4]


def test_times_before_0_can_be_shifted(tmp_path: Path) -> None:
    path = written(tmp_path, {"time": [-0.5, 0.5], "x": [1, 2]})
    with pytest.raises(ForeignFileError, match=r"row 0: the time is -0.5.*pass start="):
        Recording(path)
    assert [row["_ts"] for row in converted(path, start=10.0)] == [9.5, 10.5]


# -- rows of others ---------------------------------------------------------------------------------------------------


def test_each_row_is_a_sample_of_its_own(tmp_path: Path) -> None:
    path = written(tmp_path, {"time": [0.0, 0.0, 0.0, 1.0], "x": [1, 2, 3, 4], "late": [None, None, "a", None]})
    with Recording(path) as recording:
        assert recording.topics["table"].kind == "message"
        assert recording["table"].to_arrow().to_pylist() == [
            {"_ts": time, "x": x, "late": late}
            for time, x, late in [(0.0, 1, None), (0.0, 2, None), (0.0, 3, "a"), (1.0, 4, None)]
        ]


VALUES: dict[str, tuple[Any, list[Any]]] = {
    "int8": (pa.array([1, None], pa.int8()), [1, None]),
    "uint64": (pa.array([2**64 - 1, None], pa.uint64()), [2**64 - 1, None]),
    "float16": (pa.array(np.array([0.5, 1.5], np.float16)), [0.5, 1.5]),
    "float32": (pa.array([0.1, None], pa.float32()), [float(np.float32(0.1)), None]),
    "boolean": (pa.array([True, None]), [True, None]),
    "string": (pa.array(["a", None]), ["a", None]),
    "large_string": (pa.array(["a", ""], pa.large_string()), ["a", ""]),
    "binary": (pa.array([b"\x00\xff", None]), [b"\x00\xff", None]),
    "fixed binary": (pa.array([b"ab", b"cd"], pa.binary(2)), [b"ab", b"cd"]),
    "large binary": (pa.array([b"ab", None], pa.large_binary()), [b"ab", None]),
    "null": (pa.nulls(2), [None, None]),
    "list": (pa.array([[1, 2], None]), [[1, 2], None]),
    "large list": (pa.array([["a"], []], pa.large_list(pa.string())), [["a"], []]),
    "vector": (pa.array([[0.5, 1.5], [2.5, 3.5]], pa.list_(pa.float32(), 2)), [[0.5, 1.5], [2.5, 3.5]]),
    "vector with a gap": (pa.array([[0.5, None], None], pa.list_(pa.float64(), 2)), [[0.5, None], None]),
    "matrix": (pa.array([[[1, 2], [3, 4]], [[5, 6], [7, 8]]]), [[[1, 2], [3, 4]], [[5, 6], [7, 8]]]),
    "struct": (pa.array([{"a": 1, "b": {"c": "x"}}, None]), [{"a": 1, "b": {"c": "x"}}, None]),
    "list of structs": (pa.array([[{"a": 1}, {"a": None}], []]), [[{"a": 1}, {"a": None}], []]),
    "map": (
        pa.array([[("a", 1)], None], pa.map_(pa.string(), pa.int64())),
        [[{"key": "a", "value": 1}], None],
    ),
    "dictionary": (pa.array(["a", None]).dictionary_encode(), ["a", None]),
    "decimal": (
        pa.array([decimal.Decimal("12345678901234567890.10"), None], pa.decimal128(30, 2)),
        ["12345678901234567890.10", None],
    ),
    "date": (pa.array([datetime.date(2024, 2, 29), None]), ["2024-02-29", None]),
    "time of day": (pa.array([1_000_000_001, None], pa.time64("ns")), ["00:00:01.000000001", None]),
    "instant": (pa.array([EPOCH_NS, None], pa.timestamp("ns", "UTC")), ["2023-11-14T22:13:20.123456789+00:00", None]),
    "instant in a zone": (
        pa.array([1_700_000_000, None], pa.timestamp("s", "Asia/Kolkata")),
        ["2023-11-15T03:43:20.000+05:30", None],  # Parquet has no seconds
    ),
    "instant without a zone": (pa.array([1_700_000_000_250, None], pa.timestamp("ms")), ["2023-11-14T22:13:20.250", None]),
    "duration": (pa.array([1500, None], pa.duration("us")), [1500, None]),
}  # fmt: skip


@pytest.mark.parametrize("kind", VALUES)
def test_a_column_of_any_type_comes_through(tmp_path: Path, kind: str) -> None:
    array, expected = VALUES[kind]
    if kind == "vector with a gap" and not READS_GAPS:
        pytest.skip("this pyarrow does not read nulls among lists of fixed size")
    found = [row["x"] for row in rows(written(tmp_path, {"time": [0.0, 1.0], "x": array}))]
    assert typed(found) == typed(expected)


def test_nested_types_of_others_come_through_inside_lists_and_structs(tmp_path: Path) -> None:
    inner = pa.struct([("when", pa.timestamp("ns")), ("cost", pa.decimal128(6, 2)), ("kind", pa.large_string())])
    value = {"when": pd.Timestamp(EPOCH_NS), "cost": decimal.Decimal("1.50"), "kind": "a"}
    array = pa.array([[value], None, []], pa.list_(inner))
    found = [row["x"] for row in rows(written(tmp_path, {"time": [0.0, 1.0, 2.0], "x": array}))]
    assert found == [[{"when": "2023-11-14T22:13:20.123456789", "cost": "1.50", "kind": "a"}], None, []]


def test_units_types_and_the_files_metadata_are_the_topics(tmp_path: Path) -> None:
    pose = pa.struct([pa.field("z", pa.float64(), metadata={"unit": "mm"})])
    schema = pa.schema(
        [
            pa.field("time", pa.float64(), metadata={"unit": "s"}),
            pa.field("force", pa.float32(), metadata={"unit": "N"}),
            pa.field("pose", pose),
            pa.field("lag", pa.duration("us")),
        ],
        metadata={"maker": "me", "rig": '{"id": 7}'},
    )
    table = pa.table([[0.0], [1.5], [{"z": 2.5}], pa.array([3], pa.duration("us"))], schema=schema)
    with Recording(written(tmp_path, table)) as recording:
        metadata = recording.topics["table"].metadata
        assert metadata["units"] == {"force": "N", "pose.z": "mm", "lag": "us"}
        assert metadata["file_metadata"] == {"maker": "me", "rig": {"id": 7}}
        assert metadata["arrow_types"]["lag"] == "duration[us]"
        assert (metadata["source"], metadata["time_column"]) == ("table.parquet", "time")
        again = recording.export(tmp_path / "again.parquet", format="parquet")
    assert pq.read_schema(again).field("force").metadata[b"ml_dash.unit"] == b"N"


def test_reserved_and_repeated_names_get_others(tmp_path: Path) -> None:
    table = pa.table([[0.0], [1], [2], [3], [4]], names=["time", "_exact", "_ts", "a", "a"])
    path = written(tmp_path, table)
    assert converted(path, time_column="time") == [{"fields._exact": 1, "fields._ts": 2, "a": 3, "a#2": 4, "_ts": 0.0}]


def test_names_stay_as_they_are(tmp_path: Path) -> None:
    names = ["observation.state", "x y", "größe", "", "self", "timestamp", "topic", "a/b"]
    path = written(tmp_path, {"time": [0.0], **{name: [at] for at, name in enumerate(names)}})
    assert converted(path, time_column="time") == [{**{name: at for at, name in enumerate(names)}, "_ts": 0.0}]


def test_a_lerobot_file_reads_as_it_is(tmp_path: Path) -> None:
    count, fps = 60, 30
    table = pa.table(
        {
            "observation.state": pa.array(np.arange(count * 6.0).reshape(count, 6).tolist(), pa.list_(pa.float32(), 6)),
            "action": pa.array(np.ones((count, 6)).tolist(), pa.list_(pa.float32(), 6)),
            "timestamp": pa.array([(at % 30) / fps for at in range(count)], pa.float32()),
            "frame_index": [at % 30 for at in range(count)],
            "episode_index": [at // 30 for at in range(count)],
            "index": list(range(count)),
            "task_index": [0] * count,
        }
    )
    with Recording(written(tmp_path, table, "file-000.parquet")) as recording:
        found = recording["file-000"].to_arrow()
        assert "the clock steps back by 0.966667 s" in str(recording.check())
    assert found.schema.field("observation.state").type == pa.list_(pa.float64(), 6)
    order = np.argsort(found["index"].to_numpy())
    assert found["_ts"].to_numpy()[order].tolist() == table["timestamp"].to_pylist()
    for name in ("observation.state", "action", "frame_index", "episode_index", "task_index"):
        assert found[name].take(pa.array(order)).to_pylist() == table[name].to_pylist()


WRITERS = {
    "pandas": lambda frame, path: frame.to_parquet(path),
    "polars": lambda frame, path: pl.from_pandas(frame.reset_index(names="when")).write_parquet(path),
    "duckdb": lambda frame, path: duckdb.sql(f"copy (select * from frame) to '{path}' (format parquet)"),
}


@pytest.mark.parametrize("writer", WRITERS)
def test_files_of_other_writers_are_read(tmp_path: Path, writer: str) -> None:
    when = pd.to_datetime([EPOCH_NS, EPOCH_NS + 10**9]).tz_localize("UTC")
    frame = pd.DataFrame({"x": [0.5, np.nan], "n": pd.array([1, None], "Int64"), "s": ["a", None]})
    if writer == "duckdb":
        frame["when"] = when
    else:
        frame.index = when
    WRITERS[writer](frame, tmp_path / "t.parquet")
    found = rows(tmp_path / "t.parquet")
    digits = 1e-6 if writer == "duckdb" else 0
    assert [row["_ts"] for row in found] == pytest.approx([EPOCH_NS / 1e9, EPOCH_NS / 1e9 + 1], abs=digits)
    assert [(row["n"], row["s"]) for row in found] == [(1, "a"), (None, None)]
    assert found[0]["x"] == 0.5 and (found[1]["x"] is None or math.isnan(found[1]["x"]))


def test_what_is_no_parquet_is_said_so(tmp_path: Path) -> None:
    for name, data in (("cut.parquet", b"PAR1junk"), ("text.parquet", b"hello"), ("magic.bin", b"PAR1" + bytes(50))):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(ForeignFileError, match=f"{name}: it cannot be read as Parquet"):
            Recording(tmp_path / name)


def damaged(path: Path) -> Path:
    data = bytearray(path.read_bytes())
    data[5000:5400] = bytes(400)
    path.write_bytes(data)
    return path


def test_a_damaged_page_is_an_error_with_the_file(tmp_path: Path) -> None:
    columns = {"time": np.arange(50_000.0), "x": np.arange(50_000)}
    path = damaged(written(tmp_path, columns, compression="zstd", write_page_checksum=True))
    with pytest.raises(ForeignFileError, match=r"table\.parquet: it is damaged"):
        convert(path, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_damage_to_what_we_exported_is_seen(tmp_path: Path) -> None:
    with Recorder(tmp_path / "run") as recorder:
        recorder.topic("robot").append_columns(_ts=np.arange(50_000.0), x=np.arange(50_000))
    with Recording(tmp_path / "run") as recording:
        path = damaged(recording.export(tmp_path / "robot.parquet", format="parquet"))
    with pytest.raises(ForeignFileError, match=r"robot\.parquet: it is damaged"):
        Recording(path)
    with pytest.raises(OSError, match="CRC"):
        pq.ParquetFile(path, page_checksum_verification=True).read()


def test_what_is_not_damaged_can_be_taken(tmp_path: Path) -> None:
    columns = {"time": np.arange(60_000.0), "x": np.arange(60_000)}
    path = damaged(written(tmp_path, columns, row_group_size=20_000, use_dictionary=False, write_page_checksum=True))
    with pytest.warns(ConversionWarning, match=r"20000 of 60000 rows are damaged and were left out"):
        convert(path, tmp_path / "run", on_damage="skip")
    assert [row["x"] for row in rows(tmp_path / "run")] == list(range(20_000, 60_000))
    with pytest.warns(ConversionWarning, match="20000 of 60000"), Recording(path, on_damage="skip") as recording:
        assert recording.topics["table"].count == 40_000
    with pytest.raises(OptionError, match="on_damage='ignore'"):
        convert(path, tmp_path / "no", on_damage="ignore")


def test_progress_counts_the_rows(tmp_path: Path) -> None:
    path = written(tmp_path, {"time": np.arange(20_000.0), "x": np.arange(20_000)})
    seen: list[tuple[int, int]] = []
    convert(path, tmp_path / "run", progress=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (20_000, 20_000) and [done for done, _ in seen] == sorted(done for done, _ in seen)


# -- any schema -------------------------------------------------------------------------------------------------------

SINGLE = {
    pa.bool_(): st.booleans(),
    pa.int64(): st.integers(-(2**63), 2**63 - 1),
    pa.int16(): st.integers(-(2**15), 2**15 - 1),
    pa.uint64(): st.integers(0, 2**64 - 1),
    pa.float64(): st.floats(allow_nan=False),
    pa.float32(): st.floats(width=32, allow_nan=False),
    pa.string(): st.text(st.characters(exclude_categories=["Cs"]), max_size=4),
    pa.large_string(): st.text("ab", max_size=2),
    pa.binary(): st.binary(max_size=4),
    pa.date32(): st.dates(datetime.date(1700, 1, 1), datetime.date(2200, 1, 1)),
    pa.timestamp("us"): st.datetimes(datetime.datetime(1700, 1, 1), datetime.datetime(2200, 1, 1)),
    pa.decimal128(12, 3): st.decimals(-(10**8), 10**8, places=3, allow_nan=False),
    pa.null(): st.none(),
}


@st.composite
def arrow_columns(draw: st.DrawFn, count: int, depth: int = 0) -> tuple[pa.DataType, list[Any]]:
    """A type, and values of it, None among them."""
    kinds = ["single", "single", "list", "struct", *(["fixed"] if READS_GAPS else [])]
    kind = draw(st.sampled_from(kinds if depth < 2 else ["single"]))
    if kind == "single":
        type_ = draw(st.sampled_from(list(SINGLE)))
        return type_, draw(st.lists(SINGLE[type_] | st.none(), min_size=count, max_size=count))
    if kind == "struct":
        inner = {
            name: draw(arrow_columns(count, depth + 1)) for name in draw(st.sets(st.sampled_from("abc"), min_size=1))
        }
        gaps = draw(st.lists(st.booleans(), min_size=count, max_size=count))
        values = [None if gaps[at] else {name: one[at] for name, (_, one) in inner.items()} for at in range(count)]
        return pa.struct([(name, type_) for name, (type_, _) in inner.items()]), values
    lengths = draw(st.lists(st.integers(0, 3) | st.none(), min_size=count, max_size=count))
    if kind == "fixed":
        size = draw(st.integers(1, 3))
        lengths = [None if length is None else size for length in lengths]
    type_, flat = draw(arrow_columns(sum(length or 0 for length in lengths), depth + 1))
    rest = iter(flat)
    values = [None if length is None else [next(rest) for _ in range(length)] for length in lengths]
    return (pa.list_(type_, size) if kind == "fixed" else pa.list_(type_)), values


def plain(value: Any) -> Any:
    """What a row says for one of Arrow's values."""
    if isinstance(value, dict):
        return {key: plain(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [plain(inner) for inner in value]
    if isinstance(value, datetime.datetime):
        return value.isoformat(timespec="microseconds")
    if isinstance(value, datetime.date):
        return value.isoformat()
    return str(value) if isinstance(value, decimal.Decimal) else value


@settings(max_examples=examples(50), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_a_table_of_any_types_is_the_rows_that_arrow_says(data: st.DataObject) -> None:
    count = data.draw(st.integers(1, 5))
    names = data.draw(st.sets(st.sampled_from(["a", "b.c", "x y", "_t", "n"]), min_size=1, max_size=3))
    columns = {name: data.draw(arrow_columns(count)) for name in sorted(names)}
    table = pa.table({"time": [at / 4 for at in range(count)], **{n: pa.array(v, t) for n, (t, v) in columns.items()}})
    with tempfile.TemporaryDirectory() as folder:
        found = rows(written(Path(folder), table, row_group_size=2))
        expected = [plain(row) for row in pq.read_table(Path(folder) / "table.parquet").to_pylist()]
    for row in expected:
        row["_ts"] = row.pop("time")
    assert typed(found) == typed(expected)


NATURAL: dict[pa.DataType, st.SearchStrategy[Any]] = {
    pa.bool_(): st.booleans(),
    pa.int64(): st.integers(-(2**63), 2**63 - 1),
    pa.float64(): st.floats(),
    pa.string(): st.text(st.characters(exclude_categories=["Cs"]), max_size=4),
    pa.binary(): st.binary(max_size=4),
}
VECTORS: dict[pa.DataType, st.SearchStrategy[Any]] = {
    pa.list_(pa.float64(), 3): st.lists(st.floats(), min_size=3, max_size=3),
    pa.list_(pa.int64(), 2): st.lists(st.integers(-(2**40), 2**40), min_size=2, max_size=2),
}


@settings(max_examples=examples(50), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_a_table_goes_in_and_comes_out_as_the_same_table(data: st.DataObject) -> None:
    count = data.draw(st.integers(1, 6))
    types = data.draw(st.lists(st.sampled_from([*NATURAL, *VECTORS]), min_size=1, max_size=4))
    columns: dict[str, pa.Array] = {"_ts": pa.array([at / 4 for at in range(count)])}
    for at, type_ in enumerate(types):
        values = NATURAL[type_] | st.none() if type_ in NATURAL else VECTORS[type_]
        drawn = data.draw(st.lists(values, min_size=count, max_size=count))
        if any(one is not None for one in drawn):  # the type of others is not said by any row
            columns[f"x{at}"] = pa.array(drawn, type_)
    table = pa.table(columns)
    with tempfile.TemporaryDirectory() as folder:
        path = written(Path(folder), table)
        with Recording(path) as recording:
            found = recording["table"].to_arrow()
            again = recording.export(Path(folder) / "again.parquet", format="parquet")
        back = pq.read_table(again).drop_columns("timestamp_ns")
    assert [(one.name, one.type) for one in found.schema] == [(one.name, one.type) for one in table.schema]
    assert repr(found.to_pydict()) == repr(table.to_pydict())
    assert [(one.name, one.type) for one in back.schema] == [(one.name, one.type) for one in table.schema]
    assert repr(back.to_pydict()) == repr(table.to_pydict())


# -- ours -------------------------------------------------------------------------------------------------------------

OURS = [
    {"q": [0.5, 1.5], "m": [[1.0, 2.0], [3.0, 4.0]], "pose": {"xyz": [1.0, 2.0, 3.0], "frame": "base"}, "n": 1, "_ts": 0.0},
    {"q": [2.5, math.inf], "m": [[5.0, 6.0], [7.0, 8.0]], "on": True, "raw": b"\x00\xff", "_ts": 0.25},
    {"pose": {"xyz": [4.0, 5.0, 6.0], "frame": ""}, "tags": ["a", "b"], "n": 2**63, "mixed": 1, "_ts": 0.5},
    {"mixed": "x", "timestamp": 7, "a.b": 3, "tags": [], "ids": [{"id": 1}, {"id": 2}], "_ts": 0.75},
    {"mixed": {"b": [math.nan]}, "z": -0.0, "_ts": 1.0},
]  # fmt: skip


def run(folder: Path, rows: list[dict[str, Any]] = OURS) -> Path:
    with Recorder(folder / "run", prefix="alice/arm") as recorder:
        recorder.set_parameters({"lr": 0.1})
        said = {"units": {"q": "rad"}, "joint_names": ["a", "b"], "quat_order": "xyzw", "frame_id": "base"}
        topic = recorder.topic("robot/arm 1", description="an arm", tags=["x"], metadata={"maker": "me"}, **said)
        topic.append_batch(rows)
        recorder.topic("imu").append_columns(_ts=np.arange(3.0), accel=np.arange(9.0).reshape(3, 3))
    return folder / "run"


@pytest.mark.parametrize("flatten", [False, True])
def test_what_we_exported_comes_back_as_the_rows_that_it_was(tmp_path: Path, flatten: bool) -> None:
    with Recording(run(tmp_path)) as recording:
        folder = recording.export(tmp_path / "out", format="parquet", flatten=flatten)
        with Recording(folder) as back:
            assert sorted(back.topics) == ["imu", "robot/arm 1"]
            assert typed(normal(back["imu"].rows())) == typed(normal(recording["imu"].rows()))
            assert typed(normal(back["robot/arm 1"].rows())) == typed(normal(OURS))
            info, before = back.topics["robot/arm 1"], recording.topics["robot/arm 1"]
            assert (info.kind, info.description, info.tags, info.metadata) == (
                *(before.kind, before.description, before.tags, before.metadata),
            )
            assert back.params == {"lr": 0.1}


def normal(rows: Any) -> list[dict[str, Any]]:
    """Rows in which the order of keys says nothing."""
    return [dict(sorted(row.items())) for row in rows]


@pytest.mark.parametrize("how", ["read", "to_arrow"])
def test_tables_that_readers_gave_come_back_too(tmp_path: Path, how: str) -> None:
    kept = [row for row in OURS if "a.b" not in row]
    with Recording(run(tmp_path, kept)) as recording:
        topic = recording["robot/arm 1"]
        if how == "read":
            (tmp_path / "x.parquet").write_bytes(topic.read(format="parquet"))
        else:
            pq.write_table(topic.to_arrow(), tmp_path / "x.parquet")
    with Recording(tmp_path / "x.parquet") as back:
        assert typed(normal(back["robot/arm 1"].rows())) == typed(normal(kept))


def test_rows_of_messages_that_share_a_time_stay_apart_when_they_are_ours(tmp_path: Path) -> None:
    path = written(tmp_path, {"time": [0.0, 0.0, 1.0], "x": [1, 2, 3]})
    with Recording(path) as recording:
        again = recording.export(tmp_path / "again.parquet", format="parquet")
    assert rows(again) == [{"x": 1, "_ts": 0.0}, {"x": 2, "_ts": 0.0}, {"x": 3, "_ts": 1.0}]


def test_a_table_of_others_keeps_its_nulls_through_a_file_of_ours(tmp_path: Path) -> None:
    columns = {
        "time": [0.0, 1.0],
        "n": [1, None],
        "s": [None, "a"],
        "v": pa.array([[0.5], None], pa.list_(pa.float64())),
        "p": [{"x": 1, "y": None}, None],
    }
    path = written(tmp_path, columns)
    for flatten in (False, True):
        with Recording(path) as recording:
            again = recording.export(tmp_path / f"{flatten}.parquet", format="parquet", flatten=flatten)
            found = rows(again)
        if flatten:  # a struct without any value has no column that says so
            found[1]["p"] = None
        assert normal(found) == normal(rows(path))
    path = written(tmp_path, {"time": [0.0, 1.0], "n": [1, None]}, "numbers.parquet")
    with Recording(path) as recording:
        assert rows(recording.export(tmp_path / "m.parquet", format="parquet"))[1] == {"n": None, "_ts": 1.0}


def test_a_file_whose_metadata_says_something_else_is_one_of_others(tmp_path: Path) -> None:
    table = pa.table({"time": [0.5], "x": [1]}).replace_schema_metadata({"ml_dash": '{"time": "_ts"}'})
    assert rows(written(tmp_path, table)) == [{"x": 1, "_ts": 0.5}]


def test_one_topic_cannot_name_several_files(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for name in ("a.parquet", "b.parquet"):
        written(tmp_path / "in", {"time": [0.0], "x": [1]}, name)
    with Recording(tmp_path / "in") as recording:
        assert list(recording.topics) == ["a", "b"]
    with pytest.raises(UsageError, match="names one topic, but there are 2 files"):
        convert(tmp_path / "in", tmp_path / "run", topic="x")


def test_a_table_without_rows_says_so(tmp_path: Path) -> None:
    path = written(tmp_path, {"time": pa.array([], pa.float64()), "x": pa.array([], pa.int64())})
    with pytest.warns(ConversionWarning, match=r"table\.parquet: the table has no rows, so there is no topic of it"):
        convert(path, tmp_path / "run")
    with Recording(tmp_path / "run") as recording:
        assert list(recording.topics) == []


def test_a_topic_can_be_named(tmp_path: Path) -> None:
    convert(written(tmp_path, {"time": [0.0], "x": [1]}), tmp_path / "run", topic="arm")
    with Recording(tmp_path / "run") as recording:
        assert list(recording.topics) == ["arm"]


def test_a_folder_with_anything_else_in_it_is_no_table(tmp_path: Path) -> None:
    written(tmp_path, {"time": [0.0], "x": [1]})
    (tmp_path / "notes.md").write_text("x")
    from ml_dash_mcap.formats import registry

    assert registry.detect(tmp_path) is None


RANDOM = st.fixed_dictionaries(
    {},
    optional={
        "v": st.lists(st.floats(), min_size=3, max_size=3),
        "m": st.lists(st.lists(st.floats(), min_size=2, max_size=2), min_size=2, max_size=2),
        "n": st.integers(-(2**63), 2**63 - 1),
        "s": st.text(st.characters(exclude_categories=["Cs"]), max_size=5),
        "on": st.booleans(),
        "raw": st.binary(max_size=4),
        "p": st.fixed_dictionaries({"x": st.floats(allow_nan=False)}, optional={"y": st.text("ab", min_size=1)}),
        "tags": st.lists(st.text("ab"), max_size=3),
        "odd": st.integers(0, 3) | st.text("xy") | st.lists(st.integers(0, 3), max_size=2),
    },
)


@settings(max_examples=examples(30), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(drawn=st.lists(RANDOM, min_size=1, max_size=6), flatten=st.booleans())
def test_any_rows_of_ours_come_back(drawn: list[dict[str, Any]], flatten: bool) -> None:
    given_rows = [{**row, "_ts": at / 8} for at, row in enumerate(drawn)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with Recorder(folder / "run") as recorder:
            recorder.topic("robot").append_batch(given_rows)
        with Recording(folder / "run") as recording:
            path = recording.export(folder / "robot.parquet", format="parquet", flatten=flatten)
        found = rows(path)
    assert typed(normal(found)) == typed(normal(given_rows))
