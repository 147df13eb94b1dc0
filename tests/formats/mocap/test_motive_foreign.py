"""Motive's files: time codes, and columns that are not known."""

from __future__ import annotations

from pathlib import Path

from ml_dash_mcap import Recording
from tests.formats.mocap.support import read_back

TIME_CODES = """Format Version,1.24,Take Name,demo,Capture Frame Rate,100.000000,Export Frame Rate,100.000000,Rotation Type,Quaternion,Length Units,Centimeters

,,Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Marker,Marker,Marker
,,Name,robot,robot,robot,robot,robot,robot,robot,robot,tip,tip,tip
,,ID,"9E","9E","9E","9E","9E","9E","9E","9E","A1","A1","A1"
,,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error,Position,Position,Position
Frame,Time (Seconds),TimeCode,X,Y,Z,W,X,Y,Z,,X,Y,Z
0,0.000000,15:26:46:12.02,0,0,0,1,10,20,30,0.5,1,2,3
1,0.010000,15:26:46:12.03,0,0,0,1,10,20,30,0.5,,,
2,0.020000,,0,0,0,1,10,20,30,0.5,1,2,3
"""


def test_time_codes_are_a_field_of_text(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text(TIME_CODES)
    back = read_back(tmp_path / "x.csv", tmp_path / "back")
    body = {"pos": [0.1, 0.2, 0.3], "quat": [0.0, 0.0, 0.0, 1.0], "mean_marker_error": 0.005}
    assert back["robot"] == [
        {**body, "time_code": "15:26:46:12.02", "_ts": 0.0},
        {**body, "time_code": "15:26:46:12.03", "_ts": 0.01},
        {**body, "_ts": 0.02},
    ]
    assert back["markers"] == [
        {"markers": {"tip": [0.01, 0.02, 0.03]}, "time_code": "15:26:46:12.02", "_ts": 0.0},
        {"time_code": "15:26:46:12.03", "_ts": 0.01},
        {"markers": {"tip": [0.01, 0.02, 0.03]}, "_ts": 0.02},
    ]


def test_labels_may_stand_in_the_second_column_although_there_are_time_codes(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(TIME_CODES)
    text = TIME_CODES
    for label in ("Type", "Name", "ID"):
        text = text.replace(f"\n,,{label},", f"\n,{label},,")
    (tmp_path / "b.csv").write_text(text)
    assert read_back(tmp_path / "a.csv", tmp_path / "a") == read_back(tmp_path / "b.csv", tmp_path / "b")


def test_the_time_code_may_stand_before_the_time_and_parents_beside_it(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(TIME_CODES)
    lines = TIME_CODES.replace("1.24", "1.25").split("\n")
    lines.insert(5, ",,Parent,,,,,,,,,,,")
    (tmp_path / "b.csv").write_text("\n".join(lines))
    for at in range(6, 11):
        first, second, third, rest = lines[at].split(",", 3)
        lines[at] = ",".join((first, third, second, rest))
    (tmp_path / "c.csv").write_text("\n".join(lines))
    wanted = read_back(tmp_path / "a.csv", tmp_path / "a")
    assert read_back(tmp_path / "b.csv", tmp_path / "b") == wanted
    assert read_back(tmp_path / "c.csv", tmp_path / "c") == wanted


UNKNOWN = """Format Version,1.25,Take Name,demo,Export Frame Rate,100.000000,Rotation Type,Quaternion,Length Units,Millimeters

,Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Marker,Marker,Marker,Marker,Force Plate,Force Plate
,Name,robot,robot,robot,robot,robot,robot,robot,robot,robot,tip,tip,tip,tip,plate,plate
,ID,9E,9E,9E,9E,9E,9E,9E,9E,9E,A1,A1,A1,A1,P1,P1
,Parent,,,,,,,,,,,,,,,
,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Tracking Quality,Velocity,Position,Position,Position,Size,Force,Force
Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,X,X,Y,Z,,Fx,Fy
0,0.000000,0,0,0,1,100,200,300,0.75,1250,1,2,3,14,5.5,6.5
"""


def test_columns_of_a_kind_that_is_not_known_are_fields(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text(UNKNOWN)
    assert read_back(tmp_path / "x.csv", tmp_path / "back") == {
        "robot": [
            {
                "pos": [0.1, 0.2, 0.3], "quat": [0.0, 0.0, 0.0, 1.0], "tracking_quality": 0.75,
                "velocity": {"X": 1250.0}, "_ts": 0.0,
            },
        ],
        "markers": [{"markers": {"tip": [0.001, 0.002, 0.003]}, "size": {"tip": 14.0}, "_ts": 0.0}],
        "force_plate": [{"plate": {"force": {"Fx": 5.5, "Fy": 6.5}}, "_ts": 0.0}],
    }  # fmt: skip


def test_lengths_are_metres_all_of_them_and_the_metadata_says_from_what(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text(TIME_CODES)
    with Recording(tmp_path / "x.csv") as recording:
        metadata = recording.topics["robot"].metadata
        assert metadata["units"] == {"pos": "m", "mean_marker_error": "m"}
        assert metadata["converted"] == "lengths from cm to m"
        assert recording.topics["markers"].metadata["units"] == {"markers": "m"}


def test_two_bodies_and_markers_of_one_name_are_kept_apart(tmp_path: Path) -> None:
    text = TIME_CODES.replace("Marker,Marker,Marker\n", "Marker,Marker,Marker,Marker,Marker,Marker\n")
    text = text.replace("tip,tip,tip\n", "tip,tip,tip,tip,tip,tip\n").replace('"A1"\n', '"A1","A1","A1","A1"\n')
    text = text.replace("Error,Position,Position,Position\n", "Error" + ",Position" * 6 + "\n")
    text = (
        text.replace(",X,Y,Z\n0,", ",X,Y,Z,X,Y,Z\n0,")
        .replace(",1,2,3\n", ",1,2,3,4,5,6\n")
        .replace(",,,\n", ",,,,,,\n")
    )
    (tmp_path / "x.csv").write_text(text)
    rows = read_back(tmp_path / "x.csv", tmp_path / "back")["markers"]
    assert rows[0]["markers"] == {"tip": [0.01, 0.02, 0.03], "tip#2": [0.04, 0.05, 0.06]}
