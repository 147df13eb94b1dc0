"""C3D files of other tools: model outputs keep their units, and whatever says how many frames there are, all are read."""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

import c3d
import ezc3d
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ml_dash_mcap import Recording
from ml_dash_mcap.errors import ConversionWarning, ForeignFileError, OptionError
from tests.formats.mocap.c3d_bytes import build, frame
from tests.formats.mocap.support import read_back, rows_of
from tests.support.examples import examples

LABELS = ["LASI", "LKneeAngles", "LKneeMoment", "LKneePower", "LGroundReaction", "StepLength", "Bob:RKneeAngles"]
POINT: dict[str, Any] = {
    "USED": [7],
    "FRAMES": [2],
    "RATE": [100.0],
    "UNITS": ["mm"],
    "LABELS": LABELS,
    "ANGLES": ["LKneeAngles", "RKneeAngles"],
    "ANGLE_UNITS": ["deg"],
    "MOMENTS": ["LKneeMoment"],
    "MOMENT_UNITS": ["N.mm/kg"],
    "POWERS": ["LKneePower"],
    "POWER_UNITS": ["W/kg"],
    "FORCES": ["LGroundReaction"],
    "FORCE_UNITS": ["N"],
    "SCALARS": ["StepLength"],
    "SCALAR_UNITS": ["mm"],
    "TYPE_GROUPS": ["ANGLES", "MOMENTS", "POWERS", "FORCES", "SCALARS"],
}


def points(shift: float = 0.0) -> list[tuple[float, float, float, float]]:
    first = [(500.0, 250.0, 1000.0), (10.02, -1.5, 0.25), (812.5, 0.0, 1.0), (0.0, 0.0, 1.75), (0.0, 0.0, 686.0)]
    return [(x + shift, y, z, 0.0) for x, y, z in [*first, (600.0, 0.0, 0.0), (20.0, 0.0, 0.0)]]


def test_model_outputs_keep_their_numbers_and_their_units(tmp_path: Path) -> None:
    file = tmp_path / "x.c3d"
    file.write_bytes(build([frame(points()), frame(points(1.0))], {"POINT": POINT}, points=7))
    judge = ezc3d.c3d(str(file))
    assert judge["parameters"]["POINT"]["ANGLE_UNITS"]["value"] == ["deg"]
    with Recording(file) as recording:
        row = next(iter(recording["model_outputs"].rows()))
        assert row["angles"]["LKneeAngles"] == np.float32([10.02, -1.5, 0.25]).tolist()
        assert row["angles"]["LKneeAngles"] == judge["data"]["points"][:3, 1, 0].tolist()
        assert row["moments"] == {"LKneeMoment": [812.5, 0.0, 1.0]}
        assert row["powers"] == {"LKneePower": [0.0, 0.0, 1.75]}
        assert row["forces"] == {"LGroundReaction": [0.0, 0.0, 686.0]}
        assert row["scalars"] == {"StepLength": [600.0, 0.0, 0.0]}
        assert row["angles"]["Bob:RKneeAngles"] == [20.0, 0.0, 0.0]
        units = recording.topics["model_outputs"].metadata["units"]
        assert units == {"angles": "deg", "moments": "N.mm/kg", "powers": "W/kg", "forces": "N", "scalars": "mm"}
        assert next(iter(recording["markers"].rows()))["markers"] == {"LASI": [0.5, 0.25, 1.0]}
        metadata = recording.topics["markers"].metadata
        assert (metadata["length_units"], metadata["converted"]) == ("m", "lengths from mm to m")


@pytest.mark.parametrize("group", ["ANGLES", "MOMENTS", "FORCES", "POWERS", "SCALARS", "REACTIONS", "VELOCITIES"])
def test_any_group_with_units_of_its_own_is_no_position(group: str, tmp_path: Path) -> None:
    said = {"USED": [1], "FRAMES": [1], "RATE": [50.0], "UNITS": ["mm"], "LABELS": ["a"], group: ["a"]}
    said[f"{group[:-1]}_UNITS"] = ["thing/s"]
    (tmp_path / "x.c3d").write_bytes(build([frame([(10.02, 0, 0, 0)])], {"POINT": said}, points=1))
    with Recording(tmp_path / "x.c3d") as recording:
        (row,) = recording["model_outputs"].rows()
        assert row[group.lower()]["a"][0] == float(np.float32(10.02))
        assert recording.topics["model_outputs"].metadata["units"] == {group.lower(): "thing/s"}
        assert list(recording.topics) == ["model_outputs"]


def test_labels_beyond_the_255th_are_outputs_too(tmp_path: Path) -> None:
    labels = [f"p{at}" for at in range(300)]
    said = {
        "USED": [300],
        "FRAMES": [1],
        "RATE": [50.0],
        "UNITS": ["mm"],
        "LABELS": labels[:255],
        "LABELS2": labels[255:],
    }
    said |= {"ANGLES": labels[:2], "ANGLES2": labels[298:], "ANGLE_UNITS": ["deg"]}
    (tmp_path / "x.c3d").write_bytes(build([frame([(7.0, 0, 0, 0)] * 300)], {"POINT": said}, points=300))
    back = read_back(tmp_path / "x.c3d", tmp_path / "back")
    assert set(back["model_outputs"][0]["angles"]) == {"p0", "p1", "p298", "p299"}
    assert set(back["markers"][0]["markers"]) == set(labels[2:298])


ANALOG: dict[str, Any] = {
    "USED": [3],
    "LABELS": ["Fz", "EMG", "Cx"],
    "UNITS": ["N", "V", "mm"],
    "RATE": [200.0],
    "GEN_SCALE": [1.0],
    "SCALE": [1.0, 0.5, 1.0],
    "OFFSET": [0, 2, 0],
}


def test_a_file_of_analog_signals_only_is_read(tmp_path: Path) -> None:
    frames = [frame([], [at, 2.0 + at, 100.0, at + 0.5, 3.0 + at, 200.0]) for at in range(4)]
    said = {"POINT": {"USED": [0], "FRAMES": [4], "RATE": [100.0]}, "ANALOG": ANALOG}
    file = tmp_path / "x.c3d"
    file.write_bytes(build(frames, said, points=0, analogs=6, samples=2))
    judge = ezc3d.c3d(str(file))["data"]["analogs"][0]
    with Recording(file) as recording:
        assert list(recording.topics) == ["analog"]
        rows = list(recording["analog"].rows())
        metadata = recording.topics["analog"].metadata
    assert [row["_ts"] for row in rows] == [at / 200 for at in range(8)]
    assert [row["Fz"] for row in rows] == judge[0].tolist() == [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5]
    assert [row["EMG"] for row in rows] == judge[1].tolist()
    assert [row["Cx"] for row in rows] == [0.1, 0.2] * 4
    assert metadata["units"] == {"Fz": "N", "EMG": "V", "Cx": "m"}
    assert metadata["converted"] == "lengths from mm to m"


def test_analog_signals_have_their_own_rate_where_there_is_no_rate_of_points(tmp_path: Path) -> None:
    said = {"POINT": {"USED": [0], "FRAMES": [4], "RATE": [0.0]}, "ANALOG": ANALOG}
    frames = [frame([], [at, 2.0, 0.0]) for at in range(4)]
    (tmp_path / "x.c3d").write_bytes(build(frames, said, points=0, analogs=3, samples=1, rate=0.0))
    rows = read_back(tmp_path / "x.c3d", tmp_path / "back")["analog"]
    assert [(row["_ts"], row["Fz"]) for row in rows] == [(at / 200, float(at)) for at in range(4)]


def test_analog_signals_that_ezc3d_writes_alone_are_read(tmp_path: Path) -> None:
    file = ezc3d.c3d()
    file["data"]["points"] = np.zeros((4, 0, 2))
    file["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    file["parameters"]["ANALOG"]["RATE"]["value"] = [1000.0]
    file["parameters"]["ANALOG"]["LABELS"]["value"] = ["a", "b"]
    file["parameters"]["ANALOG"]["UNITS"]["value"] = ["V", "N"]
    file["data"]["analogs"] = np.arange(40.0).reshape(1, 2, 20)
    file.write(str(tmp_path / "x.c3d"))
    with Recording(tmp_path / "x.c3d") as recording:
        found = recording["analog"].to_numpy()
        assert recording.topics["analog"].metadata["units"] == {"a": "V", "b": "N"}
    assert found["a"].tolist() == list(range(20))
    assert found["_ts"].tolist() == [at / 1000 for at in range(20)]


@pytest.mark.parametrize(
    ("header", "stated"),
    [(30, 12), (12, 30), (12, 3), (3, 12), (65535, 12), (0, 12), (12, None)],
)
def test_the_frames_that_are_there_count_where_header_and_parameters_differ(
    header: int, stated: int | None, tmp_path: Path
) -> None:
    said = {"USED": [1], "RATE": [100.0], "UNITS": ["mm"], "LABELS": ["a"]}
    said |= {} if stated is None else {"FRAMES": [stated]}
    frames = [frame([(at + 1, 0, 0, 0)]) for at in range(12)]
    (tmp_path / "x.c3d").write_bytes(build(frames, {"POINT": said}, points=1, last=header))
    rows = read_back(tmp_path / "x.c3d", tmp_path / "back")["markers"]
    assert [row["markers"]["a"][0] for row in rows] == [(at + 1) / 1000 for at in range(12)]


COUNT = 70_000


@pytest.mark.parametrize(
    "more",
    [
        {"POINT": {"LONG_FRAMES": [float(COUNT)], "FRAMES": [-1]}},
        {"POINT": {"FRAMES": [float(COUNT)]}},
        {"POINT": {"FRAMES": [-1]}, "TRIAL": {"ACTUAL_START_FIELD": [1, 0], "ACTUAL_END_FIELD": [COUNT - 65536, 1]}},
        {"POINT": {"FRAMES": [-1]}},
    ],
    ids=["LONG_FRAMES", "FRAMES as a real", "ACTUAL_END_FIELD", "nothing but the data"],
)
def test_more_than_65535_frames_are_read(more: dict[str, Any], tmp_path: Path) -> None:
    point = {"USED": [1], "RATE": [100.0], "UNITS": ["mm"], "LABELS": ["a"], **more["POINT"]}
    said = {"POINT": point, **{name: some for name, some in more.items() if name != "POINT"}}
    frames = [struct.pack("<4f", at + 1, 1, 1, 0) for at in range(COUNT)]
    (tmp_path / "x.c3d").write_bytes(build(frames, said, points=1, last=65535))
    with Recording(tmp_path / "x.c3d") as recording:
        found = recording["markers"].to_numpy()
    assert len(found["_ts"]) == COUNT
    assert np.array_equal(found["_ts"], np.arange(COUNT) / 100)
    np.testing.assert_allclose(found["markers.a"][:, 0], np.arange(1, COUNT + 1) / 1000, rtol=1e-15)


# Other processors and kinds of numbers


def test_whole_numbers_are_scaled_as_ezc3d_and_c3d_do(tmp_path: Path) -> None:
    frames = [struct.pack("<4h2h", 100 * at, -200, 300, 0, 2048 + at, 7) for at in range(5)]
    point = {
        "USED": [1],
        "FRAMES": [5],
        "DATA_START": [3],
        "DESCRIPTIONS": ["a"],
        "SCALE": [0.1],
        "RATE": [50.0],
        "UNITS": ["mm"],
        "LABELS": ["a"],
    }
    analog = {"USED": [2], "LABELS": ["u", "v"], "DESCRIPTIONS": ["u", "v"], "UNITS": ["V", ""], "RATE": [50.0], "GEN_SCALE": [0.5], "SCALE": [2.0, 1.0], "OFFSET": [2048, 0], "FORMAT": "SIGNED"}  # fmt: skip
    file = tmp_path / "x.c3d"
    file.write_bytes(
        build(frames, {"POINT": point, "ANALOG": analog}, points=1, analogs=2, samples=1, scale=0.1, rate=50.0)
    )
    back = read_back(file, tmp_path / "back")
    judge = ezc3d.c3d(str(file))["data"]
    np.testing.assert_allclose(
        [row["markers"]["a"] for row in back["markers"]], judge["points"][:3, 0].T / 1000, rtol=1e-6
    )
    np.testing.assert_allclose([row["u"] for row in back["analog"]], judge["analogs"][0, 0], rtol=1e-6)
    assert [row["u"] for row in back["analog"]] == [0.0, 1.0, 2.0, 3.0, 4.0]
    with file.open("rb") as handle:
        frames_of_c3d = [found[0, :3] for _, found, _ in c3d.Reader(handle).read_frames()]
    np.testing.assert_allclose(
        [row["markers"]["a"] for row in back["markers"]], np.array(frames_of_c3d) / 1000, rtol=1e-6
    )


def dec(value: float) -> bytes:
    """Spell a real as VAXes do."""
    data = struct.pack("<f", value * 4)
    return data[2:] + data[:2]


def test_the_reals_of_other_processors_are_read(tmp_path: Path) -> None:
    said = {"POINT": {"USED": [1], "FRAMES": [2], "RATE": [100.0], "UNITS": ["mm"], "LABELS": ["a"]}}
    frames = [frame([(1.5, -2.25, 3.0 + at, 0)], order=">") for at in range(2)]
    (tmp_path / "mips.c3d").write_bytes(build(frames, said, points=1, processor=86))
    frames = [b"".join(map(dec, (1.5, -2.25, 3.0 + at, 0.0))) for at in range(2)]
    data = bytearray(build(frames, said, points=1, processor=85))
    data[12:16] = dec(-1.0)
    data[20:24] = dec(100.0)
    where = data.index(struct.pack("<f", 100.0))
    data[where : where + 4] = dec(100.0)
    (tmp_path / "dec.c3d").write_bytes(data)
    for name in ("mips", "dec"):
        rows = read_back(tmp_path / f"{name}.c3d", tmp_path / name)["markers"]
        assert rows == [{"markers": {"a": [0.0015, -0.00225, (3.0 + at) / 1000]}, "_ts": at / 100} for at in range(2)]


def test_positions_of_rotations_are_lengths_like_those_of_points(tmp_path: Path) -> None:
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    file["parameters"]["POINT"]["LABELS"]["value"] = ["a"]
    file["data"]["points"] = np.full((4, 1, 3), 500.0)
    file.add_parameter("ROTATION", "LABELS", ["arm"])
    file.add_parameter("ROTATION", "RATE", [100.0])
    matrix = np.eye(4)
    matrix[:3, 3] = (1000.0, 2000.0, 250.0)
    file["data"]["rotations"] = np.repeat(matrix[:, :, None, None], 3, axis=3)
    file.write(str(tmp_path / "x.c3d"))
    back = read_back(tmp_path / "x.c3d", tmp_path / "back")
    assert [row["pos"] for row in back["arm"]] == [[1.0, 2.0, 0.25]] * 3
    assert [row["quat"] for row in back["arm"]] == [[0.0, 0.0, 0.0, 1.0]] * 3


@settings(max_examples=examples(25), deadline=None)
@given(data=st.data())
def test_every_number_is_the_one_that_ezc3d_reads(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("c3d")
    count, points = data.draw(st.integers(1, 40)), data.draw(st.integers(0, 4))
    channels, samples = data.draw(st.integers(0 if points else 1, 3)), data.draw(st.integers(1, 4))
    number = st.floats(-1e4, 1e4, width=32)
    frames = []
    for _ in range(count):
        some = [
            (*data.draw(st.tuples(number, number, number)), data.draw(st.sampled_from([0.0, -1.0])))
            for _ in range(points)
        ]
        frames.append(
            frame(some, data.draw(st.lists(number, min_size=channels * samples, max_size=channels * samples)))
        )
    point = {"USED": [points], "FRAMES": [count], "RATE": [50.0], "UNITS": ["mm"]}
    point |= {"LABELS": [f"p{at}" for at in range(points)]} if points else {}
    said: dict[str, Any] = {"POINT": point}
    if channels:
        names = [f"c{at}" for at in range(channels)]
        scales = {"GEN_SCALE": [0.5], "SCALE": [2.0, 4.0, 0.25][:channels], "OFFSET": [0, 3, 2][:channels]}
        said["ANALOG"] = {"USED": [channels], "LABELS": names, "RATE": [50.0 * samples], **scales}
    file = folder / "x.c3d"
    file.write_bytes(build(frames, said, points=points, analogs=channels * samples, samples=samples, rate=50.0))
    judge = ezc3d.c3d(str(file))["data"]
    back = read_back(file, folder / "back")
    assert len(back.get("markers", [])) == (count if points else 0)
    for at in range(points):
        ours = [row.get("markers", {}).get(f"p{at}", [math.nan] * 3) for row in back["markers"]]
        np.testing.assert_allclose(ours, judge["points"][:3, at].T / 1000, rtol=1e-12)
    for at in range(channels):
        np.testing.assert_allclose(
            [row[f"c{at}"] for row in back["analog"]], judge["analogs"][0, at], rtol=1e-6, atol=1e-4
        )
        assert [row["_ts"] for row in back["analog"]] == [one / (50.0 * samples) for one in range(count * samples)]


def test_an_offset_below_0_is_subtracted_as_the_format_says_and_c3d_does(tmp_path: Path) -> None:
    """The user guide: (value - OFFSET) * SCALE * GEN_SCALE; ezc3d takes the offset without its sign."""
    point = {"USED": [1], "FRAMES": [2], "RATE": [50.0], "SCALE": [-1.0], "UNITS": ["mm"], "LABELS": ["a"]}
    analog = {"USED": [1], "LABELS": ["u"], "DESCRIPTIONS": ["u"], "RATE": [50.0]}
    said = {
        "POINT": {**point, "DESCRIPTIONS": ["a"], "DATA_START": [3]},
        "ANALOG": {**analog, "GEN_SCALE": [0.5], "SCALE": [0.25], "OFFSET": [-2]},
    }
    file = tmp_path / "x.c3d"
    file.write_bytes(build([frame([(1, 2, 3, 0)], [0.0])] * 2, said, points=1, analogs=1, samples=1, rate=50.0))
    with file.open("rb") as handle:
        judge = [float(values[0, 0]) for _, _, values in c3d.Reader(handle).read_frames()]
    assert [row["u"] for row in read_back(file, tmp_path / "back")["analog"]] == judge == [0.25, 0.25]


# What is missing, and what is wrong


def test_a_unit_that_is_missing_is_assumed_with_a_warning_and_can_be_passed(tmp_path: Path) -> None:
    said = {"POINT": {"USED": [1], "FRAMES": [1], "RATE": [100.0], "LABELS": ["a"]}}
    (tmp_path / "x.c3d").write_bytes(build([frame([(500, 0, 0, 0)])], said, points=1))
    with pytest.warns(ConversionWarning, match="millimetres; pass length_units="):
        assert read_back(tmp_path / "x.c3d", tmp_path / "a")["markers"][0]["markers"]["a"][0] == 0.5
    back = read_back(tmp_path / "x.c3d", tmp_path / "b", length_units="m")
    assert back["markers"][0]["markers"]["a"][0] == 500
    with pytest.raises(OptionError, match="length_units='ft'"):
        read_back(tmp_path / "x.c3d", tmp_path / "c", length_units="ft")


def test_a_cut_file_is_read_up_to_there_if_that_is_allowed(tmp_path: Path) -> None:
    said = {"POINT": {"USED": [1], "FRAMES": [90], "RATE": [100.0], "UNITS": ["mm"], "LABELS": ["a"]}}
    data = build([frame([(at + 1, 0, 0, 0)]) for at in range(90)], said, points=1)
    (tmp_path / "x.c3d").write_bytes(data[: len(data) - 400])
    with pytest.raises(ForeignFileError, match=r"x\.c3d: .* has \d+ of 90 frames; pass on_bad='missing'"):
        Recording(tmp_path / "x.c3d")
    with pytest.warns(ConversionWarning, match="ends after"):
        rows = read_back(tmp_path / "x.c3d", tmp_path / "back", on_bad="missing")["markers"]
    assert 60 < len(rows) < 90


def test_duplicate_and_odd_labels_are_fields_of_their_own(tmp_path: Path) -> None:
    labels = ["a", "a", "", "\u00e4\u00a0b"]
    said = {"POINT": {"USED": [4], "FRAMES": [1], "RATE": [100.0], "UNITS": ["m"], "LABELS": labels}}
    analog = {"USED": [3], "LABELS": ["_ts", "timestamp", "_exact"], "RATE": [100.0]}
    analog |= {"GEN_SCALE": [1.0], "SCALE": [1.0] * 3, "OFFSET": [0] * 3}
    (tmp_path / "x.c3d").write_bytes(
        build([frame([(at, 0, 0, 0) for at in range(4)], [1.0, 2.0, 3.0])], {**said, "ANALOG": analog}, points=4, analogs=3, samples=1)
    )  # fmt: skip
    with pytest.warns(ConversionWarning, match="'_ts' is '_ts_'"):
        back = read_back(tmp_path / "x.c3d", tmp_path / "back")
    assert list(back["markers"][0]["markers"]) == ["a", "a#2", "point 3", "\u00e4\u00a0b"]
    assert back["analog"] == [{"_ts_": 1.0, "timestamp": 2.0, "_exact_": 3.0, "_ts": 0.0}]
    assert rows_of(tmp_path / "back")["analog"] == back["analog"]
