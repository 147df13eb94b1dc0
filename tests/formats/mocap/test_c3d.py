"""C3D files: points, rotations and joints come back to float32, and ezc3d, c3d and their users read them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import c3d
import ezc3d
import numpy as np
import pytest

from ml_dash_mcap.errors import ConversionError, ConversionWarning, ForeignFileError
from ml_dash_mcap.recorder import Recorder
from ml_dash_mcap.recording import Recording
from tests.formats.mocap.support import UNIT, Rows, read_back, record
from tests.support import shared


def moving(count: int = 6) -> Rows:
    return {
        "arm": [
            {"pos": [frame / 8, 0.1, 0.25], "quat": UNIT, "q": [frame / 3, -1.0], "_ts": 4 + frame / 64}
            for frame in range(count)
        ],
        "hand": [
            {"markers": {"tool": [1.0, frame / 4, 3.0]}, "_ts": 4 + frame / 64} for frame in range(count) if frame != 2
        ],
    }


def close(rows: Rows, other: Rows) -> None:
    """Hold rows against others: the same fields and times, numbers to float32."""
    assert rows.keys() == other.keys()
    for topic, some in rows.items():
        assert [row["_ts"] for row in some] == [row["_ts"] for row in other[topic]]
        for row, wanted in zip(some, other[topic], strict=True):
            assert row.keys() == wanted.keys()
            for name, value in wanted.items():
                given = row[name]
                pairs = [(given[key], value[key]) for key in value] if isinstance(value, dict) else [(given, value)]
                for one, expected in pairs:
                    np.testing.assert_allclose(one, expected, rtol=2**-23, atol=1e-7)


@pytest.mark.parametrize("unit", ["m", "mm"])
@pytest.mark.parametrize("up", [None, "y"])
def test_what_was_written_comes_back_to_float32(unit: str, up: str | None, tmp_path: Path) -> None:
    with record(tmp_path / "run", moving(), arm={"quat_order": "wxyz"}) as recording:
        file = recording.export(tmp_path / "x.c3d", format="c3d", length_units=unit, up=up)
    close(read_back(file, tmp_path / "back"), moving())


def test_ezc3d_reads_points_rotations_and_joints(tmp_path: Path) -> None:
    with record(tmp_path / "run", moving(), arm={"joint_names": ["a", "b"]}) as recording:
        file = ezc3d.c3d(str(recording.export(tmp_path / "x.c3d", format="c3d")))
    assert file["parameters"]["POINT"]["LABELS"]["value"] == ["arm", "hand:tool"]
    assert file["parameters"]["POINT"]["RATE"]["value"] == [64]
    points = file["data"]["points"]
    assert points.shape == (4, 2, 6)
    assert points[0, 0].tolist() == [frame / 8 for frame in range(6)]
    assert np.isnan(points[0, 1]).tolist() == [False, False, True, False, False, False]
    assert file["parameters"]["ANALOG"]["LABELS"]["value"] == ["a", "b"]
    np.testing.assert_allclose(file["data"]["analogs"][0, 0], [frame / 3 for frame in range(6)], rtol=1e-7)
    matrix = file["data"]["rotations"][:, :, 0, 1]
    assert matrix.tolist() == [[0, 0, 1, 0.125], [1, 0, 0, pytest.approx(0.1)], [0, 1, 0, 0.25], [0, 0, 0, 1]]


@pytest.mark.filterwarnings("ignore:No analog data")  # which c3d thinks worth a warning
def test_c3d_reads_points_with_a_residual_of_minus_one_where_one_is_missing(tmp_path: Path) -> None:
    rows = {
        "hand": moving()["hand"],
        "loose": [{"markers": {"a": [1.0, 2.0, 3.0]}, "_ts": 4 + frame / 64} for frame in range(6)],
    }
    with record(tmp_path / "run", rows) as recording:
        file = recording.export(tmp_path / "x.c3d", format="c3d")
    with file.open("rb") as handle:
        reader = c3d.Reader(handle)
        assert [label.strip() for label in reader.point_labels] == ["hand:tool", "loose:a"]
        assert reader.point_rate == 64
        frames = [points for _, points, _ in reader.read_frames()]
    assert [frame[0, 3] for frame in frames] == [0, 0, -1, 0, 0, 0]
    assert [frame[0, :3].tolist() for frame in frames if frame[0, 3] >= 0] == [[1, at / 4, 3] for at in (0, 1, 3, 4, 5)]


@pytest.mark.parametrize(
    ("name", "points", "frames", "rate", "missing"),
    [
        ("a-kineticstoolkit-tennis-nan.c3d", 39, 1092, 50.0, 0.0034),
        ("a-kineticstoolkit-racing-propulsion.c3d", 41, 700, 69.9926, 0.2224),
    ],
)
def test_real_files_read_with_their_counts(
    name: str, points: int, frames: int, rate: float, missing: float, tmp_path: Path
) -> None:
    back = read_back(shared.file(f"mocap/{name}"), tmp_path / "back")
    names = {(topic, key) for topic, rows in back.items() for row in rows for key in row.get("markers", {})}
    assert len(names) <= points
    assert {len(rows) for rows in back.values()} == {frames}
    times = [row["_ts"] for row in next(iter(back.values()))]
    assert 1 / (times[1] - times[0]) == pytest.approx(rate, abs=1e-3)
    there = sum(len(row.get("markers", {})) for rows in back.values() for row in rows)
    assert 1 - there / (points * frames) == pytest.approx(missing, abs=1e-3)


def test_analog_channels_keep_their_own_rate(tmp_path: Path) -> None:
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    file["parameters"]["POINT"]["LABELS"]["value"] = ["a"]
    file["data"]["points"] = np.full((4, 1, 3), 500.0)
    file["parameters"]["ANALOG"]["RATE"]["value"] = [200.0]
    file["parameters"]["ANALOG"]["LABELS"]["value"] = ["Fx"]
    file["data"]["analogs"] = np.arange(6.0).reshape(1, 1, 6)
    file.write(str(tmp_path / "x.c3d"))
    back = read_back(tmp_path / "x.c3d", tmp_path / "back")
    assert back["analog"] == [{"Fx": float(at), "_ts": at / 200} for at in range(6)]
    assert back["markers"] == [{"markers": {"a": [0.5, 0.5, 0.5]}, "_ts": at / 100} for at in range(3)]


def test_more_than_65535_frames_are_an_error_that_says_what_to_do(tmp_path: Path) -> None:
    count = 65_536
    with Recorder(tmp_path / "run") as recorder:
        recorder.topic("hand").append_columns(_ts=np.arange(count) / 64, marker=np.zeros((count, 3)))
    with Recording(tmp_path / "run") as recording:
        with pytest.raises(
            ConversionError, match=r"at most 65535 frames, and these are 65536: .* end=, or a lower rate="
        ):
            recording.export(tmp_path / "x.c3d", format="c3d")
        assert recording.export(tmp_path / "x.c3d", format="c3d", end=1.0).exists()


def test_numbers_far_from_the_origin_draw_a_warning_about_float32(tmp_path: Path) -> None:
    rows: dict[str, Any] = {"hand": [{"markers": {"a": [123456.785, 0.0, 0.0]}, "_ts": float(at)} for at in range(2)]}
    with record(tmp_path / "run", rows) as recording, pytest.warns(ConversionWarning, match=r"float32 .* 0\.0\d+ m"):
        recording.export(tmp_path / "x.c3d", format="c3d")


@pytest.mark.parametrize("keep", [100, 600, 3000])
def test_a_cut_file_is_an_error(keep: int, tmp_path: Path) -> None:
    with record(tmp_path / "run", moving(60)) as recording:
        file = recording.export(tmp_path / "x.c3d", format="c3d")
    file.write_bytes(file.read_bytes()[:keep])
    with pytest.raises(ForeignFileError, match="no whole C3D file"):
        read_back(file, tmp_path / "back")
