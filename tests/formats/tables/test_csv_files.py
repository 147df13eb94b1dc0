"""CSV files hold the numbers as they were recorded, for every reader of CSV, and nothing that a spreadsheet would run."""

from __future__ import annotations

import base64
import csv
import io
import itertools
import json
import math
import tempfile
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pandas as pd
import polars as pl
import pyarrow.csv as pv
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ml_dash_mcap import Recording
from ml_dash_mcap.cli import main
from ml_dash_mcap.formats.tables.csv.write import stream
from ml_dash_mcap.query.stored_topic import StoredTopic
from ml_dash_mcap.query.topic_part import TopicPart
from ml_dash_mcap.rows.dotted import flatten
from tests.formats.tables.test_parquet_files import _a_block_a_chunk, recording, steps  # noqa: F401
from tests.read.test_columns import ROWS
from tests.support.examples import examples


def exported(rec: Recording, **options: Any) -> Path:
    return rec.export(rec.path.parent / "robot.csv", format="csv", topics=["robot"], **options)


def lines(path: Path) -> list[str]:
    return path.read_bytes().decode("utf-8").split("\n")


def cells(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file, strict=True))


def test_a_topic_is_a_line_a_row_and_a_column_a_number(tmp_path: Path) -> None:
    first = {"q": [0.5, 1.0], "pose": {"xyz": [1.0, 2.0, 3.0]}, "m": [[1, 2], [3, 4]], "on": True, "raw": b"\x00\x01"}
    second = {"name": "größe", "n": 2**64 - 1}
    assert lines(exported(recording(tmp_path, steps(1, 0.0, **first), steps(1, 0.1, **second)))) == [
        "_ts,q.0,q.1,pose.xyz.0,pose.xyz.1,pose.xyz.2,m.0.0,m.0.1,m.1.0,m.1.1,on,raw,name,n",
        "0.0,0.5,1.0,1.0,2.0,3.0,1,2,3,4,true,AAE=,,",
        "0.1,,,,,,,,,,,,größe,18446744073709551615",
        "",
    ]


@pytest.mark.parametrize(
    ("value", "cell"),
    [
        (0.1 + 0.2, "0.30000000000000004"),
        (1.0, "1.0"),
        (-0.0, "-0.0"),
        (1e300, "1e+300"),
        (5e-324, "5e-324"),
        (-1.5, "-1.5"),
        (-3, "-3"),
        (math.nan, "NaN"),
        (math.inf, "inf"),
        (-math.inf, "-inf"),
        (True, "true"),
        (None, ""),
        ("", '""'),
        ("plain", "plain"),
        ("007", '"007"'),
        ("1.5e-3", '"1.5e-3"'),
        ("12.", '"12."'),
        ("NaN", '"NaN"'),
        ("Inf", '"Inf"'),
        ("true", '"true"'),
        ("NULL", '"NULL"'),
        ("n/a", '"n/a"'),
        (" blank", '" blank"'),
        ("nano", "nano"),
        ("1.2.3", "1.2.3"),
        (b"\xd7\x6d\xf8", '"1234"'),
        (b"\xf8\x00\x00", "+AAA"),
        ("'=1+1", "''=1+1"),
        ("'tis", "'tis"),
        ("a,b", '"a,b"'),
        ('say "hi"', '"say ""hi"""'),
        ("two\nlines", '"two\nlines"'),
        ("=1+1", "'=1+1"),
        ("+1", "'+1"),
        ("-1", "'-1"),
        ("@x", "'@x"),
        ("\tx", "'\tx"),
        ("\rx", '"\'\rx"'),
        ('=a,"b"', '"\'=a,""b"""'),
        ("a=b", "a=b"),
        ({}, "{}"),
        ([{"a": 1}], '"[{""a"":1}]"'),
        ([[1], [2, 3]], None),
    ],
)
def test_a_value_is_written_so(tmp_path: Path, value: Any, cell: str | None) -> None:
    text = exported(recording(tmp_path, steps(1, x=value))).read_bytes().decode()
    if cell is None:
        assert text == "_ts,x.0.0,x.0.1,x.1.0,x.1.1\n0.0,1,,2,3\n"
    else:
        assert text == f"_ts,x\n0.0,{cell}\n"


def test_a_field_of_various_kinds_shows_each_value_as_it_is(tmp_path: Path) -> None:
    values = [1, -2.5, "-x", None, True, [1, 2], b"\x00", math.nan, "text"]
    shown = ["1", "-2.5", "'-x", "", "true", '"[1,2]"', "AA==", "NaN", "text"]
    rows = [{"x": value, "_ts": float(at)} for at, value in enumerate(values)]
    assert lines(exported(recording(tmp_path, rows)))[1:-1] == [f"{at}.0,{cell}" for at, cell in enumerate(shown)]


def test_a_name_is_quoted_and_made_safe_like_a_value(tmp_path: Path) -> None:
    rec = recording(tmp_path, steps(1, **{"=cmd()": 1, "a,b": 2}))
    assert lines(exported(rec))[0] == '_ts,\'=cmd(),"a,b"'


def test_elements_never_take_the_name_of_another_field(tmp_path: Path) -> None:
    rec = recording(tmp_path, steps(1, **{"q.0": 7, "q": [1.0, 2.0]}))
    assert lines(exported(rec))[:2] == ["_ts,q.0,q.0#2,q.1", "0.0,7,1.0,2.0"]


def test_later_and_longer_lists_make_room_beside_the_first_ones(tmp_path: Path) -> None:
    rec = recording(tmp_path, steps(1, 0.0, q=[1], n=1), steps(1, 1.0, q=[1, 2, 3]), steps(1, 2.0, q=[], late="x"))
    assert lines(exported(rec)) == ["_ts,q.0,q.1,q.2,n,late", "0.0,1,,,1,", "1.0,1,2,3,,", "2.0,,,,,x", ""]


def test_a_list_of_a_thousand_numbers_is_spread_and_a_longer_one_is_a_cell(tmp_path: Path) -> None:
    rec = recording(tmp_path, steps(1, wide=list(range(1000)), wider=list(range(1001))))
    header, row = csv.reader(io.StringIO(exported(rec).read_text()))
    assert header == ["_ts", *(f"wide.{at}" for at in range(1000)), "wider"]
    assert json.loads(row[-1]) == list(range(1001))


def test_a_stream_is_the_file(tmp_path: Path) -> None:
    rec = recording(tmp_path, steps(2, 0.0, q=[1], n=1), steps(2, 1.0, q=[1, 2], s="a,b"))
    out = io.BytesIO()
    with rec:
        stream(TopicPart(StoredTopic(rec._opened(), "robot")), rec.topics["robot"], out)
        assert out.getvalue() == exported(rec).read_bytes()


def test_a_stream_has_the_columns_that_were_asked_for(tmp_path: Path) -> None:
    schema = {"type": "object", "properties": {"a": {"type": "number"}, "b": {"type": "number"}}}
    rec = recording(tmp_path, steps(1, a=1, b=2), schemas={"robot": schema})
    out = io.BytesIO()
    with rec:
        stream(TopicPart(StoredTopic(rec._opened(), "robot"), columns=["b"]), rec.topics["robot"], out)
    assert out.getvalue() == b"_ts,b\n0.0,2\n"


READERS = {
    "pandas": lambda path: pd.read_csv(path)["x"].tolist(),
    "polars": lambda path: pl.read_csv(path)["x"].to_list(),
    "duckdb": lambda path: [one for (one,) in duckdb.sql(f"select x from '{path}'").fetchall()],
    "pyarrow": lambda path: pv.read_csv(path)["x"].to_pylist(),
}


@pytest.mark.parametrize("reader", READERS)
def test_a_column_with_nan_and_infinities_is_numbers_for_every_reader(tmp_path: Path, reader: str) -> None:
    values = [1.5, math.nan, math.inf, -math.inf, None, 2.0]
    path = exported(recording(tmp_path, [{"x": value, "_ts": float(at)} for at, value in enumerate(values)]))
    found = READERS[reader](path)
    assert found[0::5] == [1.5, 2.0] and found[2:4] == [math.inf, -math.inf]
    assert all(one is None or math.isnan(one) for one in (found[1], found[4]))  # pandas and pyarrow tell no difference
    if reader in ("polars", "duckdb"):
        assert math.isnan(found[1]) and found[4] is None


def test_empty_text_and_no_text_stay_apart_for_readers_that_heed_quotes(tmp_path: Path) -> None:
    values = ["two\nlines", "", None, "007", "NaN", 'say "hi"']
    path = exported(recording(tmp_path, [{"x": value, "_ts": float(at)} for at, value in enumerate(values)]))
    assert pl.read_csv(path)["x"].to_list() == values
    heeding = pv.ConvertOptions(strings_can_be_null=True, quoted_strings_can_be_null=False)
    with_breaks = pv.ParseOptions(newlines_in_values=True)
    assert pv.read_csv(path, convert_options=heeding, parse_options=with_breaks)["x"].to_pylist() == values
    assert [row["x"] for row in cells(path)] == [value or "" for value in values]


def test_the_command_line_and_write_spell_them_alike(tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]) -> None:
    rec = recording(tmp_path, [{"x": value, "_ts": float(at)} for at, value in enumerate([math.nan, "1", ""])])
    with rec:
        out = io.BytesIO()
        rec["robot"].write(out, format="csv")
        assert out.getvalue() == b'_ts,x\n0.0,NaN\n1.0,"1"\n2.0,""\n' == exported(rec).read_bytes()
    assert main(["cat", str(rec.path), "robot", "--format", "csv"]) == 0
    assert capfdbinary.readouterr().out == out.getvalue()


def test_other_readers_give_the_numbers_back(tmp_path: Path) -> None:
    generator = np.random.default_rng(1)
    numbers = generator.normal(size=(500, 3)) * 10.0 ** generator.integers(-12, 12, size=(500, 3))
    rows = [{"q": row.tolist(), "_ts": 1.7e9 + at / 3} for at, row in enumerate(numbers)]
    path = exported(recording(tmp_path, rows[:200], rows[200:]))
    wanted = np.column_stack([[row["_ts"] for row in rows], numbers])
    assert (pd.read_csv(path, dtype=str).astype(float).to_numpy() == wanted).all()
    assert (pl.read_csv(path).to_numpy() == wanted).all()
    assert (np.column_stack(list(duckdb.sql(f"select * from '{path}'").fetchnumpy().values())) == wanted).all()
    assert (np.loadtxt(path, delimiter=",", skiprows=1) == wanted).all()


# The cells of random rows, against a model that knows all rows beforehand.


def shown(value: Any, cell: str) -> bool:
    """Whether a cell shows a single value."""
    if value is None:
        return cell == ""
    if isinstance(value, bool):
        return cell == str(value).lower()
    if isinstance(value, int):
        return float(cell) == value if abs(value) <= 2**53 else int(cell) == value
    if isinstance(value, float):
        return repr(float(cell)) == repr(value)
    if isinstance(value, bytes):
        return base64.b64decode(cell) == value
    is_like_a_formula = value.lstrip("'").startswith(("=", "+", "-", "@", "\t", "\r"))
    return bool(cell == (f"'{value}" if is_like_a_formula else value))


def longest(values: list[Any]) -> list[int]:
    """The greatest lengths of lists, the outermost first."""
    lists = [value for value in values if isinstance(value, list)]
    return [max(map(len, lists)), *longest(list(itertools.chain(*lists)))] if lists else []


def pick(value: Any, index: tuple[int, ...]) -> Any:
    for at in index:
        value = None if value is None or at >= len(value) else value[at]
    return value


@settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(st.lists(ROWS, min_size=1, max_size=3), min_size=1, max_size=4))
def test_every_cell_shows_its_value(chunks: list[list[dict[str, Any]]]) -> None:
    numbers = iter(range(100))
    timed = [[{**row, "_ts": float(next(numbers))} for row in rows] for rows in chunks]
    with tempfile.TemporaryDirectory() as folder:
        rec = recording(Path(folder), *timed)
        found = cells(exported(rec))
        flat = [flatten(row, "_ts") for row in rec["robot"].rows()]
        rec.close()
    assert len(found) == len(flat)
    for name in dict.fromkeys(name for row in flat for name in row):
        column = [row.get(name) for row in flat]
        if not any(isinstance(value, (list, dict)) for value in column):
            if name in found[0] or any(value is not None for value in column):
                assert all(shown(value, row[name]) for value, row in zip(column, found, strict=True))
        elif name in ("vector", "ragged", "matrix") and any(column):
            indices = list(itertools.product(*map(range, longest(column))))
            assert [key for key in found[0] if key.startswith(f"{name}.")] == [
                ".".join(map(str, (name, *index))) for index in indices
            ]
            for index in indices:
                cell = ".".join(map(str, (name, *index)))
                assert all(shown(pick(value, index), row[cell]) for value, row in zip(column, found, strict=True))
