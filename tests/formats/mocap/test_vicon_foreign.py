"""Vicon's files: every column is kept, each in its unit."""

from __future__ import annotations

from pathlib import Path

import pytest

from ml_dash_mcap import Recording
from ml_dash_mcap.errors import ForeignFileError
from tests.formats.mocap.support import UNIT, read_back, record

NEXUS = """Model Outputs
100
,,Bob:LKneeAngles,,,Bob:LKneeMoment,,,Bob:LKneePower,,,Bob:CentreOfMass,,
Frame,Sub Frame,X,Y,Z,X,Y,Z,X,Y,Z,X,Y,Z
,,deg,deg,deg,N.mm/kg,N.mm/kg,N.mm/kg,W/kg,W/kg,W/kg,mm,mm,mm
1,0,10.02,-1.5,0.25,812.5,0,1,0,0,1.75,100,200,1000
2,0,11.5,,,812.5,0,1,0,0,1.75,100,200,1000

Segments
100
,,Bob:Pelvis,,,,,,,,
Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ,SX,SY,SZ
,,rad,rad,rad,mm,mm,mm,,,
1,0,0.5,0.25,0,1000,2000,500,1.05,0.95,1

Devices
200
,,Plate - CoP,,Plate - Force,Treadmill
Frame,Sub Frame,Cx,Cy,Fz,Speed
,,mm,cm,N,m/s
1,0,100,20,700,1.25
1,1,200,30,701,1.5

Events
100
Subject,Context,Name,Time (s),Description
Bob,Left,Foot Strike,1.25,the heel hits the ground
Bob,Right,Foot Off,1.5,
"""


def test_every_column_is_a_field_in_its_unit(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text(NEXUS)
    with Recording(tmp_path / "x.csv") as recording:
        rows = {topic: list(recording[topic].rows()) for topic in recording.topics}
        about = {topic: info.metadata for topic, info in recording.topics.items()}
    outputs = rows["model_outputs"]
    assert outputs[0] == {
        "Bob:LKneeAngles": {"X": 10.02, "Y": -1.5, "Z": 0.25},
        "Bob:LKneeMoment": {"X": 812.5, "Y": 0.0, "Z": 1.0},
        "Bob:LKneePower": {"X": 0.0, "Y": 0.0, "Z": 1.75},
        "Bob:CentreOfMass": {"X": 0.1, "Y": 0.2, "Z": 1.0},
        "_ts": 0.0,
    }
    assert outputs[1]["Bob:LKneeAngles"] == {"X": 11.5}
    assert about["model_outputs"]["units"] == {
        "Bob:LKneeAngles": "deg", "Bob:LKneeMoment": "N.mm/kg", "Bob:LKneePower": "W/kg", "Bob:CentreOfMass": "m",
    }  # fmt: skip
    assert about["model_outputs"]["converted"] == "lengths from mm to m"
    assert rows["Bob/Pelvis"] == [
        {"pos": [1.0, 2.0, 0.5], "rotation": [0.5, 0.25, 0.0], "SX": 1.05, "SY": 0.95, "SZ": 1.0, "_ts": 0.0}
    ]
    assert about["Bob/Pelvis"]["units"] == {"pos": "m", "rotation": "rad"}
    assert rows["devices"] == [
        {"Plate - CoP": {"Cx": 0.1, "Cy": 0.2}, "Plate - Force": {"Fz": 700.0}, "Treadmill": {"Speed": 1.25}, "_ts": 0.0},
        {"Plate - CoP": {"Cx": 0.2, "Cy": 0.3}, "Plate - Force": {"Fz": 701.0}, "Treadmill": {"Speed": 1.5}, "_ts": 0.005},
    ]  # fmt: skip
    assert about["devices"]["units"] == {"Plate - CoP": "m", "Plate - Force": "N", "Treadmill": "m/s"}
    assert about["devices"]["converted"] == "lengths from cm and mm to m"
    assert rows["events"] == [
        {"subject": "Bob", "context": "Left", "name": "Foot Strike", "description": "the heel hits the ground", "_ts": 1.25},
        {"subject": "Bob", "context": "Right", "name": "Foot Off", "description": "", "_ts": 1.5},
    ]  # fmt: skip
    assert about["devices"]["time_source"] == "frame and sub frame numbers at 200.0 Hz"


def test_a_section_of_another_name_is_a_topic_if_it_is_laid_out_like_the_others(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text(NEXUS.replace("Devices", "Eye Trackers"))
    back = read_back(tmp_path / "x.csv", tmp_path / "back")
    assert [row["Treadmill"] for row in back["eye_trackers"]] == [{"Speed": 1.25}, {"Speed": 1.5}]


def test_a_marker_with_more_than_a_place_is_a_marker_with_fields(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text(
        "Trajectories\n100\n,,Bob:LASI,,,\nFrame,Sub Frame,X,Y,Z,Residual\n,,mm,mm,mm,mm\n1,0,1,2,3,0.5\n"
    )
    back = read_back(tmp_path / "x.csv", tmp_path / "back")
    assert back == {"Bob": [{"markers": {"LASI": [0.001, 0.002, 0.003]}, "LASI": {"Residual": 0.0005}, "_ts": 0.0}]}


@pytest.mark.parametrize("blank", ["", ",,,,,,,,,,", "\t,", "  "])
def test_rows_of_separators_end_a_section_only_where_another_begins(blank: str, tmp_path: Path) -> None:
    text = NEXUS.replace("\n2,0,11.5", f"\n{blank}\n{blank}\n2,0,11.5").replace("\n\n", f"\n{blank}\n")
    (tmp_path / "x.csv").write_text(text)
    (tmp_path / "plain.csv").write_text(NEXUS)
    assert read_back(tmp_path / "x.csv", tmp_path / "a") == read_back(tmp_path / "plain.csv", tmp_path / "b")


def test_a_section_whose_columns_have_no_units_is_read(tmp_path: Path) -> None:
    for number, row in enumerate((",,,", "")):
        name = f"x{number}.csv"
        (tmp_path / name).write_text(f"Devices\n100\n,,Counter,\nFrame,Sub Frame,a,b\n{row}\n1,0,5,6\n2,0,7,8\n")
        rows = read_back(tmp_path / name, tmp_path / f"back{number}")["devices"]
        assert [row["Counter"] for row in rows] == [{"a": 5.0, "b": 6.0}, {"a": 7.0, "b": 8.0}]


def test_what_several_sections_say_of_one_frame_of_a_topic_is_one_row(tmp_path: Path) -> None:
    """A body with markers of its own, whose frames differ between the sections of the file."""
    body = {"pos": [0.5, 0.25, 1.0], "quat": UNIT}
    rows = [{**body, "markers": {"a": [1.0, 2.0, 3.0]}, "_ts": frame / 4} for frame in range(5)]
    del rows[1]["markers"], rows[3]["pos"], rows[3]["quat"]
    with record(tmp_path / "run", {"arm": rows}) as recording:
        file = recording.export(tmp_path / "x.csv", format="vicon")
    assert read_back(file, tmp_path / "back") == {"arm": rows}


def test_sections_of_a_topic_are_joined_and_no_other_topic_gets_rows_by_it(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text(
        "Trajectories\n100\n,,Bob:LASI,,,Ann:LASI,,\nFrame,Sub Frame,X,Y,Z,X,Y,Z\n,,mm,mm,mm,mm,mm,mm\n"
        "1,0,1,2,3,1,2,3\n2,0,,,,,,\n\nObjects\n100\n,,Bob,,,,,\nFrame,Sub Frame,RX,RY,RZ,TX,TY,TZ\n"
        ",,rad,rad,rad,mm,mm,mm\n2,0,0,0,0,1,2,3\n3,0,,,,,,\n"
    )
    marker, body = [0.001, 0.002, 0.003], {"pos": [0.001, 0.002, 0.003], "rotation": [0.0, 0.0, 0.0]}
    assert read_back(tmp_path / "x.csv", tmp_path / "back") == {
        "Ann": [{"markers": {"LASI": marker}, "_ts": 0.0}, {"_ts": 0.01}],
        "Bob": [{"markers": {"LASI": marker}, "_ts": 0.0}, {**body, "_ts": 0.01}, {"_ts": 0.02}],
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (NEXUS.replace("1,0,10.02", "1,0,ten"), r"x\.csv, line 6, column 3: 'ten' is not a number; pass on_bad="),
        (NEXUS.replace("\n2,0,11.5", "\n,0,11.5"), "line 7, column 1: the row has no time"),
        (NEXUS.replace("1.25,the", "soon,the"), "line 27: the event has the time 'soon'"),
        (NEXUS.replace("1,1,200", "1,1,2e0x"), "line 22, column 3"),
    ],
)
def test_what_is_wrong_in_any_section_is_an_error_with_its_line(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text(text)
    with pytest.raises(ForeignFileError, match=message):
        read_back(tmp_path / "x.csv", tmp_path / "back")
