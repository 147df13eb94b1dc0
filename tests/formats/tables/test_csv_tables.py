"""CSV becomes a recording: types are those of the cells, and what is a motion capture file goes to its own reader."""

from __future__ import annotations

import csv
import io
import math
import tempfile
import tracemalloc
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ml_dash_mcap import Recorder, Recording, convert
from ml_dash_mcap.errors import ConversionWarning, ForeignFileError, OptionError, UsageError
from ml_dash_mcap.formats import registry
from ml_dash_mcap.formats.tables.csv import tokens
from ml_dash_mcap.formats.tables.csv.types import CellTypes
from tests.formats.tables.test_parquet import normal, rows
from tests.support import shared
from tests.support.examples import examples
from tests.support.row_shapes import typed


def written(folder: Path, text: str | bytes, name: str = "table.csv") -> Path:
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return folder / name


def fields(folder: Path, text: str | bytes, **options: Any) -> list[dict[str, Any]]:
    path = written(folder, text)
    if options:
        path = convert(path, folder / "run", **options)
    return rows(path)


def column(folder: Path, *cells: str, header: str = "time,x") -> list[Any]:
    lines = [header, *(f"{at},{cell}" for at, cell in enumerate(cells))]
    text = "\n".join(line.replace("0,", "0.0,", 1) if at == 1 else line for at, line in enumerate(lines))
    return [row["x"] for row in fields(folder, text + "\n")]


@pytest.mark.parametrize(
    ("cells", "expected"),
    [
        (["1", "-2", "+3"], [1, -2, 3]),
        (["9223372036854775807", "0"], [2**63 - 1, 0]),
        (["18446744073709551615", "0"], [2**64 - 1, 0]),
        (["18446744073709551616", "0"], ["18446744073709551616", "0"]),
        (["-9223372036854775809"], ["-9223372036854775809"]),
        (["1", "2.5", ""], [1.0, 2.5, None]),
        (["1e3", ".5", "-5.", "+1.5"], [1000.0, 0.5, -5.0, 1.5]),
        (["inf", "-inf", "Infinity"], [math.inf, -math.inf, math.inf]),
        (["9007199254740993", "0.5"], [9007199254740993, 0.5]),
        (["true", "False", "", "TRUE"], [True, False, None, True]),
        (["true", "1"], ["true", "1"]),
        (["1", "NA", "3"], [1, None, 3]),
        (["0.5", "null", "N/A"], [0.5, None, None]),
        (["a", "NA", ""], ["a", "NA", None]),
        (["NA", "NA"], ["NA", "NA"]),
        (["007", "8"], ["007", "8"]),
        (["0x10", "1"], ["0x10", "1"]),
        (["1_000"], ["1_000"]),
        (["2024-01-01"], ["2024-01-01"]),
        (['"1"', '"2"'], ["1", "2"]),
        (['""', "", "a"], ["", None, "a"]),
        (['"two\nlines"', '"a,b"', '"say ""hi"""'], ["two\nlines", "a,b", 'say "hi"']),
        (['5" pipe', "x"], ['5" pipe', "x"]),
        (["=1+1", "-x", "'-x"], ["=1+1", "-x", "'-x"]),
        (["größe", "\u4e2d"], ["größe", "\u4e2d"]),
        (["", ""], [None, None]),
        ([" 1", "2 "], [1, 2]),
    ],
)  # fmt: skip
def test_a_column_has_the_type_that_holds_its_cells(tmp_path: Path, cells: list[str], expected: list[Any]) -> None:
    assert typed(column(tmp_path, *cells)) == typed(expected)


def test_not_a_number_is_one(tmp_path: Path) -> None:
    found = column(tmp_path, "NaN", "nan", "1")
    assert math.isnan(found[0]) and math.isnan(found[1]) and typed(found[2]) == typed(1.0)


def test_a_file_that_quotes_everything_says_nothing_by_its_quotes(tmp_path: Path) -> None:
    text = '"time","n","x"\n"0.5","1","1.5"\n"1.5","",""\n'
    assert fields(tmp_path, text) == [{"n": 1, "x": 1.5, "_ts": 0.5}, {"n": None, "x": None, "_ts": 1.5}]


@pytest.mark.parametrize("separator", [",", ";", "\t", "|"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_separators_line_ends_and_marks_are_told(tmp_path: Path, separator: str, end: str, mark: str) -> None:
    lines = [["time", "n", "s"], ["0.5", "1", "a"], ["1.5", "", '"b b"'], ["", "", ""], ["2.5", "3", ""]]
    text = mark + end.join(separator.join(line) for line in lines)
    for data in (text, text + end, text + end + end):
        assert rows(written(tmp_path, data)) == [
            {"n": 1, "s": "a", "_ts": 0.5},
            {"n": None, "s": "b b", "_ts": 1.5},
            {"n": 3, "s": None, "_ts": 2.5},
        ]


def test_units_in_brackets_are_the_topics(tmp_path: Path) -> None:
    path = written(tmp_path, "Time (s),force [N],angle (deg),side (left),x\n0.5,1,2,3,4\n")
    with Recording(path) as recording:
        assert recording.topics["table"].metadata["units"] == {"force [N]": "N", "angle (deg)": "deg"}
        assert list(recording.topics["table"].fields) == ["force [N]", "angle (deg)", "side (left)", "x"]


def test_lines_without_text_say_nothing_at_any_place(tmp_path: Path) -> None:
    text = "\n,,\n  \t \ntime,n,\n\n0.5,1,\n , ,\n\n,,\n1.5,2,\n,\n"
    assert fields(tmp_path, text) == [{"n": 1, "_ts": 0.5}, {"n": 2, "_ts": 1.5}]
    with pytest.raises(ForeignFileError, match="line 11, column 3: the row has 3 cells, but the header 2"):
        fields(tmp_path, text.replace("time,n,", "time,n").replace("1.5,2,", "\n1.5,2,3"))


def test_a_tsv_file_is_one_too(tmp_path: Path) -> None:
    assert rows(written(tmp_path, "time\tx\n0.5\t1\n", "t.tsv")) == [{"x": 1, "_ts": 0.5}]


def test_commas_before_fractions_are_read_where_they_do_not_separate(tmp_path: Path) -> None:
    text = "Time (s);x;s\n0,5;-1,25e2;a,b\n1,5;3;\n"
    assert fields(tmp_path, text) == [{"x": -125.0, "s": "a,b", "_ts": 0.5}, {"x": 3.0, "s": None, "_ts": 1.5}]
    assert fields(tmp_path, 'time,x\n0.5,"1,5"\n') == [{"x": "1,5", "_ts": 0.5}]


def test_text_of_other_encodings(tmp_path: Path) -> None:
    text = "time,s\n0.5,größe\n"
    assert rows(written(tmp_path, text.encode("utf-16"))) == [{"s": "größe", "_ts": 0.5}]
    path = written(tmp_path, text.encode("latin-1"))
    with pytest.raises(ForeignFileError, match=r"line 2: the byte 0xf6 is no UTF-8; pass encoding="):
        Recording(path)
    assert rows(convert(path, tmp_path / "run", encoding="cp1252")) == [{"s": "größe", "_ts": 0.5}]
    with pytest.raises(OptionError, match="encoding='utf-9' is none"):
        convert(path, tmp_path / "no", encoding="utf-9")


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", r"line 1: the file is empty"),
        (
            "a,b\n1,2\n",
            r"no column is called like a time; pass time_column= to convert\(\), one of a \(int64\), b \(int64\)",
        ),
        ("time,x\n0.5,1,2\n", "line 2, column 3: the row has 3 cells, but the header 2"),
        ("time,x\n0.5,1\n1.5\n", "line 3: the row has 1 cells, but the header 2; pass on_bad='missing'"),
        ('time,x\n0.5,"1\n', "line 2: a quote that begins in this row does not end"),
        ("time,x\n0.5,1\n,2\n", "line 3: the time is None in the column 'time'"),
        ("time,x\n0.5,1\nnan,2\n", "line 3: the time is nan in the column 'time'"),
        ('time,x\n0.5,"a\nb"\n-1.0,2\n', "line 4: the time is -1.0.*pass start="),
        ("time,x\nyesterday,1\n", "the column 'time' has the text 'yesterday', which is no time as ISO 8601"),
        ("time,x\n1,1\n2,2\n", "the column 'time' has the integers 1.* to 2.*pass time_unit="),
    ],
)
def test_what_is_wrong_is_said_with_its_place(tmp_path: Path, text: str, what: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(ForeignFileError, match=f"(?s)table.csv.*{what}"):
        convert(path, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_what_is_missing_can_be_left_out(tmp_path: Path) -> None:
    text = "time,x,y\n0.5,1,2\n1.5\n,5,6\n2.5,7\n"
    with pytest.warns(ConversionWarning, match="1 rows without a time were left out"):
        found = fields(tmp_path, text, on_bad="missing")
    assert found == [
        {"x": 1, "y": 2, "_ts": 0.5},
        {"x": None, "y": None, "_ts": 1.5},
        {"x": 7, "y": None, "_ts": 2.5},
    ]


def test_options_say_what_the_file_does_not(tmp_path: Path) -> None:
    text = "a:b:time\n1,5:x:0\n2,5:y:500\n"
    options = {"separator": ":", "decimal": ",", "time_unit": "ms", "topic": "arm", "start": 2.0}
    assert fields(tmp_path, text, **options) == [
        {"a": 1.5, "b": "x", "time": 0, "_ts": 2.0},
        {"a": 2.5, "b": "y", "time": 500, "_ts": 2.5},
    ]
    with pytest.raises(OptionError, match="separator='ab': pass one letter"):
        convert(tmp_path / "table.csv", tmp_path / "no", separator="ab")
    with pytest.raises(OptionError, match="decimal=';'"):
        convert(tmp_path / "table.csv", tmp_path / "no", decimal=";")
    with pytest.raises(UsageError, match="has no option 'seperator'"):
        convert(tmp_path / "table.csv", tmp_path / "no", seperator=";")


def test_a_table_becomes_another_kind_of_table(tmp_path: Path) -> None:
    path = written(tmp_path, "when;x\n500;1,5\n1500;2,5\n")
    dest = convert(path, tmp_path / "t.parquet", time_column="when", time_unit="ms", flatten=True)
    assert pl.read_parquet(dest).select("_ts", "when", "x").rows() == [(0.5, 500, 1.5), (1.5, 1500, 2.5)]
    with pytest.raises(UsageError, match=r"have no option 'time_colum'.*time_column="):
        convert(path, tmp_path / "no.parquet", time_colum="when")
    assert sorted(one.name for one in tmp_path.iterdir()) == ["t.parquet", "table.csv"]


def test_times_in_text_are_instants(tmp_path: Path) -> None:
    text = "timestamp,x\n2024-01-01T00:00:00.25Z,1\n2024-01-01T01:00:00.5+01:00,2\n"
    assert [row["_ts"] for row in fields(tmp_path, text)] == [1_704_067_200.25, 1_704_067_200.5]
    assert fields(tmp_path, text)[0]["timestamp"] == "2024-01-01T00:00:00.25Z"


def test_nanoseconds_stay_exact_beside_the_time_stamp(tmp_path: Path) -> None:
    stamps = [1_700_000_000_123_456_789 + 50 * at for at in range(8)]
    text = "timestamp,x\n" + "".join(f"{stamp},{at}\n" for at, stamp in enumerate(stamps))
    assert [row["timestamp"] for row in fields(tmp_path, text)] == stamps


def test_rows_are_never_merged_and_names_stay(tmp_path: Path) -> None:
    text = "time,,q.0,x y,x y,_exact\n0.5,1,2,3,4,5\n0.5,6,7,8,9,10\n"
    names = ("", "q.0", "x y", "x y#2", "fields._exact")
    assert fields(tmp_path, text) == [
        {**dict(zip(names, (1, 2, 3, 4, 5), strict=True)), "_ts": 0.5},
        {**dict(zip(names, (6, 7, 8, 9, 10), strict=True)), "_ts": 0.5},
    ]


@pytest.mark.parametrize("size", [1, 7, 64])
def test_the_rows_are_the_same_however_many_bytes_are_read_at_a_time(
    tmp_path: Path, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tokens, "_CHUNK_BYTES", size)
    cells = [(at / 2, at, f"ü{at}", 'x"\r\ny,' if at % 3 else "") for at in range(40)]
    out = io.StringIO(newline="")
    csv.writer(out, lineterminator="\r\n").writerows([("time", "n", "s", "q"), *cells])
    found = fields(tmp_path, out.getvalue().encode())
    assert found == [{"n": n, "s": s, "q": q or None, "_ts": time} for time, n, s, q in cells]


def frame() -> pd.DataFrame:
    generator = np.random.default_rng(3)
    return pd.DataFrame(
        {
            "time": np.arange(500) / 100,
            "x": generator.normal(size=500) * 10.0 ** generator.integers(-9, 9, 500),
            "n": generator.integers(-(2**40), 2**40, 500),
            "s": ["a,b", "c", 'say "hi"', "two\nlines", "x y"] * 100,
            "ok": [True, False] * 250,
        }
    )


WRITERS = {
    "pandas": lambda frame, path: frame.to_csv(path, index=False),
    "pandas, all quoted": lambda frame, path: frame.to_csv(path, index=False, quoting=csv.QUOTE_ALL),
    "pandas, text quoted": lambda frame, path: frame.to_csv(path, index=False, quoting=csv.QUOTE_NONNUMERIC),
    "pandas, German": lambda frame, path: frame.to_csv(path, index=False, sep=";", decimal=","),
    "polars": lambda frame, path: pl.from_pandas(frame).write_csv(path),
    "duckdb": lambda frame, path: duckdb.sql(f"copy (select * from frame) to '{path}' (format csv)"),
}


@pytest.mark.parametrize("writer", WRITERS)
def test_files_of_other_writers_are_read_as_they_were_written(tmp_path: Path, writer: str) -> None:
    table = frame()
    WRITERS[writer](table, tmp_path / "t.csv")
    expected = [{**row, "_ts": row.pop("time")} for row in table.to_dict("records")]
    found = rows(tmp_path / "t.csv")
    if writer.startswith("pandas, text"):
        for row in found:
            row["ok"] = row["ok"] if isinstance(row["ok"], bool) else row["ok"] == "True"
    assert found == [{key: row[key] for key in ("x", "n", "s", "ok", "_ts")} for row in expected]


@settings(max_examples=examples(200), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    cells=st.lists(st.lists(st.text('ab",;\r\n\té 1.-', max_size=5), min_size=2, max_size=2), min_size=1, max_size=6),
    separator=st.sampled_from(",;\t"),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
    has_end=st.booleans(),
    size=st.sampled_from([1, 2, 5, 17, 1000]),
)
def test_any_cells_are_those_that_pythons_csv_says(
    cells: list[list[str]], separator: str, end: str, has_end: bool, size: int
) -> None:
    out = io.StringIO(newline="")
    table = [["time", "a", "b"], *([f"{at}.5", *row] for at, row in enumerate(cells))]
    how = csv.QUOTE_MINIMAL if end == "\r\n" else csv.QUOTE_ALL  # Python quotes the letters of its line end only
    csv.writer(out, delimiter=separator, quoting=how, lineterminator=end).writerows(table)
    text = out.getvalue() if has_end else out.getvalue().removesuffix(end)
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr(tokens, "_CHUNK_BYTES", size)
        path = written(Path(folder), text)
        found = [part.cells.to_pylist() for part in tokens.Tokens(path, separator, 3).read()]
    flat = [cell for part in found for cell in part]
    assert [flat[at : at + 3] for at in range(0, len(flat), 3)] == table[1:]


# -- ours -------------------------------------------------------------------------------------------------------------

OURS = [
    {"q": [0.5, 1.0], "m": [[1, 2], [3, 4]], "pose": {"xyz": [1.0, 2.0, 3.0], "frame": "base"}, "n": 1, "_ts": 0.0},
    {"q": [math.inf, -2.5], "on": True, "s": "007", "e": "", "f": "=1+1", "_ts": 0.25},
    {"ragged": [1, 2, 3], "s": "two\nlines", "f": "'=x", "mixed": 1, "big": 2**64 - 1, "_ts": 0.5},
    {"ragged": [4], "mixed": "1", "parts": [{"id": 1}], "empty": {}, "timestamp": 7, "_ts": 0.75},
    {"mixed": "x", "f": "-5", "s": "NA", "_ts": 1.0},
]


def test_what_we_exported_comes_back_as_the_rows_that_it_was(tmp_path: Path) -> None:
    with Recorder(tmp_path / "run") as recorder:
        recorder.topic("robot/arm 1").append_batch(OURS)
        recorder.topic("imu").append_columns(_ts=np.arange(3.0), accel=np.arange(9.0).reshape(3, 3))
    with Recording(tmp_path / "run") as recording:
        folder = recording.export(tmp_path / "out", format="csv")
        with Recording(folder) as back:
            assert sorted(back.topics) == ["imu", "robot/arm 1"]
            for topic in back.topics:
                assert typed(normal(back[topic].rows())) == typed(normal(recording[topic].rows()))


OWN = st.fixed_dictionaries(
    {},
    optional={
        "v": st.lists(st.floats(), min_size=3, max_size=3),
        "n": st.integers(-(2**63), 2**63 - 1),
        "x": st.floats(),
        "s": st.text(st.characters(exclude_categories=["Cs"], exclude_characters="[{\0"), max_size=5)
        | st.sampled_from(["1", "true", "", "NA", "=a", "'=a", " x", "1e5"]),
        "on": st.booleans(),
        "p": st.fixed_dictionaries({"x": st.floats(allow_nan=False)}, optional={"y": st.text("ab")}),
        "odd": st.integers(0, 3) | st.text("x1", max_size=2) | st.booleans() | st.floats(0, 1),
    },
)


@settings(max_examples=examples(40), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(drawn=st.lists(OWN, min_size=1, max_size=6))
def test_any_rows_of_ours_come_back(drawn: list[dict[str, Any]]) -> None:
    given_rows = [{**row, "_ts": at / 8} for at, row in enumerate(drawn)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with Recorder(folder / "run") as recorder:
            recorder.topic("robot").append_batch(given_rows)
        with Recording(folder / "run") as recording:
            path = recording.export(folder / "robot.csv", format="csv")
            floats = {"n", "odd"} & {
                key
                for key, column in recording["robot"].to_arrow().to_pydict().items()
                if any(type(one) is float for one in column)
            }
        found = rows(path)
    for row in given_rows:
        for key in floats & row.keys():
            row[key] = float(row[key]) if type(row[key]) is int else row[key]
    assert typed(normal(found)) == typed(normal(given_rows))


# -- which reader -----------------------------------------------------------------------------------------------------


def test_a_take_goes_to_the_reader_of_its_format() -> None:
    assert registry.detect(shared.file("mocap/a-motive-1.21-rigidbody.csv")) == "mocap"


def test_a_take_among_tables_is_named(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    written(tmp_path / "in", "time,x\n0.5,1\n", "a.csv")
    written(tmp_path / "in", "Trajectories\n100\n", "b.csv")
    with pytest.raises(ForeignFileError, match=r"b\.csv: it is no plain table but of the format 'vicon'"):
        convert(tmp_path / "in", tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("text", "name", "format"),
    [
        ("Format Version,1.23,Take Name,x\n", "t.csv", "mocap"),
        ("Trajectories\n100\n", "t.csv", "vicon"),
        ("frame,time,q.0\n0,0.0,1.5\n", "t.csv", "wide"),
        ("time,x\n0.5,1\n", "t.csv", "csv"),
        ("time\tx\n0.5\t1\n", "t.tsv", "csv"),
        ("time,x\n0.5,1\n", "notes.txt", None),
    ],
)
def test_a_text_file_is_detected_by_its_first_line(tmp_path: Path, text: str, name: str, format: str | None) -> None:
    assert registry.detect(written(tmp_path, text, name)) == format


def test_a_column_is_text_if_no_type_holds_its_integers_in_whichever_part_of_the_file_they_stand() -> None:
    types = CellTypes()
    for cells in (["-5", "1"], [str(2**63)]):
        types.add(pa.array(cells), None, ".")
    assert types.type(heeds_quotes=False, is_ours=False) == pa.string()


def test_memory_is_bounded_by_what_is_read_at_a_time(tmp_path: Path) -> None:
    path = tmp_path / "long.csv"
    with path.open("w") as file:
        file.write("time,x,s\n")
        for at in range(200_000):
            file.write(f"{at / 100},{at},{'text' * 10} {at}\n")
    tracemalloc.start()
    assert sum(part.height for part in tokens.Tokens(path, ",", 3).read()) == 200_000
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert path.stat().st_size > 12e6 and peak < 6e6 + 6 * tokens._CHUNK_BYTES
