"""Columns hold what the rows hold, bit for bit, whichever way they were parsed."""

from __future__ import annotations

import math
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ml_dash_mcap import Recorder, RecorderOptions, Recording
from ml_dash_mcap.codecs.json_lines import LineReader, joined
from ml_dash_mcap.errors import NotFoundError, RangeError
from ml_dash_mcap.rows.dotted import flatten
from ml_dash_mcap.rows.typed_columns import ENCODING_KEY, from_text
from ml_dash_mcap.topic_reader import TopicReader
from tests.support.examples import examples
from tests.support.tables import from_rows

SMALL = RecorderOptions(chunk_bytes=65536, backlog_bytes=262_144, sync_interval_s=0)

FLOATS = st.floats(allow_nan=True, allow_infinity=True)
NUMBERS = st.one_of(st.integers(-(2**63), 2**64 - 1), FLOATS)
TEXTS = st.one_of(st.text(max_size=4), st.just("2024-01-02T03:04:05"), st.just('{}"_exact"'))
LEAVES = st.one_of(st.none(), st.booleans(), NUMBERS, TEXTS, st.binary(max_size=3))
KINDS: dict[str, st.SearchStrategy[Any]] = {
    "float": st.floats(allow_nan=False, allow_infinity=False),
    "number": NUMBERS,
    "text": TEXTS,
    "vector": st.lists(st.floats(-10, 10), min_size=3, max_size=3),
    "ragged": st.lists(st.one_of(st.integers(-5, 5), st.floats(-5, 5)), max_size=3),
    "matrix": st.lists(st.lists(st.floats(-1, 1), min_size=2, max_size=2), min_size=2, max_size=2),
    "gappy": st.lists(
        st.one_of(st.none(), st.sampled_from([math.nan, math.inf, -math.inf]), st.floats(-9, 9)), max_size=3
    ),
    "empties": st.recursive(st.one_of(st.none(), st.integers(0, 2)), lambda inner: st.lists(inner, max_size=2)),
    "dict": st.dictionaries(st.sampled_from(["x", "y"]), LEAVES, max_size=2),
    "dicts": st.lists(st.dictionaries(st.sampled_from(["x", "y"]), st.integers(0, 3), max_size=2), max_size=2),
    "anything": st.one_of(LEAVES, st.lists(LEAVES, max_size=2), st.dictionaries(st.just("x"), LEAVES, max_size=1)),
}
ROWS = st.fixed_dictionaries({}, optional=KINDS)
PROGRAMS = st.lists(st.tuples(st.sampled_from([0.0, 0.5, 1 / 3, 2.0, 3.0, 3.5]), ROWS, st.booleans()), max_size=12)


def values(table: pa.Table) -> dict[str, list[str]]:
    """The columns that have values, by name, with JSON text read back."""
    found: dict[str, list[str]] = {}
    for field in table.schema:
        column = table.column(field.name).to_pylist()
        if (field.metadata or {}).get(ENCODING_KEY):
            column = [None if text is None else from_text(text) for text in column]
        if any(value is not None for value in column):
            found[field.name] = [repr(canonical(value)) for value in column]
    return found


def canonical(value: Any) -> Any:
    """A value as it compares: rows that a window leaves out may have made doubles of a column's integers."""
    if type(value) is int and abs(value) <= 2**53:
        return float(value)
    if isinstance(value, list):
        return [canonical(element) for element in value]
    if isinstance(value, dict):
        return {key: canonical(value[key]) for key in sorted(value)}
    return value


def types(table: pa.Table) -> dict[str, pa.DataType]:
    return {field.name: field.type for field in table.schema if table.column(field.name).null_count < len(table)}


def record(folder: Path, program: list[tuple[float, dict[str, Any], bool]]) -> None:
    with Recorder(folder, SMALL) as recorder:
        topic = recorder.topic("a")
        for time, row, flushes in program:
            topic.append(**row, _ts=time)
            if flushes:
                recorder.flush()


@settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(PROGRAMS, st.sampled_from([None, ["float"], ["dict"], ["dict.x", "vector"], ["number", "absent"], ["text"]]))
def test_columns_are_those_of_the_rows(
    program: list[tuple[float, dict[str, Any], bool]], columns: list[str] | None
) -> None:
    with tempfile.TemporaryDirectory() as name:
        record(Path(name), program)
        with Recording(name) as recording:
            if "a" not in recording:
                return
            reader = recording["a"]
            wanted = [one for one in columns or [] if has(reader, one)]
            is_plain = len({time for time, _, _ in program}) == len(program)
            for low, high in ((None, None), (0.4, 2.5)):
                expected = from_rows([flatten(row, "_ts") for row in reader.rows(low, high, wanted)])
                found = reader.to_arrow(low, high, wanted)
                assert values(found) == values(expected)
                assert types(found) == types(expected) or not (is_plain and low is None)


def has(reader: TopicReader, column: str) -> bool:
    try:
        reader.rows(columns=[column])
    except NotFoundError:
        return False
    return True


def read(reader: LineReader, *payloads: bytes) -> dict[str, pa.Array] | None:
    lines = joined(payloads)
    return None if lines is None else reader.read(lines)


def test_plain_rows_need_no_python_objects() -> None:
    flat = read(LineReader(), b'{"q":[1.5,2.0],"n":1,"s":"2024-01-02T03:04:05","d":{"x":true},"_ts":0.5}')
    assert flat is not None
    assert {name: array.to_pylist() for name, array in flat.items()} == {
        "q": [[1.5, 2.0]],
        "n": [1],
        "s": ["2024-01-02T03:04:05"],
        "d.x": [True],
        "_ts": [0.5],
    }


@pytest.mark.parametrize(
    "lines",
    [
        b'{"a":9007199254740993}\n{"a":0.5}',
        b'{"a":{}}',
        b'{"a":1}\n\n',
        b'{"a":1}\n{"a":"x"}',
        b'{"a":[{"x":1},{"y":2}]}',
        b'{"a":NaN}',
        b'{"a":1,"a":2}',
        b'{"a.b":1,"a":{"b":2}}',
    ],
)
def test_what_arrow_would_change_is_left_to_python(lines: bytes) -> None:
    assert read(LineReader(), *lines.split(b"\n")) is None


def test_a_projection_notices_when_a_column_changes_its_type() -> None:
    reader = LineReader(["a"])
    first = read(reader, b'{"a":1,"b":[1],"_ts":0.0}')
    assert first is not None and first["a"].type == pa.int64()
    second = read(reader, b'{"a":2,"b":[1],"_ts":0.0}')
    assert second is not None and set(second) == {"a", "_ts"}
    third = read(reader, b'{"a":0.5,"b":[1],"_ts":0.0}')
    assert third is not None and third["a"].to_pylist() == [0.5]
    fourth = read(reader, b'{"a":9007199254740993,"b":[1],"_ts":0.0}')
    assert fourth is not None and fourth["a"].to_pylist() == [9007199254740993]


@pytest.mark.parametrize(
    "second",
    [
        b'{"b":"\\"a\\":7","a":2,"_ts":1.0}',
        b'{"b":{"a":7},"a":2,"_ts":1.0}',
        b'{"a":2,"b":"},{,","_ts":1.0}',
        b'{"b":[{"a":7}],"_ts":1.0,"a":2}',
        b'{ "a" : 2 , "_ts" : 1.0 }',
    ],
)
def test_a_projection_takes_no_text_or_inner_key_for_the_column(second: bytes) -> None:
    reader = LineReader(["a"])
    assert read(reader, b'{"a":1,"b":"x","_ts":0.0}') is not None
    flat = read(reader, b'{"a":1,"b":"x","_ts":0.0}', second)
    assert flat is not None and flat["a"].to_pylist() == [1, 2] and flat["_ts"].to_pylist() == [0.0, 1.0]


def test_a_projection_sees_where_a_column_is_missing() -> None:
    reader = LineReader(["a"])
    assert read(reader, b'{"a":1,"_ts":0.0}') is not None
    flat = read(reader, b'{"a":1,"_ts":0.0}', b'{"b":2,"_ts":1.0}', b'{"a":"x","_ts":2.0}')
    assert flat is None
    flat = read(reader, b'{"a":1,"_ts":0.0}', b'{"b":2,"_ts":1.0}')
    assert flat is not None and flat["a"].to_pylist() == [1, None]


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    with Recorder(tmp_path, SMALL) as recorder:
        topic = recorder.topic("robot")
        for i in range(5000):
            extra = {"late": i} if i >= 4000 else {}
            topic.append(q=[i, i + 0.5, -i], pose=np.eye(4) * i, cam={"pos": i, "name": "left"}, **extra, _ts=i / 100)
    return tmp_path


def test_numpy_gives_each_field_its_shape(robot: Path) -> None:
    with Recording(robot) as recording:
        arrays = recording["robot"].to_numpy()
    assert {name: (array.shape, array.dtype.kind) for name, array in arrays.items()} == {
        "_ts": ((5000,), "f"),
        "q": ((5000, 3), "f"),
        "pose": ((5000, 4, 4), "f"),
        "cam.pos": ((5000,), "i"),
        "cam.name": ((5000,), "O"),
        "late": ((5000,), "i"),  # masked, see tests/rows/test_frames.py
    }
    assert np.array_equal(arrays["pose"][7], np.eye(4) * 7)
    assert arrays["late"][3999] is np.ma.masked and arrays["late"][4000] == 4000


@pytest.mark.parametrize(("start", "limit"), [(0, 3), (1500, 10), (4990, None), (4990, 100), (6000, 5), (0, 0)])
def test_rows_are_found_by_their_number(robot: Path, start: int, limit: int | None) -> None:
    stop = 5000 if limit is None else min(start + limit, 5000)
    with Recording(robot) as recording:
        reader = recording["robot"]
        expected = [float(i) for i in range(start, stop)]
        rows = list(reader.rows(start_index=start, limit=limit))
        assert [row["cam"]["pos"] for row in rows] == expected
        assert reader.to_arrow(start_index=start, limit=limit).num_rows == len(expected)
        window = reader.to_arrow(10.0, 30.0, start_index=start, limit=limit)
        assert window.num_rows == len(range(1000, 3001)[start : None if limit is None else start + limit])


def test_batches_are_the_table_in_pieces(robot: Path) -> None:
    with Recording(robot) as recording:
        batches = list(recording["robot"].batches(rows=700))
        assert [len(batch) for batch in batches] == [700] * 7 + [100]
        whole = pa.concat_tables(batches, promote_options="permissive")
        assert whole.column("_ts").to_pylist() == recording["robot"].to_arrow().column("_ts").to_pylist()
        with pytest.raises(RangeError, match="rows=0"):
            recording["robot"].batches(rows=0)


def test_the_last_row_before_a_time(robot: Path) -> None:
    with Recording(robot) as recording:
        reader = recording["robot"]
        assert reader.at(12.345)["_ts"] == 12.34
        assert reader.at(12.34)["_ts"] == 12.34
        assert reader.at(math.nextafter(12.34, 0))["_ts"] == 12.33
        assert reader.last()["late"] == 4999
        with pytest.raises(NotFoundError, match=r"starts at 0\.0"):
            reader.at(-1)


def test_an_unknown_column_names_those_that_are_like_it(robot: Path) -> None:
    with Recording(robot) as recording:
        with pytest.raises(NotFoundError, match=r"cam\.name"):
            recording["robot"].to_arrow(columns=["cam.nam"])
        with pytest.raises(NotFoundError, match=r"cam\.name"):
            recording["robot"].read(columns=["cam.nam"])
        assert recording["robot"].to_arrow(columns=["pose", "late"]).column_names == ["_ts", "pose", "late"]


def test_the_time_to_read_grows_with_the_number_of_fields_and_not_with_its_square(tmp_path: Path) -> None:
    def best_of_three(fields: int) -> float:
        with Recorder(tmp_path / str(fields)) as recorder:
            for step in range(300):
                recorder.topic("wide").append(_ts=step / 100, **{f"f{at}": at + step / 2 for at in range(fields)})
        with Recording(tmp_path / str(fields)) as recording:
            times = []
            for _ in range(3):
                start = time.process_time()
                table = recording["wide"].to_arrow()
                times.append(time.process_time() - start)
        assert table.num_columns == fields + 1 and table.column(fields).to_pylist()[:2] == [fields - 1, fields - 0.5]
        return min(times)  # of this process, on all threads: others do not count

    assert best_of_three(6000) / best_of_three(1000) < 18  # linear is 6, and its square 36


def test_fields_that_few_rows_have_are_found(tmp_path: Path) -> None:
    rows = [{f"f{at}": at, f"f{(at * 7) % 100}": -at, "_ts": float(at)} for at in range(100)]
    with Recorder(tmp_path / "run") as recorder:
        for part in range(0, 100, 20):
            recorder.topic("sparse").append_batch(rows[part : part + 20]).flush()
    with Recording(tmp_path / "run") as recording:
        for columns in (None, [f"f{at}" for at in range(0, 100, 2)]):
            found = recording["sparse"].to_arrow(columns=columns).to_pylist()
            kept = [{k: v for k, v in row.items() if columns is None or k in (*columns, "_ts")} for row in rows]
            assert [{k: v for k, v in row.items() if v is not None} for row in found] == kept


def test_integers_of_a_column_of_several_kinds_stay_integers_beside_rows_with_a_side_key(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        rows = [{"odd": 0, "v": 0.0}, {"odd": 0.0, "v": 1.0}, {"odd": "", "v": math.inf}]
        recorder.topic("t").append_batch([{**row, "_ts": float(number)} for number, row in enumerate(rows)])
    with Recording(tmp_path) as recording:
        assert recording["t"].to_arrow().to_pydict()["odd"] == ["0", "0.0", '""']
