"""Tables lose nothing: not a column, not a type that one column cannot hold, not a bit."""

import io
import json
import math

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ml_dash_mcap.rows.json_text import restore
from ml_dash_mcap.rows.typed_columns import ENCODING_KEY
from tests.support.examples import examples
from tests.support.tables import from_rows


def column(*values):
    return from_rows([{"a": value, "_ts": float(i)} for i, value in enumerate(values)])


@pytest.mark.parametrize(
    ("values", "type_"),
    [
        ([1, None], pa.int64()),
        ([2**63, 0], pa.uint64()),
        ([-(2**63), 2**63 - 1], pa.int64()),
        ([1, 0.5], pa.float64()),
        ([math.nan, math.inf], pa.float64()),
        ([True, False], pa.bool_()),
        (["x", ""], pa.string()),
        ([b"\x00", b""], pa.binary()),
        ([[1.0, 2.0], [3.0, 4.0]], pa.list_(pa.float64(), 2)),
        ([[1.0, None], None, [3.0, 4.0]], pa.list_(pa.float64())),
        ([[1, 2], [3]], pa.list_(pa.int64())),
        ([["a", "b"]], pa.list_(pa.string())),
        ([[[1.0, 2.0], [3.0, 4.0]]], pa.list_(pa.list_(pa.float64(), 2))),
        ([[{"id": 1, "p": [0.5]}]], pa.list_(pa.struct([("id", pa.int64()), ("p", pa.list_(pa.float64(), 1))]))),
        ([None, None], pa.null()),
        ([[], []], pa.list_(pa.null())),
    ],
)
def test_values_of_one_kind_keep_their_type(values, type_):
    table = column(*values)
    assert table.schema.field("a").type == type_
    assert repr(table.column("a").to_pylist()) == repr(
        [float(v) if type_ == pa.float64() and v is not None else v for v in values]
    )


@pytest.mark.parametrize(
    "values",
    [
        [1, "x"],
        [True, 1],
        [[1], 2],
        [-1, 2**63],
        [2**60, 0.5],
        [{}, {}],
        [[1, "x"], [2, "y"]],
        [[{"a": 1}, {"b": 2}]],
        [b"x", "x"],
    ],
)
def test_values_that_no_type_holds_are_json_text_and_the_column_says_so(values):
    table = column(*values, None)
    assert table.schema.field("a").metadata == {ENCODING_KEY: b"json"}
    assert table.column("a").to_pylist()[-1] is None
    if not any(isinstance(value, bytes) for value in values):
        assert [json.loads(text) for text in table.column("a").to_pylist()[:-1]] == values


def test_what_json_cannot_say_is_wrapped_with_its_spelling():
    assert column("x", [math.nan], b"\x00").column("a").to_pylist() == [
        '"x"',
        '{"_value":[null],"_exact":{"NaN":{"/_value":[0]}}}',
        '{"_value":"AA==","_exact":{"bytes":{"":["_value"]}}}',
    ]


def test_columns_that_only_some_rows_have_are_null_elsewhere():
    table = from_rows([{"a": 1, "_ts": 0.0}, {"b": "x", "_ts": 1.0}, {"a": 2, "c": [1.0], "_ts": 2.0}])
    assert table.column_names == ["_ts", "a", "b", "c"]
    assert table.to_pydict() == {
        "_ts": [0.0, 1.0, 2.0],
        "a": [1, None, 2],
        "b": [None, "x", None],
        "c": [None, None, [1.0]],
    }


@pytest.mark.usefixtures("block_rows")
def test_a_type_that_widens_and_a_column_that_comes_late_lose_nothing():
    rows = [{"a": 1, "_ts": 0.0}, {"a": 0.5, "_ts": 1.0}, {"b": [1], "_ts": 2.0}, {"a": None, "b": [1, 2], "_ts": 3.0}]
    table = from_rows(rows)
    assert table.to_pydict() == {
        "_ts": [0.0, 1.0, 2.0, 3.0],
        "a": [1.0, 0.5, None, None],
        "b": [None, None, [1], [1, 2]],
    }
    assert table.schema.types == [pa.float64(), pa.float64(), pa.list_(pa.int64())]


@pytest.mark.usefixtures("block_rows")
def test_matrices_that_are_missing_in_some_rows_keep_the_length_of_their_rows():
    matrix = np.zeros((2, 3), "f4")
    table = from_rows(
        [{"m": matrix, "_ts": 0.0}, {"m": matrix, "_ts": 1.0}, {"x": 1, "_ts": 2.0}, {"x": 1, "_ts": 3.0}]
    )
    assert table.schema.field("m").type == pa.list_(pa.list_(pa.float32(), 3))
    assert table.column("m").to_pylist() == [matrix.tolist(), matrix.tolist(), None, None]


def test_no_rows_give_a_table_with_the_time_column():
    table = from_rows([], time_name="timestamp")
    assert (table.column_names, table.num_rows, table.schema.field(0).type) == (["timestamp"], 0, pa.float64())


VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | st.text(max_size=3)
    | st.binary(max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from("xyz"), inner, max_size=2),
    max_leaves=6,
)


@pytest.fixture(params=[1, 2, 8192])
def block_rows(request, monkeypatch):
    """Rows that are converted at a time."""
    monkeypatch.setattr("ml_dash_mcap.rows.table.BLOCK_ROWS", request.param)


@pytest.mark.usefixtures("block_rows")
@settings(max_examples=examples(200), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.dictionaries(st.sampled_from(["a", "b"]), VALUES), max_size=6))
def test_any_rows_make_a_table_that_survives_parquet(rows):
    table = from_rows([{**row, "_ts": float(i)} for i, row in enumerate(rows)])
    sink = io.BytesIO()
    pq.write_table(table, sink, compression="zstd")
    read = pq.read_table(io.BytesIO(sink.getvalue()))
    assert read.schema.equals(table.schema)
    assert set(read.column_names) == {"_ts"} | {name for row in rows for name in row}
    for name in set(read.column_names) - {"_ts"}:
        values, found = [row.get(name) for row in rows], read.column(name).to_pylist()
        is_text = (read.schema.field(name).metadata or {}).get(ENCODING_KEY) == b"json"
        assert same([None if text is None else parse(text) for text in found] if is_text else found, values)


def parse(text: str):
    value = json.loads(text)
    wrapped = isinstance(value, dict) and "_exact" in value
    return restore(value)["_value"] if wrapped else value


def same(found, expected) -> bool:
    if isinstance(expected, list):
        return len(found) == len(expected) and all(map(same, found, expected))
    if isinstance(expected, dict):
        return set(found) == set(expected) and all(same(found[key], expected[key]) for key in expected)
    return found == expected or (found != found and expected != expected)
