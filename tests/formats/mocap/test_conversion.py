"""Motion capture files are opened and converted like recordings."""

from __future__ import annotations

from pathlib import Path

import pytest

from ml_dash_mcap import Recording, convert
from ml_dash_mcap.errors import ForeignFileError, FormatError
from tests.formats.mocap.support import UNIT, Rows, record, rows_of


def take(frames: int = 3) -> Rows:
    body = {"pos": [0.1, 0.2, 0.3], "quat": UNIT, "q": [0.5, 1.0]}
    return {"arm": [{**body, "_ts": frame / 4} for frame in range(frames)]}


@pytest.mark.parametrize("name", ["x.csv", "x.trc", "x.tsv", "x.sto", "x.c3d", "wide.csv"])
def test_a_file_opens_as_a_recording(name: str, tmp_path: Path) -> None:
    formats = {"x.csv": "mocap", "x.trc": "trc", "x.tsv": "qtm", "x.sto": "sto", "x.c3d": "c3d", "wide.csv": "mocap"}
    options = {"layout": "wide"} if name == "wide.csv" else {}
    with record(tmp_path / "run", take()) as recording:
        file = recording.export(tmp_path / name, format=formats[name], **options)
    with Recording(file) as opened:
        (topic,) = opened.topics
        assert opened[topic].info.count == 3
        assert [row["_ts"] for row in opened[topic].rows()] == [0.0, 0.25, 0.5]


@pytest.mark.parametrize("rate", [None, "median"])
@pytest.mark.parametrize("name", ["mocap.csv", "vicon.csv", "trc.trc", "qtm.tsv", "sto.sto", "c3d.c3d"])
def test_one_row_comes_back_from_each_format(name: str, rate: str | None, tmp_path: Path) -> None:
    with record(
        tmp_path / "run", {"arm": [{"pos": [1.0, 2.0, 3.0], "quat": UNIT, "q": [0.5], "_ts": 7.5}]}
    ) as recording:
        file = recording.export(tmp_path / name, format=name.partition(".")[0], rate=rate)
    with Recording(file) as opened:
        (row,) = opened["arm"].rows()
    assert row["_ts"] == 7.5
    assert row == {**row, "q": [0.5]} if name == "sto.sto" else row["pos"] == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("name", "rate"), [("vicon.csv", "\n1\n"), ("qtm.tsv", "FREQUENCY\t1\n"), ("trc.trc", "\n1\t1\t")]
)
def test_the_rate_of_one_row_is_one_as_others_refuse_zero(name: str, rate: str, tmp_path: Path) -> None:
    with record(tmp_path / "run", {"arm": [{"pos": [1.0, 2.0, 3.0], "_ts": 7.5}]}) as recording:
        file = recording.export(tmp_path / name, format=name.partition(".")[0])
    text = file.read_text()
    assert rate in text
    file.write_text(text.replace(rate, rate.replace("1", "0")))  # as earlier releases wrote it
    with Recording(file) as opened:
        assert list(opened["arm"].rows()) == [{"pos": [1.0, 2.0, 3.0], "_ts": 7.5}]


def test_a_take_is_converted_with_the_joints_beside_it(tmp_path: Path) -> None:
    with record(tmp_path / "run", take()) as recording:
        recording.export(tmp_path / "x.csv", format="mocap")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run", "x.csv", "x.joints.sto"]
    told: list[tuple[int, int]] = []
    folder = convert(tmp_path / "x.csv", tmp_path / "back", progress=lambda done, total: told.append((done, total)))
    assert rows_of(folder) == take()
    assert told[-1] == (3, 3)


def test_the_suffix_of_a_destination_says_its_format(tmp_path: Path) -> None:
    record(tmp_path / "run", take()).close()
    for name in ("x.trc", "x.sto", "x.c3d", "x.tsv"):
        assert convert(tmp_path / "run", tmp_path / name).is_file()
    assert (tmp_path / "x.trc").read_text().startswith("PathFileType")


def test_a_broken_file_leaves_no_recording_behind(tmp_path: Path) -> None:
    with record(tmp_path / "run", take()) as recording:
        file = recording.export(tmp_path / "x.trc", format="trc")
    file.write_text(file.read_text() + "4\tsoon\t1\t2\t3\n")
    with pytest.raises(ForeignFileError, match=r"line 10, column 2: 'soon'"):
        convert(file, tmp_path / "back")
    assert not (tmp_path / "back").exists()


def test_a_csv_of_nobody_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("a,b\n1,2\n")
    with pytest.raises((FormatError, ValueError)):
        convert(tmp_path / "x.csv", tmp_path / "back", format="nothing")
