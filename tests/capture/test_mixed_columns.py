"""Columns of any kinds go together, and mean what `append` would have made of their rows."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from ml_dash_mcap import Recorder, Recording
from ml_dash_mcap.errors import FieldError
from tests.support.case_ids import stable_repr
from tests.support.examples import examples


@dataclasses.dataclass
class Pose:
    x: float
    y: Any = None


class Mode(enum.Enum):
    FAST = "fast"


NUMBERS = ["f8", "f4", "f2", ">f8", "i8", "i4", "i2", "i1", "u8", "u4", "u2", "u1", ">i4", "?"]
OTHERS = ["U3", "S2", "M8[ns]", "M8[D]", "m8[ms]", "O"]
RECORD = np.dtype([("a", "i4"), ("b", "f8", (2,)), ("c", [("d", "U2")])])


def dense(count: int, dtype: str) -> st.SearchStrategy[Any]:
    if dtype == "O":
        return objects(count).map(lambda values: pd.Series(values, dtype=object).to_numpy())
    shape = (
        st.just((count,))
        if dtype in OTHERS
        else st.sampled_from([(count,), (count, 3), (count, 2, 2), (count, 0), (count, 70)])
    )
    elements = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=3) if dtype == "U3" else None
    return shape.flatmap(lambda one: arrays.arrays(np.dtype(dtype), one, elements=elements))


def masked(count: int) -> st.SearchStrategy[Any]:
    def mask(values: Any) -> st.SearchStrategy[Any]:
        covers = arrays.arrays(np.bool_, values.shape, elements=st.booleans())
        return covers.map(lambda cover: np.ma.MaskedArray(values, cover))

    return st.sampled_from([*NUMBERS, "U3", "M8[D]"]).flatmap(lambda dtype: dense(count, dtype)).flatmap(mask)


def objects(count: int) -> st.SearchStrategy[list[Any]]:
    one = st.one_of(
        st.none(),
        st.floats(),
        st.text(max_size=3),
        st.binary(max_size=3),
        st.lists(st.integers(-3, 3), max_size=2),
        st.dictionaries(st.sampled_from(["a", "b"]), st.none() | st.floats(), max_size=2),
        st.sampled_from([Pose(1.0, np.array([2, 3])), Mode.FAST, np.float32(0.5), np.datetime64("2020-01-01")]),
    )
    return st.lists(one, min_size=count, max_size=count)


def of_libraries(count: int) -> st.SearchStrategy[Any]:
    """Series, indexes and Arrow arrays of numbers and texts, with gaps."""
    numbers = st.lists(st.integers(-5, 5) | st.none(), min_size=count, max_size=count)
    texts = st.lists(st.text(max_size=2) | st.none(), min_size=count, max_size=count)
    make: list[Callable[[Any], Any]] = [
        lambda values: pd.Series(values, dtype="Int64", index=range(len(values), 0, -1)),
        lambda values: pl.Series(values, dtype=pl.Int64),
        lambda values: pa.array(values, pa.int16()),
    ]
    as_text: list[Callable[[Any], Any]] = [
        lambda values: pd.Series(values, dtype="string"),
        lambda values: pd.Index(["" if value is None else value for value in values]),
        lambda values: pa.chunked_array([pa.array(values, pa.string())]),
    ]
    return st.one_of(
        st.tuples(st.sampled_from(make), numbers).map(lambda one: one[0](one[1])),
        st.tuples(st.sampled_from(as_text), texts).map(lambda one: one[0](one[1])),
    )


def column(count: int, depth: int = 0) -> st.SearchStrategy[Any]:
    kinds = [
        st.sampled_from([*NUMBERS, *OTHERS]).flatmap(lambda dtype: dense(count, dtype)),
        masked(count),
        objects(count),
        st.lists(st.floats(), min_size=count, max_size=count),
        st.just([f"{number}" for number in range(count)]),
        st.just(np.zeros(count, RECORD)),
        of_libraries(count),
    ]
    if depth < 2:
        inner = st.deferred(lambda: column(count, depth + 1))
        kinds.append(st.dictionaries(st.sampled_from(["p", "q.r", "\u00e4", "_x"]), inner, min_size=1, max_size=2))
    return st.one_of(kinds)


ABSENT: Any = object()


def cell(one: Any, row: int) -> Any:
    """A column's value in a row: what is masked as a whole is not there, a dict has what is there of its columns."""
    if isinstance(one, dict):
        values = {key: cell(inner, row) for key, inner in one.items()}
        return {key: value for key, value in values.items() if value is not ABSENT} or ABSENT
    if isinstance(one, np.ma.MaskedArray) and one[row].size and np.ma.getmaskarray(one)[row].all():
        return ABSENT
    if type(one).__module__.startswith("pandas"):
        return one.iloc[row] if isinstance(one, pd.Series) else one[row]
    return one[row].as_py() if isinstance(one, (pa.Array, pa.ChunkedArray)) else one[row]


def canonical(rows: Any) -> list[str]:
    return [repr({name: _plain(value) for name, value in sorted(row.items())}) for row in rows]


def _plain(value: Any) -> Any:
    return (value.dtype, value.shape, value.tobytes()) if isinstance(value, np.ndarray) else value


def compare(folder: Path, columns: dict[str, Any], count: int) -> None:
    with Recorder(folder) as recorder:
        recorder.topic("columns").append_columns(_ts=np.arange(float(count)), **columns)
        for row in range(count):
            fields = {name: cell(one, row) for name, one in columns.items()}
            present = {name: value for name, value in fields.items() if value is not ABSENT}
            recorder.topic("rows").append(**present, _ts=float(row))
    with Recording(folder) as recording:
        assert canonical(recording["columns"].rows()) == canonical(recording["rows"].rows())


@settings(max_examples=examples(100), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_columns_of_any_kinds_are_the_rows_that_append_would_take(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    count = data.draw(st.integers(1, 5))
    names = st.sampled_from(["a", "b", "c", "timestamp", "a b"])
    columns = data.draw(st.dictionaries(names, column(count), min_size=1, max_size=4))
    compare(tmp_path_factory.mktemp("mixed") / "run", columns, count)


BESIDE: dict[str, Any] = {
    "texts": ["a", "b", None],
    "dicts": [{"x": 1}, {}, {"x": [np.float32(1.5)]}],
    "times": np.array(["2024-01-01", "NaT", "2024-01-02"], "M8[s]"),
    "records": np.zeros(3, RECORD),
    "images": np.arange(3 * 70_000, dtype=np.uint8).reshape(3, 70_000),
    "masked images": np.ma.MaskedArray(np.ones((3, 5000)), np.arange(15_000).reshape(3, 5000) % 3 == 0),
    "series": pd.Series(["x", None, "y"], dtype="string"),
    "infinite": np.array([np.inf, np.nan, 1.0]),
}


@pytest.mark.parametrize("beside", BESIDE)
def test_a_masked_array_and_a_dict_of_arrays_stand_beside_anything(tmp_path: Path, beside: str) -> None:
    gaps = np.ma.MaskedArray([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]], [[0, 0], [1, 1], [0, 1]])
    columns = {"gaps": gaps, "dict": {"inner": gaps, "beside": BESIDE[beside]}, "beside": BESIDE[beside]}
    compare(tmp_path / "run", columns, 3)
    with Recording(tmp_path / "run") as recording:
        rows = list(recording["columns"].rows())
    assert [row.get("gaps", "absent") for row in rows] == [[1.0, 2.0], "absent", [5.0, None]]
    assert [row["dict"].get("inner", "absent") for row in rows] == [[1.0, 2.0], "absent", [5.0, None]]


@pytest.mark.parametrize(
    ("bad", "name"),
    [
        ({"x": np.float64(1)}, "'x'"),
        ({"x": np.array(1)}, "'x'"),
        ({"x": 1}, "'x'"),
        ({"x": None}, "'x'"),
        ({"x": "ab"}, "'x'"),
        ({"x": {1, 2}}, "'x'"),
        ({"x": (value for value in "ab")}, "'x'"),
        ({"x": ["a"]}, "'x' has 1 rows, but _ts has 2"),
        ({"x": {"y": {"z": ["a"]}}}, "'x.y.z' of the dict 'x' has 1 rows, but _ts has 2"),
        ({"x": {"y": 1}}, "'x.y'"),
        ({"x": {1: [1, 2]}}, "'x' has the key 1"),
        ({"x": {}}, "'x'"),
        ({"x": {"_ts": [1, 2]}}, "'x' has the key '_ts'"),
        ({"x": [1, {1, 2}]}, "'x'"),
        ({"x": {"y": [1, object()]}}, "'x'"),
        ({"x": np.zeros(2, complex)}, "'x'"),
        ({"x": pd.Series(["a"])}, "'x' has 1 rows, but _ts has 2"),
        ({"x": pa.array(["a"])}, "'x' has 1 rows, but _ts has 2"),
    ],
    ids=lambda value: stable_repr(value)[:40],
)
def test_a_column_that_is_none_is_named_and_no_row_is_taken(tmp_path: Path, bad: dict[str, Any], name: str) -> None:
    gaps = np.ma.MaskedArray([1.0, 2.0], [0, 1])
    with Recorder(tmp_path / "run") as recorder:
        with pytest.raises(FieldError) as caught:
            recorder.topic("t").append_columns(_ts=[0.0, 1.0], good=["a", "b"], gaps=gaps, **bad)
        assert recorder.stats()["accepted"] == 0
    assert name in str(caught.value)
    assert "'t'" in str(caught.value)
