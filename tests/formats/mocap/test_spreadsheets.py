"""Files as spreadsheets and other programs save them mean what they meant: separators, decimal marks, ends of lines."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ml_dash_mcap.errors import ForeignFileError
from tests.formats.mocap.support import UNIT, read_back, record
from tests.formats.mocap.test_motive import BODY, HEADER
from tests.formats.mocap.test_points import QTM, TRC, VICON
from tests.support.examples import examples

STO = "Coordinates\nversion=1\nnRows=2\nnColumns=3\ninDegrees=yes\nendheader\ntime\thip r\tknee\n0\t1.5\t-2\n0.25\t3\t4.75\n"
WIDE = "frame,time,q.0,q.1,robot:speed\n0,0.5,1.25,-3,2\n1,0.75,2.5,4,\n"
FILES = {
    "x.trc": (TRC, "\t"),
    "motive.csv": (HEADER + BODY, ","),
    "vicon.csv": (VICON, ","),
    "x.tsv": (QTM, "\t"),
    "x.sto": (STO, "\t"),
    "wide.csv": (WIDE, ","),
}
NUMBER = re.compile(r"-?\d+\.\d+")


def saved(text: str, before: str, separator: str, *, comma: bool, pad: bool, quote: bool) -> str:
    """Return a table as a spreadsheet saves it: all rows of one length, decimal commas, quotes where they are needed."""
    rows = [
        row if before == "\t" else next(csv.reader([line]), [])
        for line in text.split("\n")
        for row in [line.split("\t")]
    ][:-1]
    width = max(map(len, rows)) if pad else 0
    written = io.StringIO()
    writer = csv.writer(
        written, delimiter=separator, lineterminator="\n", quoting=csv.QUOTE_ALL if quote else csv.QUOTE_MINIMAL
    )
    for row in rows:
        cells = [cell.replace(".", ",") if comma and NUMBER.fullmatch(cell) else cell for cell in row]
        writer.writerow([*cells, *[""] * (width - len(cells))])
    return written.getvalue()


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("comma", [False, True])
@pytest.mark.parametrize("quote", [False, True])
def test_a_file_that_a_spreadsheet_saved_reads_as_it_did(
    name: str, separator: str, comma: bool, quote: bool, tmp_path: Path
) -> None:
    text, before = FILES[name]
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    (tmp_path / "a" / name).write_text(text)
    changed = saved(text, before, separator, comma=comma, pad=True, quote=quote)
    (tmp_path / "b" / name).write_text(changed)
    wanted = read_back(tmp_path / "a" / name, tmp_path / "wanted")
    assert read_back(tmp_path / "b" / name, tmp_path / "back") == wanted
    assert any(len(rows) > 1 for rows in wanted.values())


ENDS: dict[str, Callable[[str], bytes]] = {
    "CRLF": lambda text: text.replace("\n", "\r\n").encode(),
    "CR": lambda text: text.replace("\n", "\r").encode(),
    "byte order mark": lambda text: ("\ufeff" + text).encode(),
    "UTF-16": lambda text: ("\ufeff" + text.replace("\n", "\r\n")).encode("utf-16-le"),
    "UTF-16 big-endian": lambda text: ("\ufeff" + text).encode("utf-16-be"),
    "no last end of line": lambda text: text.rstrip("\n").encode(),
}


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("end", ENDS)
def test_any_end_of_line_and_encoding_reads_the_same(name: str, end: str, tmp_path: Path) -> None:
    text = FILES[name][0]
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / name).write_text(text)
    (tmp_path / name).write_bytes(ENDS[end](text))
    assert read_back(tmp_path / name, tmp_path / "back") == read_back(tmp_path / "a" / name, tmp_path / "wanted")


@settings(max_examples=examples(60), deadline=None)
@given(data=st.data(), name=st.sampled_from(sorted(FILES)))
def test_rows_without_anything_are_none_wherever_they_stand(
    data: Any, name: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("blank")
    text, separator = FILES[name]
    lines = text.rstrip("\n").split("\n")
    blank = st.sampled_from(["", "  ", "\t", " \t ", separator * 3, f" {separator} {separator}", separator * 40])
    if name == "x.tsv":  # whose rows have no numbers, so that tabs are a frame of missing markers
        blank = st.sampled_from(["", "  ", "\t", " \t "])
    places = data.draw(st.lists(st.tuples(st.integers(0, len(lines)), blank), max_size=4))
    for place, row in sorted(places, reverse=True):
        lines.insert(place, row)
    (folder / "a").mkdir()
    (folder / "a" / name).write_text(text)
    (folder / name).write_text("\n".join(lines) + "\n")
    assert read_back(folder / name, folder / "back") == read_back(folder / "a" / name, folder / "wanted")


@pytest.mark.parametrize("name", [name for name in FILES if name != "x.sto"])
def test_the_line_that_tells_excel_the_separator_says_nothing(name: str, tmp_path: Path) -> None:
    text, separator = FILES[name]
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / name).write_text(text)
    (tmp_path / name).write_text(f"sep={separator}\n{text}")
    assert read_back(tmp_path / name, tmp_path / "back") == read_back(tmp_path / "a" / name, tmp_path / "wanted")


@pytest.mark.parametrize("spelling", ["-1.#IND", "1.#QNAN", "-nan(ind)", "NaN", "nan", "-nan", "", " "])
def test_every_spelling_of_no_number_is_one(spelling: str, tmp_path: Path) -> None:
    (tmp_path / "x.trc").write_text(TRC.replace("nan", spelling))
    back = read_back(tmp_path / "x.trc", tmp_path / "back")
    assert back["markers"][1] == {"markers": {"ee": [0.5, 0.0, 0.3]}, "_ts": 0.01}


@pytest.mark.parametrize("name", FILES)
def test_headers_padded_with_blanks_read_the_same(name: str, tmp_path: Path) -> None:
    text, separator = FILES[name]
    padded = "\n".join(
        separator.join(f" {cell} " if cell else cell for cell in line.split(separator)) for line in text.split("\n")
    )
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / name).write_text(text)
    (tmp_path / name).write_text(padded)
    assert read_back(tmp_path / name, tmp_path / "back") == read_back(tmp_path / "a" / name, tmp_path / "wanted")


def test_a_trc_file_with_blanks_between_its_cells_is_read(tmp_path: Path) -> None:
    (tmp_path / "x.trc").write_text(
        "PathFileType 4 (X/Y/Z) x.trc\nDataRate CameraRate NumFrames NumMarkers Units OrigDataRate OrigDataStartFrame"
        " OrigNumFrames\n100 100 2 2 mm 100 1 2\nFrame# Time ee tool\n       X1 Y1 Z1 X2 Y2 Z2\n\n"
        "1  0.00  500 0 300  1 2 3\n2  0.01  500 0 300  nan nan nan\n"
    )
    assert read_back(tmp_path / "x.trc", tmp_path / "back")["markers"] == [
        {"markers": {"ee": [0.5, 0.0, 0.3], "tool": [0.001, 0.002, 0.003]}, "_ts": 0.0},
        {"markers": {"ee": [0.5, 0.0, 0.3]}, "_ts": 0.01},
    ]


def test_our_own_file_comes_back_from_a_spreadsheet_with_all_that_it_knows(tmp_path: Path) -> None:
    rows = {"arm": [{"pos": [0.125, 0.25, 0.5], "quat": UNIT, "_ts": 1.7e9 + frame / 64} for frame in range(4)]}
    with record(tmp_path / "run", rows, arm={"quat_order": "wxyz"}) as recording:
        for name, kind in (("x.trc", "trc"), ("x.csv", "mocap")):
            file = recording.export(tmp_path / name, format=kind)
            text = file.read_text().replace("\r\n", "\n")
            if kind == "trc":
                file.write_text(saved(text, "\t", ";", comma=True, pad=True, quote=False))
            else:
                file.write_text(saved(text, ",", ";", comma=True, pad=True, quote=False))
            (back,) = read_back(file, tmp_path / f"back-{kind}").values()
            assert [row["_ts"] for row in back] == [row["_ts"] for row in rows["arm"]], name
            assert [next(iter(row.values())) for row in back] == [row["pos"] for row in rows["arm"]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (TRC.replace("mm", ""), r"x\.trc, line 3, column 5: the unit is missing; pass length_units="),
        (TRC.replace("\tUnits", "\tUnit"), r"x\.trc, line 2: the row of keys has no Units; pass length_units="),
        (TRC.replace("1\t0.00", "1\t"), "line 7, column 2: the row has no time"),
        (TRC.replace("0.01", "1e10"), r"line 8, column 2: the row has the time 10000000000\.0 s, .* to the year 2262"),
        (TRC.replace("500", "5.00,0"), r"line 7, column 3: '5\.00,0' is not a number"),
    ],
)
def test_what_is_not_plain_is_an_error_that_says_what_is_wrong(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "x.trc").write_text(text)
    with pytest.raises(ForeignFileError, match=message):
        read_back(tmp_path / "x.trc", tmp_path / "back")


def test_a_unit_that_a_file_does_not_say_can_be_passed(tmp_path: Path) -> None:
    (tmp_path / "x.trc").write_text(TRC.replace("mm", "ft"))
    back = read_back(tmp_path / "x.trc", tmp_path / "back", length_units="cm")
    assert back["markers"][0]["markers"]["ee"] == [5.0, 0.0, 3.0]


@pytest.mark.parametrize("count", [1, 3])
def test_blank_rows_far_into_a_long_file_do_not_move_the_line_of_an_error(count: int, tmp_path: Path) -> None:
    rows = [f"{at}\t{at / 100:.2f}\t1\t2\t3\t4\t5\t6" for at in range(1, 200)]
    rows[50:50] = ["\t\t"] * count
    rows[-1] = "199\tsoon\t1\t2\t3\t4\t5\t6"
    head = TRC.partition("\n\n")[0].replace("\t2\t2\tmm", "\t199\t2\tmm")
    (tmp_path / "x.trc").write_text("\n".join([head, *rows]) + "\n")
    with pytest.raises(ForeignFileError, match=f"line {5 + 199 + count}, column 2: 'soon'"):
        read_back(tmp_path / "x.trc", tmp_path / "back")
    rows[-1] = "199\t\t1\t2\t3\t4\t5\t6"
    (tmp_path / "x.trc").write_text("\n".join([head, *rows]) + "\n")
    with pytest.raises(ForeignFileError, match=f"line {5 + 199 + count}, column 2: the row has no time"):
        read_back(tmp_path / "x.trc", tmp_path / "more")


def test_blank_rows_at_the_end_of_frames_without_numbers_are_frames_as_far_as_the_header_counts(tmp_path: Path) -> None:
    tabs = "\t" * 5
    for blanks, count in ((0, 2), (1, 3), (4, 3)):
        text = QTM.replace("NO_OF_FRAMES\t2", "NO_OF_FRAMES\t3") + f"{tabs}\n" * blanks
        name = f"x{blanks}.tsv"
        (tmp_path / name).write_text(text)
        assert len(read_back(tmp_path / name, tmp_path / f"back{blanks}")["markers"]) == count
