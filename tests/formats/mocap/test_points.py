"""TRC, QTM and Vicon files: what is written comes back exactly, and others read it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ml_dash_mcap.errors import ConversionError, ForeignFileError
from tests.formats.mocap.support import UNIT, Rows, read_back, record
from tests.support.examples import examples


@pytest.fixture
def opensim(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.chdir(tmp_path)  # where it puts a log when it is imported
    return pytest.importorskip("opensim", reason="there is no wheel of OpenSim for this Python")


finite = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e6, max_value=1e6)
point = st.lists(finite, min_size=3, max_size=3)

SUFFIXES = {"trc": ".trc", "qtm": ".tsv", "vicon": ".csv"}


@st.composite
def markers(draw: Any) -> Rows:
    """Draw rows of two topics of markers on one clock, with markers missing here and there."""
    step = draw(st.sampled_from([1 / 32, 0.25]))
    count = draw(st.integers(2, 12))
    hand, loose = [], []
    for frame in range(count):
        for rows, names in ((hand, ("L 1", "Ü")), (loose, ("a",))):
            is_kept = frame % 4 < 3 or draw(st.booleans())  # with more holes nobody could tell the rate
            some = {name: draw(point) for name in names if is_kept and (name == names[0] or draw(st.booleans()))}
            if some:
                rows.append({"markers": some, "_ts": 8.0 + frame * step})
    return {"hand": hand, "markers": loose}


@pytest.mark.filterwarnings("ignore:the topics have different axes")
@settings(max_examples=examples(20), deadline=None)
@given(data=st.data(), take=markers(), format=st.sampled_from(sorted(SUFFIXES)))
def test_markers_come_back_bit_for_bit(data: Any, take: Rows, format: str, tmp_path_factory: Any) -> None:
    folder = tmp_path_factory.mktemp("take")
    options: dict[str, Any] = {"up": data.draw(st.sampled_from([None, "y", "z"]))}
    if format == "trc":
        options["length_units"] = data.draw(st.sampled_from(["m", "mm"]))
    with record(folder / "run", take, hand={"up": "y"}) as recording:
        file = recording.export(folder / f"x{SUFFIXES[format]}", format=format, **options)
    assert read_back(file, folder / "back") == take


@pytest.mark.parametrize("format", ["trc", "qtm"])
def test_times_that_are_nearly_even_come_back_exactly(format: str, tmp_path: Path) -> None:
    rows = {"markers": [{"markers": {"a": [1.0, 2.0, 3.0]}, "_ts": 1.7e9 + frame / 30} for frame in range(20)]}
    with record(tmp_path / "run", rows) as recording:
        file = recording.export(tmp_path / f"x{SUFFIXES[format]}", format=format)
    assert read_back(file, tmp_path / "back") == rows


def test_bodies_come_back_from_vicon_with_their_rotations(tmp_path: Path) -> None:
    body = {"pos": [0.391888, -6.18001, 1e-5], "quat": UNIT}
    rows = {
        "arm": [{**body, "_ts": frame / 4} for frame in range(3)],
        "markers": [{"markers": {"a": [1.0, 2.0, 3.0]}, "_ts": frame / 4} for frame in range(2)],
    }
    with record(tmp_path / "run", rows, arm={"quat_order": "wxyz"}) as recording:
        file = recording.export(tmp_path / "x.csv", format="vicon", up="y")
    assert "\r\n1,0,0.5,0.5,-0.5,0.5,391.888,0.01,6180.01\r\n" in file.read_bytes().decode()
    assert read_back(file, tmp_path / "back") == rows


# What others read


def moving(count: int = 5) -> Rows:
    return {
        "arm": [{"ee_pos": [frame / 8, 0.0, 0.25], "ee_quat": UNIT, "_ts": frame / 64} for frame in range(count)],
        "hand": [
            {"markers": {"tool": [1.0, frame / 4, 3.0]}, "_ts": frame / 64} for frame in range(count) if frame != 2
        ],
    }


@pytest.mark.parametrize(("unit", "scale"), [("m", 1), ("mm", 1000)])
def test_opensim_reads_the_markers(opensim: Any, unit: str, scale: int, tmp_path: Path) -> None:
    with record(tmp_path / "run", moving()) as recording:
        file = recording.export(tmp_path / "x.trc", format="trc", length_units=unit)
    table = opensim.TimeSeriesTableVec3(str(file))
    assert list(table.getColumnLabels()) == ["arm", "hand:tool"]
    assert [round(time, 9) for time in table.getIndependentColumn()] == [frame / 64 for frame in range(5)]
    arm = [table.getDependentColumn("arm")[frame].to_numpy().tolist() for frame in range(5)]
    assert arm == [[scale * frame / 8, 0.0, scale / 4] for frame in range(5)]
    tool = [table.getDependentColumn("hand:tool")[frame].to_numpy() for frame in range(5)]
    assert [bool(np.isnan(one).all()) for one in tool] == [False, False, True, False, False]
    assert table.getTableMetaDataString("Units") == unit
    assert float(table.getTableMetaDataString("DataRate")) == 64


def test_trc_data_reader_reads_the_markers(tmp_path: Path) -> None:
    from trc import TRCData

    with record(tmp_path / "run", moving()) as recording:
        file = recording.export(tmp_path / "x.trc", format="trc")
    data = TRCData()
    data.load(str(file))
    assert data["Markers"] == ["arm", "hand:tool"]
    assert data["NumFrames"] == 5
    assert [list(one) for one in data["arm"]] == [[frame / 8, 0.0, 0.25] for frame in range(5)]


def test_opensim_reads_the_joints(opensim: Any, tmp_path: Path) -> None:
    rows = [{"q": [frame / 8, -1e-9], "dq": [1.0, 2.0], "gripper": 0.04, "_ts": frame**2 / 64} for frame in range(5)]
    rows[3]["gripper"] = None
    with record(tmp_path / "run", {"robot": rows}, robot={"joint_names": ["a", "b"]}) as recording:
        file = recording.export(tmp_path / "x.sto", format="sto")
    table = opensim.TimeSeriesTable(str(file))
    assert set(table.getColumnLabels()) == {"a", "b", "a_u", "b_u", "gripper"}
    assert list(table.getIndependentColumn()) == [0, 1 / 64, 4 / 64, 16 / 64]
    assert table.getDependentColumn("a").to_numpy().tolist() == [0, 1 / 8, 2 / 8, 4 / 8]
    assert table.getTableMetaDataString("inDegrees") == "no"
    storage = opensim.Storage(str(file))
    assert storage.getSize() == 4
    assert read_back(file, tmp_path / "back")["robot"] == [row for row in rows if row["gripper"]]


def test_degrees_are_said_to_be_degrees_and_not_mixed_with_radians(opensim: Any, tmp_path: Path) -> None:
    rows: Rows = {topic: [{"q": [90.0], "_ts": float(at)} for at in range(2)] for topic in ("a", "b")}
    with record(tmp_path / "run", rows, a={"units": {"q": "deg"}}, b={"units": "rad"}) as recording:
        file = recording.export(tmp_path / "x.sto", format="sto", topics=["a"])
        with pytest.raises(ConversionError, match="degrees"):
            recording.export(tmp_path / "y.sto", format="sto")
    assert opensim.TimeSeriesTable(str(file)).getTableMetaDataString("inDegrees") == "yes"


def test_what_opensim_writes_is_read(opensim: Any, tmp_path: Path) -> None:
    table = opensim.TimeSeriesTable()
    table.setColumnLabels(["hip", "knee"])
    for frame in range(4):
        table.appendRow(frame / 3, opensim.RowVector([frame / 7, -frame]))
    table.addTableMetaDataString("inDegrees", "yes")
    opensim.STOFileAdapter.write(table, str(tmp_path / "x.sto"))
    back = read_back(tmp_path / "x.sto", tmp_path / "back")
    np.testing.assert_allclose(
        [row["q"] for row in back["joints"]], [[frame / 7, -frame] for frame in range(4)], rtol=1e-15
    )

    points = opensim.TimeSeriesTableVec3()
    points.setColumnLabels(["m1", "m2"])
    for frame in range(4):
        row = opensim.RowVectorVec3(2)
        row[0], row[1] = opensim.Vec3(frame, 2, 3), opensim.Vec3(4, 5, frame)
        points.appendRow(frame / 50, row)
    points.addTableMetaDataString("DataRate", "50")
    points.addTableMetaDataString("Units", "mm")
    opensim.TRCFileAdapter.write(points, str(tmp_path / "x.trc"))
    back = read_back(tmp_path / "x.trc", tmp_path / "more")
    assert [row["markers"] for row in back["markers"]] == [
        {"m1": [frame / 1000, 0.002, 0.003], "m2": [0.004, 0.005, frame / 1000]} for frame in range(4)
    ]


# Other people's files

TRC = """PathFileType\t4\t(X/Y/Z)\tfile.trc
DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames
100.00\t100.00\t2\t2\tmm\t100.00\t1\t2
Frame#\tTime\tee\t\t\ttool\t\t
\t\tX1\tY1\tZ1\tX2\tY2\tZ2

1\t0.00\t500\t0.0\t300\t1\t2\t3
2\t0.01\t500\t0.0\t300\tnan\tnan\tnan
"""
TRC_ROWS = [
    {"markers": {"ee": [0.5, 0.0, 0.3], "tool": [0.001, 0.002, 0.003]}, "_ts": 0.0},
    {"markers": {"ee": [0.5, 0.0, 0.3]}, "_ts": 0.01},
]


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda text: text, id="as it should be"),
        pytest.param(lambda text: text.replace("\n", "\r\n"), id="CRLF"),
        pytest.param(
            lambda text: text.replace("tool\t\t\n", "tool\n").replace("\tnan\tnan\tnan", ""), id="no trailing tabs"
        ),
        pytest.param(lambda text: text.replace("\n\n", "\n"), id="no blank line"),
        pytest.param(lambda text: text.replace("nan", ""), id="blank cells"),
        pytest.param(
            lambda text: text.replace("300\n", "300\t\n").replace("\t3\n", "\t3\t\n"), id="more trailing tabs"
        ),
    ],
)
def test_a_trc_file_is_read_as_loosely_as_others_write_it(change: Any, tmp_path: Path) -> None:
    (tmp_path / "x.trc").write_bytes(change(TRC).encode())
    assert read_back(tmp_path / "x.trc", tmp_path / "back") == {"markers": TRC_ROWS}


QTM = """FILE_VERSION\t2.0.0
NO_OF_FRAMES\t2
NO_OF_CAMERAS\t7
NO_OF_MARKERS\t2
FREQUENCY\t120
NO_OF_ANALOG\t0
ANALOG_FREQUENCY\t0
DESCRIPTION\t--
TIME_STAMP\t2014-06-17, 08:53:44\t912.56663253
DATA_INCLUDED\t3D
MARKER_NAMES\tRIGHT_KNEE\tright_ankle
1501.102\t2073.985\t102.815\t1\t2\t3
1501.103\t2073.985\t102.815\t\t\t
"""


def test_a_qtm_file_starts_at_its_time_stamp_and_counts_frames_by_its_frequency(tmp_path: Path) -> None:
    (tmp_path / "x.tsv").write_text(QTM)
    start = 1402995224.0
    rows = [
        {"markers": {"RIGHT_KNEE": [1.501102, 2.073985, 0.102815], "right_ankle": [0.001, 0.002, 0.003]}, "_ts": start},
        {"markers": {"RIGHT_KNEE": [1.501103, 2.073985, 0.102815]}, "_ts": start + 1 / 120},
    ]
    assert read_back(tmp_path / "x.tsv", tmp_path / "back") == {"markers": rows}
    labelled = QTM.replace("1501.102", "Frame\tTime\tRIGHT_KNEE X\tY\tZ\tX\tY\tZ\n1\t0.0\t1501.102").replace(
        "\n1501.103", "\n2\t0.5\t1501.103"
    )
    (tmp_path / "y.tsv").write_text(labelled)
    assert [row["_ts"] for row in read_back(tmp_path / "y.tsv", tmp_path / "more")["markers"]] == [start, start + 0.5]


def test_bodies_of_qtm_get_quaternions_of_their_matrices(tmp_path: Path) -> None:
    turn = "0\t1\t0\t-1\t0\t0\t0\t0\t1"  # a quarter turn about z, column by column
    head = QTM.partition("MARKER_NAMES")[0].replace("NO_OF_MARKERS", "NO_OF_BODIES").replace("3D", "6D")
    (tmp_path / "x.tsv").write_text(f"{head}BODY_NAMES\tarm\n1000\t2000\t3000\t0\t0\t90\t0.5\t{turn}\n")
    row = read_back(tmp_path / "x.tsv", tmp_path / "back")["arm"][0]
    assert row["pos"] == [1.0, 2.0, 3.0]
    assert row["quat"] == pytest.approx([0, 0, 0.5**0.5, 0.5**0.5], abs=1e-15)


VICON = """Trajectories
100
,,subject:LASI,,,subject:RASI,,
Frame,Sub Frame,X,Y,Z,X,Y,Z
,,mm,mm,mm,mm,mm,mm
1,0,-391.888,-6180.01,1734.43,-378.647,-6190.14,1713.8
2,0,-391.888,-6180.01,1734.43,,,

Devices
200
,,Plate - Force,,,EMG
Frame,Sub Frame,Fx,Fy,Fz,Voltage
,,N,N,N,V
1,0,1,2,3,0.5
1,1,4,5,6,0.25
2,0,7,8,9,
2,1,1,1,1,0.125

Segments
100
,,subject:Hip,,,,,
Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ
,,deg,deg,deg,mm,mm,mm
1,0,90,0,0,1,2,3
"""


def test_the_sections_of_a_vicon_file_become_topics(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_bytes(VICON.replace("\n", "\r\n").encode())
    lasi = [-0.391888, -6.18001, 1.73443]
    assert read_back(tmp_path / "x.csv", tmp_path / "back") == {
        "devices": [
            {"Plate - Force": {"Fx": 1, "Fy": 2, "Fz": 3}, "EMG": {"Voltage": 0.5}, "_ts": 0.0},
            {"Plate - Force": {"Fx": 4, "Fy": 5, "Fz": 6}, "EMG": {"Voltage": 0.25}, "_ts": 0.005},
            {"Plate - Force": {"Fx": 7, "Fy": 8, "Fz": 9}, "_ts": 0.01},
            {"Plate - Force": {"Fx": 1, "Fy": 1, "Fz": 1}, "EMG": {"Voltage": 0.125}, "_ts": 0.015},
        ],
        "subject": [
            {"markers": {"LASI": lasi, "RASI": [-0.378647, -6.19014, 1.7138]}, "_ts": 0.0},
            {"markers": {"LASI": lasi}, "_ts": 0.01},
        ],
        "subject/Hip": [{"pos": [0.001, 0.002, 0.003], "rotation": [90.0, 0.0, 0.0], "_ts": 0.0}],
    }


# Broken files


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("x.trc", TRC.replace("\t2\t2\tmm", "\t2\t3\tmm"), "line 4: NumMarkers is 3, but 2"),
        ("x.trc", TRC.replace("\tmm\t", "\tft\t"), "line 3, column 5: the unit 'ft'"),
        ("x.trc", TRC.replace("500", "5,00"), r"line 7, column 3: '5,00' .* decimal commas"),
        ("x.trc", TRC.replace("Frame#", "Bild"), "line 4, column 1"),
        ("x.trc", TRC.replace("\t2\t3\n", "\t2\t3\t4\n"), "line 7: the line has 9 cells"),
        ("x.trc", TRC.partition("Frame#")[0], "ends before the row of marker names"),
        ("x.tsv", QTM.replace("1501.102", "left"), "line 12, column 1: 'left'"),
        ("x.tsv", QTM.replace("MARKER_NAMES", "NAMES"), "neither MARKER_NAMES nor BODY_NAMES"),
        ("x.tsv", QTM.replace("FREQUENCY\t120", "FREQUENCY\tEXT"), "FREQUENCY is 'EXT'"),
        ("x.csv", VICON.replace("-391.888", "-391;888"), "line 6, column 3"),
        ("x.csv", VICON.replace("Devices\n200", "Things\nfast"), "line 9: 'Things' is not the name of a section"),
        ("x.csv", VICON.replace("\n100\n", "\nfast\n"), "line 2, column 1: 'fast' is not a rate"),
        ("x.csv", VICON.replace("\n100\n", "\n0\n"), "line 2, column 1: '0' is not a rate"),
        ("x.csv", VICON.replace("Frame,Sub Frame,X", "Bild,Sub Frame,X"), "line 4, column 1"),
        ("x.csv", VICON.replace(",1713.8", ",1713.8,9"), "line 6: the line has 9 cells"),
        ("x.trc", "".join(line for line in TRC.splitlines(True)[:6] if "X1" not in line).rstrip() + "\n1\t0.0\t1\t2\t3\t4\t5\t6\n", "line 5, column 1: .* no row of axes"),
        ("x.csv", VICON.replace(",,mm,mm,mm,mm,mm,mm\n", ""), "line 5, column 1: .* no row of units"),
        ("x.csv", "frame;time;q\n0;0,5;1.5\n", "line 2, column 2: '0,5' is not a number"),
        ("x.sto", "Coordinates\nnColumns=3\nendheader\ntime\ta\tb\n0\t1\t2\n1\t1\n", "line 6: the line has 2 cells"),
        ("x.sto", "Coordinates\nnColumns=4\nendheader\ntime\ta\tb\n0\t1\t2\n", "nColumns=4, but 3"),
        ("x.sto", "Coordinates\nnColumns=3\ntime\ta\tb\n0\t1\t2\n", "before 'endheader'"),
        ("x.sto", "x\nendheader\nt\ta\n0\t1\n", "line 3, column 1: the first column is 't'"),
    ],
)  # fmt: skip
def test_a_broken_file_is_an_error_with_its_line(name: str, text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(ForeignFileError, match=message):
        read_back(tmp_path / name, tmp_path / "back")


def test_a_mot_file_with_blanks_between_its_columns_is_read(tmp_path: Path) -> None:
    (tmp_path / "x.mot").write_text(
        "walk\nnRows=2\nnColumns=3\n\nendheader\n  time   a    b\n 0.0   1  2\n 0.5   3  -4e-1  \n"
    )
    assert read_back(tmp_path / "x.mot", tmp_path / "back")["joints"] == [
        {"q": [1.0, 2.0], "_ts": 0.0},
        {"q": [3.0, -0.4], "_ts": 0.5},
    ]


@pytest.mark.parametrize("format", ["trc", "qtm", "vicon"])
def test_a_topic_without_points_is_an_error(format: str, tmp_path: Path) -> None:
    rows = {"imu": [{"accel": [0.0, 0.0, 9.8], "_ts": 0.0}]}
    with (
        record(tmp_path / "run", rows) as recording,
        pytest.raises(ConversionError, match="no rigid body and no marker"),
    ):
        recording.export(tmp_path / "x", format=format)
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
