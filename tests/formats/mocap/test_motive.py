"""Motive CSV files: what is written comes back, other people's files come in, broken ones are refused by line."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ml_dash_mcap.errors import (
    ConversionError,
    ConversionWarning,
    DestinationExistsError,
    ForeignFileError,
    OptionError,
)
from ml_dash_mcap.formats import readers
from ml_dash_mcap.recorder import Recorder
from ml_dash_mcap.recording import Recording
from tests.formats.mocap.support import UNIT, read_back, record
from tests.support import shared
from tests.support.examples import examples

# There and back

finite = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e6, max_value=1e6)
point = st.lists(finite, min_size=3, max_size=3)


@st.composite
def rotation(draw: Any) -> list[float]:
    q = np.array(draw(st.lists(st.floats(-1, 1), min_size=4, max_size=4)))
    length = np.linalg.norm(q)
    return UNIT if length < 0.1 else (q / length).tolist()


@st.composite
def takes(draw: Any) -> dict[str, list[dict[str, Any]]]:
    """Draw rows of a robot and of markers on one clock, with samples and fields missing."""
    start = draw(st.sampled_from([0.0, 0.1, 17.123456789, 1.7e9 + 1 / 3]))
    step = draw(st.sampled_from([1 / 30, 0.01, 1 / 240]))
    count = draw(st.integers(2, 12))
    robot, hand = [], []
    for frame in range(count):
        row: dict[str, Any] = {"_ts": start + frame * step}
        row |= {"ee_pos": draw(point), "ee_quat": draw(rotation())} if frame in (0, 1) or draw(st.booleans()) else {}
        row |= {"q": draw(st.lists(finite, min_size=2, max_size=2))} if frame == 0 or draw(st.booleans()) else {}
        if len(row) > 1:
            robot.append(row)
        markers = {name: draw(point) for name in ("L,1", "Ü") if frame == 0 or draw(st.booleans())}
        if markers:
            hand.append({"markers": markers, "_ts": start + frame * step})
    return {"robot": robot, "hand": hand}


@pytest.mark.filterwarnings("ignore:the topics have different axes")
@settings(max_examples=examples(40), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), take=takes())
def test_what_was_written_comes_back_bit_for_bit(data: Any, take: Any, tmp_path_factory: Any) -> None:
    order, unit = data.draw(st.sampled_from(["xyzw", "wxyz"])), data.draw(st.sampled_from(["m", "mm"]))
    up, version = data.draw(st.sampled_from([None, "z", "y"])), data.draw(st.sampled_from(["1.23", "1.25"]))
    folder = tmp_path_factory.mktemp("take")
    with record(folder / "run", take, robot={"quat_order": order, "up": "y"}) as recording:
        file = recording.export(
            folder / "x.csv", format="mocap", length_units=unit, up=up, format_version=version, canonical=False
        )
    assert read_back(file, folder / "back") == dict(sorted(take.items()))


def test_a_pose_as_a_dict_and_a_list_of_markers_come_back(tmp_path: Path) -> None:
    pose = {"position": {"x": 1.0, "y": 2.0, "z": 3.0}, "orientation": dict(zip("xyzw", UNIT, strict=True))}
    rows = {
        "arm": [{"ee_pose": [1.0, 2.0, 3.0, *UNIT], "_ts": time} for time in (0.0, 0.5)],
        "cloud": [{"markers": [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], "_ts": time} for time in (0.0, 0.5)],
        "ros": [{"pose": pose, "_ts": time} for time in (0.0, 0.5)],
    }
    with record(tmp_path / "run", rows, cloud={"marker_names": ["a", "b"]}) as recording:
        file = recording.export(tmp_path / "x.csv", format="mocap")
    assert ",cloud:a,cloud:a,cloud:a,cloud:b," in file.read_text()
    assert read_back(file, tmp_path / "back") == rows


def test_a_matrix_comes_back_as_position_and_quaternion(tmp_path: Path) -> None:
    turn = [[0.0, -1.0, 0.0, 1.0], [1.0, 0.0, 0.0, 2.0], [0.0, 0.0, 1.0, 3.0], [0.0, 0.0, 0.0, 1.0]]
    with record(tmp_path / "run", {"arm": [{"T": turn, "_ts": time} for time in (0.0, 0.5)]}) as recording:
        file = recording.export(tmp_path / "x.csv", format="mocap")
    row = read_back(file, tmp_path / "back")["arm"][0]
    assert row["T"]["pos"] == [1.0, 2.0, 3.0]
    assert row["T"]["quat"] == pytest.approx([0, 0, math.sqrt(0.5), math.sqrt(0.5)], abs=1e-15)


def test_metadata_of_the_topics_comes_back(tmp_path: Path) -> None:
    said = {"quat_order": "wxyz", "length_units": "mm", "note": 'grüße, "x"'}
    rows = {"arm": [{"pos": [0.1, 391.888, -6180.01], "quat": UNIT, "_ts": time} for time in (0.0, 0.5)]}
    with record(tmp_path / "run", rows, arm=said) as recording:
        file = recording.export(tmp_path / "x.csv", format="mocap")
    assert ",0.0001,0.391888,-6.18001" in file.read_text()
    assert read_back(file, tmp_path / "back") == rows
    with Recording(tmp_path / "back") as back:
        assert back.topics["arm"].metadata == said


# What others read


def test_pandas_reads_bodies_and_markers_by_name(tmp_path: Path) -> None:
    rows = {
        "robot": [{"pos": [step, 0.0, 1.0], "quat": UNIT, "_ts": step / 100} for step in range(5)],
        "hand": [{"markers": {"L": [step, 2.0, 3.0]}, "_ts": step / 100} for step in range(5) if step != 2],
    }
    with record(tmp_path / "run", rows) as recording:
        file = recording.export(tmp_path / "x.csv", format="mocap")
        later = recording.export(tmp_path / "y.csv", format="mocap", format_version="1.25")
    for path, header in ((file, [0, 1, 3, 4]), (later, [0, 1, 4, 5])):
        table = pd.read_csv(path, skiprows=2, header=header)
        assert table["Rigid Body"]["robot"]["Position"]["X"].tolist() == [0, 1, 2, 3, 4]
        assert table["Marker"]["hand:L"]["Position"]["X"].isna().tolist() == [False, False, True, False, False]


def test_six_decimals_look_like_motive(tmp_path: Path) -> None:
    rows = {"robot": [{"pos": [1e-7, -0.977050123, 1.0], "quat": UNIT, "_ts": step / 100} for step in range(2)]}
    with record(tmp_path / "run", rows) as recording:
        file = recording.export(tmp_path / "x.csv", format="mocap", decimals=6)
    assert file.read_bytes().endswith(
        b"\r\n1,0.010000,0.500000,0.500000,0.500000,0.500000,0.000000,-0.977050,1.000000\r\n"
    )


def test_rounded_times_still_bring_body_and_joints_of_a_row_together(tmp_path: Path) -> None:
    rows = [{"pos": [0.0, 0.5, 1.0], "quat": UNIT, "q": [frame / 8], "_ts": frame / 120} for frame in range(60)]
    with record(tmp_path / "run", {"robot": rows}) as recording:
        file = recording.export(tmp_path / "x.csv", format="mocap", decimals=6)
    back = read_back(file, tmp_path / "back")["robot"]
    assert [{**row, "_ts": round(row["_ts"] * 120) / 120} for row in back] == rows


def test_the_start_of_a_wall_clock_is_in_the_header(tmp_path: Path) -> None:
    rows = {"robot": [{"pos": [1.0, 2.0, 3.0], "_ts": 1568824202.695 + step / 64} for step in range(2)]}
    with record(tmp_path / "run", rows) as recording:
        file = recording.export(tmp_path / "x.csv", format="mocap")
    assert ",Capture Start Time,2019-09-18 04.30.02.695 PM," in file.read_text()


# Frames and rates


def test_holes_are_blank_rows_with_a_frame_of_their_own(tmp_path: Path) -> None:
    rows = {"robot": [{"pos": [1.0, 2.0, 3.0], "_ts": step / 100} for step in (0, 1, 2, 5)]}
    with record(tmp_path / "run", rows) as recording:
        file = recording.export(tmp_path / "x.csv", format="mocap")
    assert [line.split(",")[0::2] for line in file.read_text().splitlines()[7:]] == [
        ["0", "1.0", "3.0"], ["1", "1.0", "3.0"], ["2", "1.0", "3.0"], ["3", "", ""], ["4", "", ""], ["5", "1.0", "3.0"],
    ]  # fmt: skip


def test_uneven_times_are_an_error_that_says_the_spacing_and_what_to_pass(tmp_path: Path) -> None:
    times = [0.0, 0.01, 0.02, 0.034, 0.044]
    with record(tmp_path / "run", {"robot": [{"pos": [1.0, 2.0, 3.0], "_ts": time} for time in times]}) as recording:
        with pytest.raises(
            ConversionError, match=r"'robot'.* 10 to 14 ms .*_ts=0\.034; pass rate=90.9 or rate='median'"
        ):
            recording.export(tmp_path / "x.csv", format="mocap")
        file = recording.export(tmp_path / "x.csv", format="mocap", rate="median")
    assert [line.split(",")[1] for line in file.read_text().splitlines()[7:]] == ["0.0", "0.01", "0.02", "0.03", "0.04"]


def test_resampling_is_linear_for_positions_and_along_the_shortest_arc_for_rotations(tmp_path: Path) -> None:
    half = math.sqrt(0.5)
    rows = [
        {"pos": [0.0, 0.0, 0.0], "quat": [0.0, 0.0, 0.0, 1.0], "_ts": 0.0},
        {"pos": [0.1, 0.2, 0.3], "quat": [0.0, 0.0, -half, -half], "_ts": 0.1},
    ]
    with record(tmp_path / "run", {"robot": rows}) as recording:
        file = recording.export(tmp_path / "x.csv", format="mocap", rate=20)
    middle = [float(cell) for cell in file.read_text().splitlines()[8].split(",")]
    assert middle[:2] == [1, 0.05]
    assert middle[2:] == pytest.approx([0, 0, math.sin(math.pi / 8), math.cos(math.pi / 8), 0.05, 0.1, 0.15], abs=1e-15)


def test_nothing_is_interpolated_across_a_gap(tmp_path: Path) -> None:
    times = [0.0, 0.01, 0.02, 0.5, 0.51]
    with record(tmp_path / "run", {"robot": [{"pos": [time, 0.0, 0.0], "_ts": time} for time in times]}) as recording:
        file = recording.export(tmp_path / "x.csv", format="mocap", rate=100)
    cells = [line.split(",")[2] for line in file.read_text().splitlines()[7:]]
    assert len(cells) == 52
    assert [bool(cell) for cell in cells] == [True] * 3 + [False] * 47 + [True] * 2


def test_resampling_by_windows_is_resampling_at_once(tmp_path: Path) -> None:
    count = 9000
    times = np.cumsum(np.random.default_rng(1).uniform(0.005, 0.015, count))
    with Recorder(tmp_path / "run") as recorder:
        recorder.topic("robot").append_columns(_ts=times, pos=np.stack([np.sin(times), times, times**2], 1))
    with Recording(tmp_path / "run") as recording:
        file = recording.export(tmp_path / "x.csv", format="mocap", rate=97)
    table = pd.read_csv(file, skiprows=7, header=None).to_numpy()
    grid = times[0] + np.arange(len(table)) / 97
    for column, values in ((2, np.sin(times)), (3, times), (4, times**2)):
        np.testing.assert_allclose(table[:, column], np.interp(grid, times, values), rtol=1e-12, atol=1e-12)


# Rotations


def test_a_quaternion_that_flips_its_sign_is_written_without_a_jump(tmp_path: Path) -> None:
    signs = [1, -1, 1, 1, -1]
    rows = [
        {"pos": [0.0, 0.0, 0.0], "quat": [sign * one for one in UNIT], "_ts": at / 10} for at, sign in enumerate(signs)
    ]
    with record(tmp_path / "run", {"robot": rows}) as recording:
        file = recording.export(tmp_path / "x.csv", format="mocap")
    assert {line.split(",")[2] for line in file.read_text().splitlines()[7:]} == {"0.5"}


def test_axes_stay_unless_asked_and_two_in_one_file_draw_a_warning(tmp_path: Path) -> None:
    rows = [{"pos": [1.0, 2.0, 3.0], "quat": UNIT, "_ts": frame / 10} for frame in range(3)]
    with record(tmp_path / "run", {"robot": rows, "studio": rows}, studio={"up": "y"}) as recording:
        with pytest.warns(ConversionWarning, match="z in 'robot', y in 'studio'.*up='z'"):
            recording.export(tmp_path / "as.csv", format="mocap")
        for up, robot, studio in (("z", "1.0,2.0,3.0", "1.0,-3.0,2.0"), ("y", "1.0,3.0,-2.0", "1.0,2.0,3.0")):
            recording.export(tmp_path / f"{up}.csv", format="mocap", up=up)
            first = (tmp_path / f"{up}.csv").read_text().splitlines()[7].split(",")
            assert (",".join(first[6:9]), ",".join(first[13:16])) == (robot, studio)


def test_a_quaternion_far_from_length_one_is_an_error_or_missing(tmp_path: Path) -> None:
    rows = [{"pos": [0.0, 0.0, 0.0], "quat": quat, "_ts": at / 10} for at, quat in enumerate([UNIT, [0.0] * 4, UNIT])]
    with record(tmp_path / "run", {"robot": rows}) as recording:
        with pytest.raises(ConversionError, match=r"'robot', field 'quat', _ts=0\.1: .* length 0"):
            recording.export(tmp_path / "x.csv", format="mocap")
        assert not list(tmp_path.glob("*.csv")), "nothing is left of a failed export"
        with pytest.warns(ConversionWarning, match="1 values that are no rotations"):
            file = recording.export(tmp_path / "x.csv", format="mocap", on_bad="missing")
    assert file.read_text().splitlines()[8] == "1,0.1,,,,,0.0,0.0,0.0"


def test_a_quaternion_that_looks_like_w_first_draws_a_warning_unless_its_order_is_said(tmp_path: Path) -> None:
    rows = [{"pos": [0.0, 0.0, 0.0], "quat": [1.0, 0.0, 0.0, 0.0], "_ts": at / 10} for at in range(2)]
    with record(tmp_path / "run", {"robot": rows}) as recording:
        with pytest.warns(ConversionWarning, match="looks like w x y z"):
            recording.export(tmp_path / "x.csv", format="mocap")
        file = recording.export(tmp_path / "y.csv", format="mocap", quat_order="wxyz")
    assert file.read_text().splitlines()[7] == "0,0.0,0.0,0.0,0.0,1.0,0.0,0.0,0.0"


# What cannot be written


def test_topics_without_bodies_and_markers_are_an_error_that_names_the_wide_layout(tmp_path: Path) -> None:
    with (
        record(tmp_path / "run", {"imu": [{"accel": [0.0, 0.0, 9.8], "_ts": 0.0}]}) as recording,
        pytest.raises(ConversionError) as caught,
    ):
        recording.export(tmp_path / "x.csv", format="mocap")
    assert re.search("no rigid body and no marker .*'imu'.* layout='wide'", str(caught.value))


def test_a_field_that_changes_its_size_is_an_error(tmp_path: Path) -> None:
    rows = [{"pos": [0.0, 0.0, 0.0], "_ts": 0.0}, {"pos": [0.0, 0.0, 0.0], "_ts": 0.1}, {"pos": [0.0, 0.0], "_ts": 0.2}]
    with record(tmp_path / "run", {"robot": rows}) as recording:
        with pytest.raises(ConversionError, match=r"'robot', field 'pos', _ts=0\.2: \[0\.0, 0\.0\] is not 3 numbers"):
            recording.export(tmp_path / "x.csv", format="mocap")
        recording.export(tmp_path / "x.csv", format="mocap", end=0.1)


@pytest.mark.parametrize("field", ["q", "tau", "markers"])
@pytest.mark.parametrize("format", ["mocap", "sto", "wide"])
def test_joints_and_markers_that_change_their_size_are_an_error_too(field: str, format: str, tmp_path: Path) -> None:
    def value(size: int) -> Any:
        return {"tip": [0.5] * size} if field == "markers" else [0.5] * size

    rows = [{"pos": [0.0, 0.0, 0.0], field: value(3 if at < 8 else 2), "_ts": at / 8} for at in range(10)]
    options = {"sto": {"format": "sto", "what": "all"}, "wide": {"format": "mocap", "layout": "wide"}}
    name = "markers.tip" if field == "markers" else field
    with (
        record(tmp_path / "run", {"robot": rows}) as recording,
        pytest.raises(ConversionError, match=rf"field '{name}', _ts=1\.0: \[0\.5, 0\.5\] is not 3 numbers"),
    ):
        recording.export(tmp_path / "x.csv", **options.get(format, {"format": "mocap"}))
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_other_lists_of_many_lengths_are_left_out_of_the_wide_layout_with_a_warning(tmp_path: Path) -> None:
    rows = [{"hits": [0.5] * (at % 3), "speed": 2.5, "_ts": at / 8} for at in range(4)]
    with (
        record(tmp_path / "run", {"scan": rows}) as recording,
        pytest.warns(ConversionWarning, match="'hits' is left out"),
    ):
        file = recording.export(tmp_path / "x.csv", format="mocap", layout="wide")
    assert file.read_text().splitlines()[:2] == ["frame,time,speed", "0,0.0,2.5"]


def test_a_destination_that_exists_is_refused_also_that_of_the_joints(tmp_path: Path) -> None:
    rows = [{"pos": [0.0, 0.0, 0.0], "q": [1.0, 2.0], "_ts": at / 10} for at in range(2)]
    (tmp_path / "x.joints.sto").write_text("mine")
    with record(tmp_path / "run", {"robot": rows}) as recording, pytest.raises(DestinationExistsError):
        recording.export(tmp_path / "x.csv", format="mocap")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run", "x.joints.sto"]


@pytest.mark.parametrize(
    "options", [{"rate": 0}, {"rate": -1.0}, {"rate": "fast"}, {"up": "x"}, {"length_units": "ft"}, {"format_version": "1.21"}, {"joints": "csv"}, {"decimals": 0}, {"layout": "tall"}, {"quat_order": "zyxw"}, {"on_bad": "skip"}],
)  # fmt: skip
def test_options_that_make_no_sense_are_refused(options: dict[str, Any], tmp_path: Path) -> None:
    rows = {"robot": [{"pos": [0.0, 0.0, 0.0], "_ts": 0.0}]}
    with record(tmp_path / "run", rows) as recording, pytest.raises(OptionError, match=next(iter(options))):
        recording.export(tmp_path / "x.csv", format="mocap", **options)


# Other people's files

HEADER = """Format Version,1.23,Take Name,demo,Take Notes,,Capture Frame Rate,100.000000,Export Frame Rate,100.000000,Capture Start Time,2019-09-18 04.30.02.695 PM,Total Frames in Take,2,Total Exported Frames,2,Rotation Type,Quaternion,Length Units,Millimeters,Coordinate Space,Global

,Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Marker,Marker,Marker,Marker,Marker,Marker
,Name,robot,robot,robot,robot,robot,robot,robot,robot,robot:tool,robot:tool,robot:tool,loose,loose,loose
,ID,"9E20","9E20","9E20","9E20","9E20","9E20","9E20","9E20","A1","A1","A1","B2","B2","B2"
,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error,Position,Position,Position,Position,Position,Position
Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,X,Y,Z,X,Y,Z
"""
BODY = """0,0.000000,0.134648,-0.977050,-0.111668,0.121543,142.319,160.392,2000.101,0.113,1,2,3,,,
1,0.010000,,,,,,,,,4,5,6,7,8,9
"""


def test_a_take_of_motive_becomes_bodies_and_markers_at_its_start_time(tmp_path: Path) -> None:
    file = tmp_path / "demo.csv"
    file.write_bytes((HEADER + BODY).replace("\n", "\r\n").encode())
    start = 1568824202.695
    assert read_back(file, tmp_path / "back") == {
        "markers": [{"_ts": start}, {"markers": {"loose": [0.007, 0.008, 0.009]}, "_ts": start + 0.01}],
        "robot": [
            {
                "pos": [0.142319, 0.160392, 2.000101], "quat": [0.134648, -0.977050, -0.111668, 0.121543],
                "mean_marker_error": 0.000113, "markers": {"tool": [0.001, 0.002, 0.003]}, "_ts": start,
            },
            {"markers": {"tool": [0.004, 0.005, 0.006]}, "_ts": start + 0.01},
        ],
    }  # fmt: skip


def test_the_start_time_is_in_the_time_zone_that_is_passed(tmp_path: Path) -> None:
    file = tmp_path / "demo.csv"
    file.write_text(HEADER + BODY)
    assert read_back(file, tmp_path / "a", timezone="Europe/Berlin")["robot"][0]["_ts"] == 1568824202.695 - 7200
    assert read_back(file, tmp_path / "b", start=5.0)["robot"][0]["_ts"] == 5.0


@pytest.mark.parametrize("timezone", ["Mars/Base", "../etc", ""])
def test_a_time_zone_that_is_none_is_refused(timezone: str, tmp_path: Path) -> None:
    (tmp_path / "demo.csv").write_text(HEADER + BODY)
    with pytest.raises(OptionError, match="timezone="):
        read_back(tmp_path / "demo.csv", tmp_path / "back", timezone=timezone)


def older(text: str) -> str:
    """Return a file of version 1.21, whose header rows have no labels."""
    return (
        text.replace("1.23", "1.21")
        .replace(",Type,", ",,")
        .replace(",Name,", ",,")
        .replace(",ID,", ",,")
        .replace("Mean Marker Error", "Error Per Marker")
        .replace("Time (Seconds)", "Time")
    )


def with_time_code(text: str) -> str:
    head, _, rest = text.partition("\n\n")
    lines = rest.splitlines()
    for number, line in enumerate(lines):
        first, second, behind = line.split(",", 2)
        code = "TimeCode" if first == "Frame" else "" if number < 4 else "00:00:00"
        lines[number] = f"{first},{second},{code},{behind}"
    return (
        f"{head}\n\n".replace("1.23", "1.24")
        + "\n".join(lines[:-2])
        + "\n"
        + "\n".join(line.replace("00:00:00", "") for line in lines[-2:])
        + "\n"
    )


def with_parents(text: str) -> str:
    return text.replace("1.23", "1.25").replace("\n,,Rotation", "\n,Parent" + "," * 14 + "\n,,Rotation")


@pytest.mark.parametrize(
    "change",
    [
        older,
        lambda text: older(text).replace("1.21", "1.2"),
        with_time_code,
        with_parents,
        lambda text: "\ufeff" + text,
    ],
)
def test_every_version_reads_the_same(change: Any, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(HEADER + BODY)
    (tmp_path / "b.csv").write_text(change(HEADER + BODY))
    assert read_back(tmp_path / "b.csv", tmp_path / "b") == read_back(tmp_path / "a.csv", tmp_path / "a")


def test_a_real_file_of_version_1_21_reads_with_its_counts(tmp_path: Path) -> None:
    back = read_back(shared.file("mocap/a-motive-1.21-rigidbody.csv"), tmp_path / "back")
    assert {topic: len(rows) for topic, rows in back.items()} == {"Rigid Body 1": 250, "Unlabeled": 250}
    first, last = back["Rigid Body 1"][0], back["Rigid Body 1"][-1]
    assert round(last["_ts"] - first["_ts"], 2) == 2.08
    assert len(first["pos"]) == 3
    assert set(first["markers"]) == {"Marker1", "Marker2", "Marker3"}
    assert set(first["body_markers"]) == {"1", "2", "3"}
    assert first["_ts"] == 1452008990.755
    numbers = sum(len(cells) for rows in back.values() for row in rows for cells in numbers_in(row)) - 2 * 250
    assert numbers == 250 * 47 - 2250, "what is not blank in the file"


def numbers_in(row: dict[str, Any]) -> list[list[float]]:
    """Return the numbers of each field of a row, its time stamp included."""
    found = []
    for value in row.values():
        if isinstance(value, dict):
            found += numbers_in(value)
        else:
            found.append([one for one in (value if isinstance(value, list) else [value]) if one is not None])
    return found


# Broken files


@pytest.mark.parametrize(
    ("change", "message"),
    [
        pytest.param(lambda text: text.replace("0.134648", "0.13x"), r"line 8, column 3: '0\.13x' is not a number", id="a cell"),
        pytest.param(lambda text: text.replace(",9\n", ",9,10\n"), "line 9: the line has 17 cells, but the header has 16", id="too long"),
        pytest.param(lambda text: text.replace(",,,\n", ",,\n"), "line 8: the line has 15 cells", id="too short"),
        pytest.param(lambda text: text.replace("0.134648", "0;134648"), "';'", id="a semicolon"),
        pytest.param(lambda text: text.replace("1.23", "2.0"), "line 1, column 2: format version '2.0'", id="version"),
        pytest.param(lambda text: text.replace("Marker,Marker,Marker,Marker,", "Marker,Marker,Marker,Force,"), "line 7, column 15: Marker 'loose' has no column Position X", id="no x"),
        pytest.param(lambda text: text.replace("Marker,Marker,Marker,Marker,", "Marker,Marker,Marker,,"), "line 3, column 14: the column has no type", id="no type"),
        pytest.param(lambda text: text.replace(",Name,", ",Nom,"), "no row of names", id="no names"),
        pytest.param(lambda text: text.replace("Frame,Time (Seconds)", "Bild,Zeit"), "no row that begins with 'Frame'", id="no frames"),
        pytest.param(lambda text: text.partition("Frame,Time")[0], "the file ends before", id="cut"),
        pytest.param(lambda text: text.replace(",ID,\"9E20\",", ",ID,"), "row of IDs has 15 cells", id="ragged header"),
        pytest.param(lambda text: text.replace("Quaternion", "XYZ"), "rotation type 'XYZ'", id="euler"),
        pytest.param(lambda text: text.replace("Millimeters", "Feet"), "length units 'Feet'", id="feet"),
        pytest.param(lambda text: text.replace("X,Y,Z,W", "X,Y,Z,X"), "Rigid Body 'robot' has no column Rotation W", id="no w"),
        pytest.param(lambda text: text.replace("1,0.010000", "1,-9e12"), "line 9, column 2: the row has the time .* pass a start= that is larger by", id="time"),
        pytest.param(lambda text: text.replace("0.134648", "inf"), "line 8, column 3", id="infinite"),
        pytest.param(lambda text: text.replace("1,0.010000", "1,"), "line 9, column 2: the row has no time", id="no time"),
    ],
)  # fmt: skip
def test_a_broken_file_is_an_error_with_its_line(change: Any, message: str, tmp_path: Path) -> None:
    file = tmp_path / "demo.csv"
    file.write_text(change(HEADER + BODY))
    with Recorder(tmp_path / "back") as recorder, pytest.raises(ForeignFileError, match=message) as caught:
        readers.record(file, recorder)
    assert caught.value.path == file


def test_bad_cells_are_counted_and_left_out_where_that_is_allowed(tmp_path: Path) -> None:
    file = tmp_path / "demo.csv"
    file.write_text((HEADER + BODY).replace("0.134648", "###").replace(",,,\n", ",,\n"))
    with pytest.warns(ConversionWarning, match="2 cells"):
        back = read_back(file, tmp_path / "back", on_bad="missing")
    assert back["robot"][0]["quat"] == [None, -0.977050, -0.111668, 0.121543]
