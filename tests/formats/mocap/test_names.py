"""One rule for names: what `append` takes, an import takes, in every format, as it is."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from pathlib import Path

import ezc3d
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ml_dash_mcap import Recording, convert
from ml_dash_mcap.errors import ConversionWarning, ForeignFileError
from ml_dash_mcap.recorder import Recorder
from tests.formats.mocap.support import read_back, record
from tests.support.examples import examples

ODD = [
    "L\u00a0HIP",
    "\u00a0HIP",
    "HIP\u00a0",
    "a\u202fb",
    "a\u2003b",
    "a\u200bb",
    "e\u0301",
    "\U0001f600",
    "a.b",
    "a b",
    "#1",
    "time",
    "timestamp",
    "*1",
    "a/b",
    "_exact_x",
    "x" * 400,
]


def trc(names: list[str]) -> str:
    count = len(names)
    labels = "\t".join(f"{name}\t\t" for name in names)
    axes = "\t".join(f"X{at}\tY{at}\tZ{at}" for at in range(1, count + 1))
    numbers = "\t".join(f"{at}\t0\t1" for at in range(count))
    return (
        "PathFileType\t4\t(X/Y/Z)\tx.trc\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n"
        f"100\t100\t2\t{count}\tm\nFrame#\tTime\t{labels}\n\t\t{axes}\n\n1\t0\t{numbers}\n2\t0.01\t{numbers}\n"
    )


def table(rows: list[list[str]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def motive(names: list[str]) -> str:
    wide = [name for name in names for _ in "XYZ"]
    head = [["Format Version", "1.23", "Length Units", "Meters", "Rotation Type", "Quaternion"], []]
    head += [["", "Type", *["Marker"] * len(wide)], ["", "Name", *wide], ["", "ID", *wide]]
    head += [["", "", *["Position"] * len(wide)], ["Frame", "Time (Seconds)", *"XYZ" * len(names)]]
    numbers = [cell for at in range(len(names)) for cell in (str(at), "0", "1")]
    return table([*head, ["0", "0", *numbers], ["1", "0.01", *numbers]])


def qtm(names: list[str]) -> str:
    numbers = "\t".join(f"{1000 * at}\t0\t1000" for at in range(len(names)))
    return "FILE_VERSION\t2.0.0\nFREQUENCY\t100\nMARKER_NAMES\t" + "\t".join(names) + f"\n{numbers}\n{numbers}\n"


def vicon(names: list[str]) -> str:
    head = [["Trajectories"], ["100"], ["", "", *[cell for name in names for cell in (name, "", "")]]]
    head += [["Frame", "Sub Frame", *"XYZ" * len(names)], ["", "", *["mm"] * 3 * len(names)]]
    numbers = [cell for at in range(len(names)) for cell in (str(1000 * at), "0", "1000")]
    return table([*head, ["1", "0", *numbers], ["2", "0", *numbers]])


MAKERS: dict[str, Callable[[list[str]], str]] = {
    "x.trc": trc,
    "motive.csv": motive,
    "x.tsv": qtm,
    "vicon.csv": vicon,
}


@pytest.mark.parametrize("name", MAKERS)
def test_a_marker_keeps_any_name_that_append_takes(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(MAKERS[name](ODD))
    with Recorder(tmp_path / "judge") as recorder:
        recorder.topic("markers").append(markers=dict.fromkeys(ODD, 0.0), _ts=0.0)
    rows = read_back(tmp_path / name, tmp_path / "back")["markers"]
    assert rows[0]["markers"] == {one: [float(at), 0.0, 1.0] for at, one in enumerate(ODD)}
    assert len(rows) == 2


@pytest.mark.parametrize("separator", ["\t", "  "])
def test_a_column_of_a_storage_file_keeps_its_name(separator: str, tmp_path: Path) -> None:
    names = [one for one in ODD if separator == "\t" or " " not in one]
    text = f"x\nversion=1\nnRows=1\nnColumns={1 + len(names)}\nendheader\n"
    text += separator.join(("time", *names)) + "\n" + separator.join(map(str, range(1 + len(names)))) + "\n"
    (tmp_path / "x.sto").write_text(text)
    with Recording(tmp_path / "x.sto") as recording:
        assert recording.topics["joints"].metadata["joint_names"] == names


def test_a_point_of_c3d_keeps_its_name(tmp_path: Path) -> None:
    names = [one for one in ODD if len(one.encode()) < 100]
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    file["parameters"]["POINT"]["UNITS"]["value"] = ["m"]
    file["parameters"]["POINT"]["LABELS"]["value"] = names
    file["data"]["points"] = np.ones((4, len(names), 2))
    file.write(str(tmp_path / "x.c3d"))
    assert list(read_back(tmp_path / "x.c3d", tmp_path / "back")["markers"][0]["markers"]) == names


@settings(max_examples=examples(30), deadline=None)
@given(
    names=st.lists(
        st.text(
            st.characters(exclude_categories=["C", "Zl", "Zp"], exclude_characters='":,;\t'), min_size=1, max_size=8
        ),
        min_size=1,
        max_size=5,
    ),
    name=st.sampled_from(sorted(MAKERS)),
)
def test_no_marker_is_lost_whatever_the_names_are(
    names: list[str], name: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("names")
    names = [one for one in (each.strip(" ") for each in names) if one] or ["a"]
    (folder / name).write_text(MAKERS[name](names))
    rows = read_back(folder / name, folder / "back")["markers"]
    assert [value[0] for value in rows[0]["markers"].values()] == list(range(len(names)))
    assert set(names) <= set(rows[0]["markers"])


@pytest.mark.parametrize("name", MAKERS)
def test_duplicate_names_are_numbered_even_where_a_number_is_taken(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(MAKERS[name](["a", "a", "a#2", "b", "a"]))
    rows = read_back(tmp_path / name, tmp_path / "back")["markers"]
    values = rows[0]["markers"]
    assert sorted(value[0] for value in values.values()) == [0, 1, 2, 3, 4]
    assert (values["a"][0], values["a#2"][0], values["b"][0]) == (0, 2, 3)


@pytest.mark.parametrize(
    ("before", "topic"),
    [("ml_dash/x", "file/ml_dash/x"), ("\u00a0", "unnamed"), ("s" * 2000, f"{'s' * 900}-"), ("a\0b", "a\ufffdb")],
)
def test_a_set_whose_name_no_topic_can_have_gets_another_with_a_warning(
    before: str, topic: str, tmp_path: Path
) -> None:
    (tmp_path / "x.trc").write_text(trc([f"{before}:m", "other:m"]))
    with pytest.warns(ConversionWarning, match=r"x\.trc: names that no topic or field can have were changed"):
        back = read_back(tmp_path / "x.trc", tmp_path / "back")
    (changed,) = set(back) - {"other"}
    assert changed.startswith(topic)
    assert back[changed][0]["markers"] == {"m": [0.0, 0.0, 1.0]}
    assert back["other"][0]["markers"] == {"m": [1.0, 0.0, 1.0]}


def test_append_columns_takes_the_names_that_append_takes(tmp_path: Path) -> None:
    names = [*ODD, "a\nb", "a\tb", "\u007f"]
    with Recorder(tmp_path / "run") as recorder:
        recorder.topic("one").append(markers=dict.fromkeys(names, 1.5), _ts=0.0)
        recorder.topic("many").append_columns(_ts=np.zeros(1), markers={name: np.full(1, 1.5) for name in names})
    with Recording(tmp_path / "run") as recording:
        assert list(recording["one"].rows()) == list(recording["many"].rows())


@pytest.mark.parametrize(("format", "suffix"), [("trc", ".trc"), ("qtm", ".tsv"), ("mocap", ".csv"), ("vicon", ".csv")])
def test_names_with_a_no_break_space_go_out_as_they_are(format: str, suffix: str, tmp_path: Path) -> None:
    rows = {"markers": [{"markers": {"L\u00a0HIP": [1.0, 2.0, 3.0]}, "_ts": frame / 4} for frame in range(3)]}
    with record(tmp_path / "run", rows) as recording:
        file = recording.export(tmp_path / f"x{suffix}", format=format)
    assert "L\u00a0HIP" in file.read_text()
    assert read_back(file, tmp_path / "back") == rows


@pytest.mark.parametrize("name", [*MAKERS, "x.sto", "wide.csv"])
def test_nothing_half_written_stays_of_a_file_that_is_refused(name: str, tmp_path: Path) -> None:
    makers = {
        **MAKERS,
        "x.sto": lambda _: "x\nnRows=2\nnColumns=2\nendheader\ntime\ta\n0\t1\n1\t2\n",
        "wide.csv": lambda _: "frame,time,a\n0,0,1\n1,1,2\n",
    }
    text = makers[name](["a"])
    (tmp_path / name).write_text(text + "oops, \t;\n".join(["", ""]))
    with pytest.raises(ForeignFileError, match=rf"{name}, line {text.count(chr(10)) + 1}"):
        convert(tmp_path / name, tmp_path / "run")
    assert [path.name for path in tmp_path.iterdir()] == [name]
