"""What motion capture knows without files: rotations, frames, resampling, names, and numbers as text."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ml_dash_mcap.formats.mocap import frame_numbers, placement, resample
from ml_dash_mcap.formats.mocap.placement import Note, Placement
from ml_dash_mcap.formats.mocap.table_text import shifted
from ml_dash_mcap.meaning import mocap_objects, rotations, space

component = st.floats(-1, 1)


@st.composite
def unit_quaternions(draw: Any) -> Any:
    found = np.array(draw(st.lists(st.lists(component, min_size=4, max_size=4), min_size=1, max_size=10)))
    length = np.linalg.norm(found, axis=1, keepdims=True)
    return np.where(length < 0.1, [0.0, 0.0, 0.0, 1.0], found / np.maximum(length, 0.1))


@given(unit_quaternions())
def test_a_rotation_becomes_a_matrix_and_comes_back(found: Any) -> None:
    back, bad = rotations.of_matrices(rotations.to_matrices(found))
    assert not bad.any()
    assert np.abs(np.sum(back * found, axis=1)) == pytest.approx(np.ones(len(found)), abs=1e-12)


def test_what_is_no_rotation_is_told() -> None:
    mirror = np.diag([1.0, 1.0, -1.0])
    missing = np.full((3, 3), np.nan)
    assert rotations.of_matrices(np.stack([np.eye(3), 2 * np.eye(3), mirror, missing]))[1].tolist() == [
        False,
        True,
        True,
        False,
    ]


@given(unit_quaternions(), st.data())
def test_neighbours_are_never_on_opposite_sides(found: Any, data: Any) -> None:
    signs = data.draw(st.lists(st.sampled_from([-1.0, 1.0]), min_size=len(found), max_size=len(found)))
    mixed = found * np.array(signs)[:, None]
    half = len(mixed) // 2
    first, last = rotations.continuous(mixed[:half], None)
    second, _ = rotations.continuous(mixed[half:], last)
    whole, _ = rotations.continuous(mixed, None)
    both = np.concatenate((first, second))
    assert both.tolist() == whole.tolist(), "windows make no difference"
    assert np.array_equal(np.abs(both), np.abs(mixed))
    assert (np.sum(both[1:] * both[:-1], axis=1) >= 0).all()


@given(unit_quaternions(), st.sampled_from(["y", "z"]), st.sampled_from(["y", "z"]))
def test_turning_there_and_back_changes_no_bit(found: Any, up: str, to: str) -> None:
    points = found[:, :3]
    assert np.array_equal(space.turned(space.turned(points, up, to), to, up), points)
    assert np.array_equal(space.turned_rotations(space.turned_rotations(found, up, to), to, up), found)
    matrices = rotations.to_matrices(found)
    turned = rotations.to_matrices(space.turned_rotations(found, up, to))
    moved = np.einsum("nij,nj->ni", matrices, points)
    np.testing.assert_allclose(
        np.einsum("nij,nj->ni", turned, space.turned(points, up, to)), space.turned(moved, up, to), atol=1e-12
    )


@given(st.floats(0, 4e9), st.lists(st.floats(0, 1e6), min_size=1))
def test_times_count_from_their_origin_without_rounding(first: float, distances: list[float]) -> None:
    times = sorted(first + distance for distance in distances)
    origin = frame_numbers.exact_origin(times[0], times[-1])
    assert 0 <= origin <= times[0]
    assert times[0] - origin < math.ulp(times[-1])
    assert [origin + (time - origin) for time in times] == times


@given(st.integers(1, 10**9), st.sets(st.integers(0, 50), min_size=2), st.randoms())
def test_samples_with_holes_have_the_frames_that_they_were_taken_at(step_ns: int, taken: set[int], random: Any) -> None:
    step_ns += 1000
    first = min(taken)
    numbers = sorted({first, first + 1} | taken)
    times = np.array([number * step_ns + random.randint(-step_ns // 1000, step_ns // 1000) for number in numbers])
    found = frame_numbers.spacing(times).frames
    assert found is not None
    assert found.tolist() == [number - first for number in numbers]


def test_a_rate_is_the_mean_one_without_the_noise_of_nanoseconds() -> None:
    times = np.rint(np.arange(1000) * 1e9 / 30).astype(np.int64)
    assert frame_numbers.mean_rate(times, np.arange(1000)) == 30.0


def test_values_are_held_for_no_longer_than_a_gap_may_be() -> None:
    times, values = np.array([0.0, 1.0]), np.array([[1.0], [2.0]])
    found = resample.at(times, values, np.array([-1.0, 0.0, 0.4, 0.6, 1.2, 9.0]), 0.5, "hold")
    assert found[:, 0].tolist()[1:3] == [1.0, 1.0]
    assert np.isnan(found[:, 0]).tolist() == [True, False, False, True, False, True]


@given(st.floats(allow_nan=False, allow_infinity=False), st.integers(-6, 6))
def test_a_moved_decimal_point_is_exact(value: float, places: int) -> None:
    text = shifted(value, places)
    mantissa, _, exponent = text.partition("e")
    assert float(f"{mantissa}e{int(exponent or 0) - places}") == value


def test_objects_are_found_by_name_and_shape() -> None:
    shapes: dict[tuple[str, ...], tuple[int, ...]] = {
        ("ee_pos",): (3,),
        ("ee_quat",): (4,),
        ("tcp", "position"): (3,),
        ("tcp", "orientation"): (4,),
        ("T_base_cam",): (4, 4),
        ("K",): (4, 4),
        ("ee_vel",): (3,),
        ("q",): (2,),
        ("dq",): (2,),
        ("gripper_width",): (),
        ("joint_pos",): (3,),
        ("goal_pos",): (3,),
        ("markers", "a.b"): (3,),
    }
    found = mocap_objects.find("arm", shapes, {"joint_names": ["one", "two"], "quat_order": "wxyz"})
    assert {body.name: body.order for body in found.bodies} == {
        "arm:ee": "wxyz",
        "arm:tcp": "wxyz",
        "arm:T_base_cam": "wxyz",
    }
    assert [marker.name for marker in found.markers] == ["arm:goal", "arm:a.b"]
    assert [joint.name for joint in found.joints] == [
        *("one", "two", "one_u", "two_u", "gripper_width", "q0", "q1", "q2"),
    ]


def test_a_note_comes_back_in_letters_that_any_header_takes() -> None:
    place = Placement('Ärm, "x"', ("markers", "😀"), (3,), (0, 1, 2))
    note = Note(1.5, "y", (place,), {'Ärm, "x"': {"units": {"q": "rad"}}}, "x.sto")
    text = placement.to_text(note)
    assert text.isascii()
    assert text.isprintable()
    assert placement.from_text(text, 3) == note
    assert placement.from_text(text, 2) is None, "it speaks of a column that is not there"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        "[]",
        '{"v": 2}',
        '{"v": 1, "origin": "x"}',
        '{"v":1,"origin":-1,"up":null,"topics":{},"joints":null}',
        "null",
    ],
)
def test_what_is_no_note_is_none(text: str) -> None:
    assert placement.from_text(text, 10) is None
