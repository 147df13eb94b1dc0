"""Storage files of OpenSim and SIMM: units as OpenSim takes them, vectors and quaternions, and what OpenSim itself writes."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import pytest

from ml_dash_mcap import Recording
from ml_dash_mcap.errors import ConversionWarning, ForeignFileError
from tests.formats.mocap.support import read_back


@pytest.fixture
def opensim(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.chdir(tmp_path)
    return pytest.importorskip("opensim", reason="there is no wheel of OpenSim for this Python")


BODY = "endheader\ntime\thip\tknee\n0\t10\t20\n0.5\t30\t40\n"
HEADERS = {
    "simm.mot": "name walk\ndatacolumns 3\ndatarows 2\nrange 0 0.5\n",
    "old.mot": "walk.mot\nnRows=2\nnColumns=3\n\n",
    "zero.mot": "walk.mot\nversion=0\nnRows=2\nnColumns=3\n",
    "one.mot": "walk.mot\nversion=1\nnRows=2\nnColumns=3\n",
    "old.sto": "walk\nnRows=2\nnColumns=3\n",
    "no.mot": "walk\nversion=1\nnRows=2\nnColumns=3\ninDegrees=no\n",
    "yes.sto": "walk\nversion=1\nnRows=2\nnColumns=3\ninDegrees=yes\n",
    "large.mot": "walk\nversion=1\nnRows=2\nnColumns=3\ninDegrees=YES\n",
}


@pytest.mark.parametrize("name", HEADERS)
def test_angles_are_in_degrees_where_opensim_takes_them_so(opensim: Any, name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(HEADERS[name] + BODY)
    in_degrees = opensim.Storage(str(tmp_path / name)).isInDegrees()
    with Recording(tmp_path / name) as recording:
        metadata = recording.topics["joints"].metadata
        assert [row["q"] for row in recording["joints"].rows()] == [[10.0, 20.0], [30.0, 40.0]]
        file = recording.export(tmp_path / "again.sto", format="sto")
    assert metadata.get("units", {}).get("q", "rad") == ("deg" if in_degrees else "rad")
    assert opensim.Storage(str(file)).isInDegrees() == in_degrees
    if "inDegrees" not in HEADERS[name] and not in_degrees:
        assert "units" not in metadata, "the file does not say"


def test_quaternions_and_vectors_that_opensim_writes_are_fields(opensim: Any, tmp_path: Path) -> None:
    table = opensim.TimeSeriesTableQuaternion()
    table.setColumnLabels(["torso_imu"])
    for frame in range(3):
        table.appendRow(frame / 4, opensim.RowVectorQuaternion(1, opensim.Quaternion(0.5, 0.5, -0.5, 0.5)))
    opensim.STOFileAdapterQuaternion.write(table, str(tmp_path / "q.sto"))
    with Recording(tmp_path / "q.sto") as recording:
        rows = list(recording["orientations"].rows())
        assert recording.topics["orientations"].metadata["quat_order"] == "wxyz"
    assert rows == [{"torso_imu": [0.5, 0.5, -0.5, 0.5], "_ts": frame / 4} for frame in range(3)]

    vectors = opensim.TimeSeriesTableVec3()
    vectors.setColumnLabels(["a", "b"])
    for frame in range(3):
        row = opensim.RowVectorVec3(2)
        row[0], row[1] = opensim.Vec3(frame, 2, 3), opensim.Vec3(float("nan"))
        vectors.appendRow(frame / 4 - 5e-7, row)
    opensim.STOFileAdapterVec3.write(vectors, str(tmp_path / "v.sto"))
    with pytest.warns(ConversionWarning, match="moved by 5e-07 s"):
        back = read_back(tmp_path / "v.sto", tmp_path / "v")
    assert [row["_ts"] for row in back["vectors"]] == pytest.approx([0.0, 0.25, 0.5], abs=1e-12)
    assert [{**row, "_ts": 0} for row in back["vectors"]] == [{"a": [frame, 2.0, 3.0], "_ts": 0} for frame in range(3)]


VECTORS = "DataType={kind}\nversion=3\nendheader\ntime{separator}a{separator}b\n"


@pytest.mark.parametrize(
    ("kind", "size"),
    [("Vec2", 2), ("Vec3", 3), ("UnitVec3", 3), ("Vec6", 6), ("SpatialVec", 6), ("Quaternion", 4), ("vec3", 3)],
)
@pytest.mark.parametrize("separator", ["\t", "  ", ";"])
def test_every_type_of_elements_is_read(kind: str, size: int, separator: str, tmp_path: Path) -> None:
    cells = [",".join(str(first + at) for at in range(size)) for first in (0, 10)]
    empty = "" if separator != "  " else ",".join(["nan"] * size)
    text = VECTORS.format(kind=kind, separator=separator)
    text += separator.join(("0", *cells)) + "\n" + separator.join(("0.5", empty, cells[1])) + "\n\n"
    (tmp_path / "x.sto").write_text(text)
    (rows,) = read_back(tmp_path / "x.sto", tmp_path / "back").values()
    a, b = ([float(first + at) for at in range(size)] for first in (0, 10))
    assert rows == [{"a": a, "b": b, "_ts": 0.0}, {"b": b, "_ts": 0.5}]


def test_vectors_in_a_csv_with_quotes_and_in_brackets_are_read(tmp_path: Path) -> None:
    (tmp_path / "x.sto").write_text('DataType=Vec3,,\nversion=3,,\nendheader,,\ntime,a,b\n0,"1,2,3","~[4, 5, 6]"\n')
    assert read_back(tmp_path / "x.sto", tmp_path / "back")["vectors"] == [
        {"a": [1.0, 2.0, 3.0], "b": [4.0, 5.0, 6.0], "_ts": 0.0}
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (VECTORS.format(kind="Vec3", separator="\t") + "0\t1,2,3\t1,2\n", "line 5, column 3: '1,2' has 2 elements, and a Vec3 has 3"),
        (VECTORS.format(kind="Vec3", separator="\t") + "0\t1,x,3\t1,2,3\n", "line 5, column 2: 'x' is not a number"),
        (VECTORS.format(kind="Vec3", separator="\t") + "0\t1,2,3\n", "line 5: the line has"),
        (VECTORS.format(kind="Tensor", separator="\t") + "0\t1\t2\n", "DataType=Tensor is not known; double, Quaternion, Vec2"),
    ],
)  # fmt: skip
def test_elements_that_are_wrong_are_an_error_with_line_and_column(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "x.sto").write_text(text)
    with pytest.raises(ForeignFileError, match=message):
        read_back(tmp_path / "x.sto", tmp_path / "back")


def test_what_is_bad_in_vectors_is_left_out_where_that_is_allowed(tmp_path: Path) -> None:
    (tmp_path / "x.sto").write_text(VECTORS.format(kind="Vec3", separator="\t") + "0\t1,2\t1,x,3\n1\t1,2,3\t4,5,6\n")
    with pytest.warns(ConversionWarning, match="4 cells"):
        back = read_back(tmp_path / "x.sto", tmp_path / "back", on_bad="missing")
    assert back["vectors"] == [
        {"b": [1.0, None, 3.0], "_ts": 0.0},
        {"a": [1.0, 2.0, 3.0], "b": [4.0, 5.0, 6.0], "_ts": 1.0},
    ]


def test_forces_keep_the_unit_of_their_header_and_are_not_said_to_be_angles(tmp_path: Path) -> None:
    (tmp_path / "grf.sto").write_text(
        "forces\nversion=1\nnRows=1\nnColumns=2\nUnits=N\nendheader\ntime\tground_force_vx\n0\t700\n"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        recording = Recording(tmp_path / "grf.sto")
    with recording:
        metadata = recording.topics["joints"].metadata
    assert metadata["sto"]["units"] == "N"
    assert metadata["units"] == {"q": "N"}


def test_vectors_keep_the_unit_of_their_header_and_an_export_goes_by_it(tmp_path: Path) -> None:
    text = (
        VECTORS.format(kind="Vec3", separator="\t")
        .replace("version=3", "version=3\nUnits=mm")
        .replace("a\tb", "a_pos\tb_pos")
    )
    (tmp_path / "x.sto").write_text(text + "0\t1,2,3\t4,5,6\n0.5\t1,2,3\t4,5,6\n")
    with Recording(tmp_path / "x.sto") as recording:
        assert recording.topics["vectors"].metadata["units"] == {"a_pos": "mm", "b_pos": "mm"}
        assert next(iter(recording["vectors"].rows()))["a_pos"] == [1.0, 2.0, 3.0]
        file = recording.export(tmp_path / "x.trc", format="trc")
    last = file.read_text().splitlines()[-1].split("\t")
    assert [float(cell) for cell in last[2:]] == [0.001, 0.002, 0.003, 0.004, 0.005, 0.006]
