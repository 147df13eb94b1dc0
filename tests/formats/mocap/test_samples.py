"""Frames are samples: none merges, and each has its own time, whatever its file prints."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ml_dash_mcap import Recording, convert
from ml_dash_mcap.errors import ConversionError, ConversionWarning, ForeignFileError
from tests.formats.mocap.support import read_back, record
from tests.support.examples import examples

MOTIVE = """Format Version,1.23,Take Name,demo,Export Frame Rate,{rate},Rotation Type,Quaternion,Length Units,Meters

,Type,Marker,Marker,Marker
,Name,tip,tip,tip
,ID,A1,A1,A1
,,Position,Position,Position
Frame,Time (Seconds),X,Y,Z
"""
QTM = "FILE_VERSION\t2.0.0\nNO_OF_FRAMES\t{count}\nFREQUENCY\t{rate}\nDATA_INCLUDED\t3D\nMARKER_NAMES\ttip\nFrame\tTime\ttip X\ttip Y\ttip Z\n"
TRC = """PathFileType\t4\t(X/Y/Z)\tx.trc
DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames
{rate}\t{rate}\t{count}\t1\tm\t{rate}\t{first}\t{count}
Frame#\tTime\ttip\t\t
\t\tX1\tY1\tZ1

"""


def times_of(count: int, rate: float, decimals: int, first: int = 0) -> list[str]:
    return [f"{(first + frame) / rate:.{decimals}f}" for frame in range(count)]


def trc(count: int, rate: float, decimals: int, first: int = 1) -> str:
    lines = [f"{first + at}\t{time}\t{at}\t0\t1" for at, time in enumerate(times_of(count, rate, decimals))]
    return TRC.format(rate=rate, count=count, first=first) + "\n".join(lines) + "\n"


def motive(count: int, rate: float, decimals: int) -> str:
    lines = [f"{at},{time},{at},0,1" for at, time in enumerate(times_of(count, rate, decimals))]
    return MOTIVE.format(rate=rate) + "\n".join(lines) + "\n"


def qtm(count: int, rate: float, decimals: int) -> str:
    lines = [f"{at + 1}\t{time}\t{at * 1000}\t0\t1000" for at, time in enumerate(times_of(count, rate, decimals))]
    return QTM.format(rate=rate, count=count) + "\n".join(lines) + "\n"


def sto(count: int, rate: float, decimals: int) -> str:
    lines = [f"{time}\t{at}" for at, time in enumerate(times_of(count, rate, decimals))]
    return f"x\nversion=1\nDataRate={rate}\nnRows={count}\nnColumns=2\nendheader\ntime\ta\n" + "\n".join(lines) + "\n"


def wide(count: int, rate: float, decimals: int) -> str:
    lines = [f"{at},{time},{at}" for at, time in enumerate(times_of(count, rate, decimals))]
    return "frame,time,a\n" + "\n".join(lines) + "\n"


WRITERS = {"x.trc": trc, "motive.csv": motive, "x.tsv": qtm, "x.sto": sto, "wide.csv": wide}


@pytest.mark.parametrize("name", ["x.trc", "motive.csv", "x.tsv", "x.sto"])
def test_400_frames_at_200_hz_printed_with_two_decimals_are_400_rows_at_200_hz(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(WRITERS[name](400, 200.0, 2))
    with Recording(tmp_path / name) as recording:
        (topic,) = recording.topics
        info = recording.topics[topic]
        rows = list(recording[topic].rows())
        table = recording[topic].to_arrow()
    assert info.count == len(rows) == table.num_rows == 400
    assert [row["_ts"] for row in rows] == [frame / 200 for frame in range(400)]
    assert "200.0 Hz" in info.metadata["time_source"]


def test_a_take_that_starts_late_has_the_times_of_its_frames(tmp_path: Path) -> None:
    """The header of OpenSim's format says which frame is at time 0; here the first of the file is at 1.505 s."""
    lines = [f"{301 + at}\t{(301 + at) / 200:.2f}\t{at}\t0\t1" for at in range(300)]
    (tmp_path / "x.trc").write_text(TRC.format(rate=200, count=300, first=301) + "\n".join(lines) + "\n")
    rows = read_back(tmp_path / "x.trc", tmp_path / "back")["markers"]
    assert [row["_ts"] for row in rows] == [(301 + at) / 200 for at in range(300)]


def test_printed_times_that_tell_the_frames_apart_stay_what_they_are(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text(motive(50, 120.0, 6))
    with Recording(tmp_path / "x.csv") as recording:
        assert [row["_ts"] for row in recording["markers"].rows()] == [round(at / 120, 6) for at in range(50)]
        assert "time_source" not in recording.topics["markers"].metadata


def test_printed_times_that_contradict_the_rate_count_and_none_is_lost(tmp_path: Path) -> None:
    text = (
        trc(100, 200.0, 2)
        .replace("\n100\t", "\n100\t7.77\t#")
        .replace("7.77\t#0.49", "7.77")
        .replace("7.77\t#0.50", "7.77")
    )
    (tmp_path / "x.trc").write_text(text)
    rows = read_back(tmp_path / "x.trc", tmp_path / "back")["markers"]
    assert len(rows) == 100
    assert rows[-1]["_ts"] == 7.77
    assert [row["markers"]["tip"][0] for row in rows] == list(range(100))


@settings(max_examples=examples(40), deadline=None)
@given(
    name=st.sampled_from(sorted(WRITERS)),
    count=st.integers(1, 60),
    rate=st.sampled_from([1.0, 25.0, 99.7, 120.0, 200.0, 1000.0]),
    decimals=st.integers(0, 6),
    data=st.data(),
)
def test_there_are_as_many_rows_as_frames_in_their_order_whatever_is_printed(
    name: str, count: int, rate: float, decimals: int, data: Any, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("take")
    (folder / name).write_text(WRITERS[name](count, rate, decimals))
    (rows,) = read_back(folder / name, folder / "back").values()
    assert len(rows) == count
    values = [row["a"] if "a" in row else row["q"][0] if "q" in row else row["markers"]["tip"][0] for row in rows]
    assert values == list(range(count))
    tolerance = 10.0**-decimals
    assert [row["_ts"] for row in rows] == pytest.approx([at / rate for at in range(count)], abs=tolerance)
    target, options = data.draw(
        st.sampled_from([("x.jsonl", {}), ("x.parquet", {}), ("y.csv", {"format": "csv"}), ("y.sto", {"what": "all"})])
    )
    assert rows_of(convert(folder / name, folder / "run"), folder / target, options) == count


def rows_of(recording: Path, dest: Path, options: dict[str, Any]) -> int:
    """Export a recording and count the rows of the only topic as another tool reads them."""
    chosen = {"format": {"x.jsonl": "jsonl", "x.parquet": "parquet", "y.sto": "sto"}.get(dest.name, "csv"), **options}
    with Recording(recording) as opened:
        path = opened.export(dest, **chosen)
    (file,) = [one for one in path.rglob("*") if one.is_file()] if path.is_dir() else [path]
    if dest.suffix == ".jsonl":
        return len([json.loads(line) for line in file.read_text().splitlines()])
    if dest.suffix == ".parquet":
        return int(pq.read_table(file).num_rows)
    if dest.suffix == ".sto":
        return len(file.read_text().partition("endheader\n")[2].splitlines()) - 1
    return len(pd.read_csv(file))


def test_rows_of_one_time_are_written_one_by_one_and_come_back(tmp_path: Path) -> None:
    (tmp_path / "x.sto").write_text(
        "x\nversion=1\nnRows=4\nnColumns=2\nendheader\ntime\ta\n0\t1\n0.5\t2\n0.5\t3\n1\t4\n"
    )
    wanted = [{"q": [value], "_ts": time} for value, time in ((1.0, 0.0), (2.0, 0.5), (3.0, 0.5), (4.0, 1.0))]
    with Recording(tmp_path / "x.sto") as recording:
        assert list(recording["joints"].rows()) == wanted
        sto_file = recording.export(tmp_path / "again.sto", format="sto")
        wide_file = recording.export(tmp_path / "wide.csv", format="mocap", layout="wide")
    assert read_back(sto_file, tmp_path / "a")["joints"] == wanted
    (rows,) = read_back(wide_file, tmp_path / "b").values()
    assert rows == wanted


@pytest.mark.parametrize("format", ["rosbag1", "rosbag2"])
def test_rows_of_one_time_are_messages_of_a_bag_each(format: str, tmp_path: Path) -> None:
    from rosbags.highlevel import AnyReader

    (tmp_path / "x.sto").write_text("x\nversion=1\nnRows=3\nnColumns=2\nendheader\ntime\ta\n0.25\t1\n0.5\t2\n0.5\t3\n")
    dest = tmp_path / ("x.bag" if format == "rosbag1" else "bag")
    with Recording(tmp_path / "x.sto") as recording:
        recording.export(dest, format=format)
    with AnyReader([dest]) as reader:
        for connection in reader.connections:
            times = [time for _, time, _ in reader.messages([connection])]
            assert times == [250_000_000, 500_000_000, 500_000_000], connection.topic


def test_two_time_stamps_in_one_nanosecond_are_two_rows_of_a_table(tmp_path: Path) -> None:
    rows = [{"q": [float(at)], "_ts": time} for at, time in enumerate((0.5, 0.9999999999999999, 1.0, 1.5))]
    with record(tmp_path / "run", {"robot": rows}) as recording:
        wide_file = recording.export(tmp_path / "wide.csv", format="mocap", layout="wide")
        sto_file = recording.export(tmp_path / "x.sto", format="sto")
    (back,) = read_back(wide_file, tmp_path / "a").values()
    assert back == rows
    assert read_back(sto_file, tmp_path / "b")["robot"] == rows


def test_a_format_of_frames_says_that_it_has_no_place_for_two_rows_of_one_time(tmp_path: Path) -> None:
    text = "DataType=Vec3\nversion=3\nendheader\ntime\ttip_pos\n0\t1,2,3\n0.5\t1,2,3\n0.5\t4,5,6\n1\t1,2,3\n"
    (tmp_path / "x.sto").write_text(text)
    with Recording(tmp_path / "x.sto") as recording:
        with pytest.raises(ConversionError, match=r"1 of its rows have the time of the row before.*_ts=0\.5.*rate="):
            recording.export(tmp_path / "x.trc", format="trc")
        assert not (tmp_path / "x.trc").exists()
        recording.export(tmp_path / "x.trc", format="trc", rate=4)


@pytest.mark.parametrize("format", ["mocap", "trc", "qtm"])
def test_exported_times_have_the_decimals_that_tell_frames_apart(format: str, tmp_path: Path) -> None:
    rows = [{"pos": [0.0, 0.5, 1.0], "_ts": frame / 240} for frame in range(48)]
    suffix = {"mocap": ".csv", "trc": ".trc", "qtm": ".tsv"}[format]
    with record(tmp_path / "run", {"tip": rows}) as recording:
        file = recording.export(tmp_path / f"x{suffix}", format=format, decimals=1)
    back = read_back(file, tmp_path / "back")["tip"]
    assert [round(row["_ts"] * 240) for row in back] == list(range(48))


def test_imported_topics_are_samples_and_what_is_exported_of_them_is_read_so_again(tmp_path: Path) -> None:
    (tmp_path / "x.trc").write_text(trc(20, 100.0, 2))
    folder = convert(tmp_path / "x.trc", tmp_path / "run")
    with Recording(folder) as recording:
        assert recording.topics["markers"].kind == "message"
        rows = list(recording["markers"].rows())
        files = [
            recording.export(tmp_path / "y.csv", format="mocap"),
            recording.export(tmp_path / "y.trc", format="trc"),
            recording.export(tmp_path / "y.tsv", format="qtm"),
            recording.export(tmp_path / "vicon.csv", format="vicon"),
        ]
    for file in files:
        assert read_back(file, tmp_path / f"back-{file.suffix}-{file.stem}") == {"markers": rows}, file.name


# Times below 0


def test_a_take_that_begins_a_hair_before_0_is_moved_with_a_note(tmp_path: Path) -> None:
    (tmp_path / "x.sto").write_text("x\nversion=1\nnRows=2\nnColumns=2\nendheader\ntime\ta\n-5e-07\t1\n0.01\t2\n")
    with pytest.warns(ConversionWarning, match="begin at -5e-07 s.*moved by 5e-07 s.*pass start="):
        recording = Recording(tmp_path / "x.sto")
    with recording:
        assert [row["_ts"] for row in recording["joints"].rows()] == [0.0, 0.01 + 5e-07]
        assert recording.topics["joints"].metadata["time_shift_s"] == 5e-07


@pytest.mark.parametrize("name", ["x.trc", "x.sto", "motive.csv", "x.tsv", "wide.csv"])
def test_a_trial_that_begins_before_0_is_moved_as_a_whole(name: str, tmp_path: Path) -> None:
    lines = {"x.trc": "1\t-1.5\t0\t0\t1\n2\t-1.25\t1\t0\t1\n", "x.sto": "-1.5\t0\n-1.25\t1\n", "motive.csv": "0,-1.5,0,0,1\n1,-1.25,1,0,1\n", "x.tsv": "1\t-1.5\t0\t0\t1\n2\t-1.25\t1\t0\t1\n", "wide.csv": "0,-1.5,0\n1,-1.25,1\n"}  # fmt: skip
    text = WRITERS[name](2, 4.0, 2)
    head = "\n".join(text.split("\n")[: -len(lines[name].splitlines()) - 1]) + "\n"
    (tmp_path / name).write_text(head + lines[name])
    with pytest.warns(ConversionWarning, match=r"moved by 1\.5 s"):
        (rows,) = read_back(tmp_path / name, tmp_path / "back").values()
    assert [row["_ts"] for row in rows] == [0.0, 0.25]
    (rows,) = read_back(tmp_path / name, tmp_path / "asked", start=10.0).values()
    assert [row["_ts"] for row in rows] == [8.5, 8.75]
    with pytest.raises(ForeignFileError, match=r"line \d+, column \d: the row has the time -0\.5 s.*larger by 0\.5"):
        read_back(tmp_path / name, tmp_path / "no", start=1.0)


def test_frame_0_of_vicon_is_at_the_start(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text(
        "Trajectories\n100\n,,a,,\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n0,0,1,2,3\n1,0,1,2,3\n\n"
        "Devices\n200\n,,EMG\nFrame,Sub Frame,V\n,,V\n0,0,1\n0,1,2\n1,0,3\n1,1,4\n"
    )
    with pytest.warns(ConversionWarning, match=r"moved by 0\.01 s"):
        back = read_back(tmp_path / "x.csv", tmp_path / "back")
    assert [row["_ts"] for row in back["markers"]] == [0.0, 0.01]
    assert [row["_ts"] for row in back["devices"]] == pytest.approx([0.0, 0.005, 0.01, 0.015], abs=1e-12)
