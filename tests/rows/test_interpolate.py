"""Between two samples lies what mathematics says, to the last bits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ml_dash_mcap.rows.interpolate import linear, slerp
from tests.support.examples import examples

FINITE = st.floats(allow_nan=False, allow_infinity=False)
WEIGHTS = st.floats(0, 1)
DIRECTIONS = st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: math.hypot(*q) > 1e-3)


def column(value: float | list[float]) -> np.ndarray:
    return np.array([value], np.float64)


def around(axis: tuple[float, float, float], angle: float) -> list[float]:
    """The rotation about a unit axis by an angle in rad, x y z w."""
    return [*(math.sin(angle / 2) * one for one in axis), math.cos(angle / 2)]


@settings(max_examples=examples(300), deadline=None)
@given(FINITE, FINITE, WEIGHTS)
def test_a_number_on_the_line_lies_between_its_ends_and_is_them_there(a: float, b: float, weight: float) -> None:
    (found,) = linear(column(a), column(b), column(weight))
    assert min(a, b) <= found <= max(a, b)
    if weight in (0, 1):
        assert found == (a, b)[int(weight)]


@pytest.mark.parametrize("shape", [(), (7,), (4, 4)])
def test_vectors_and_matrices_are_taken_element_by_element(shape: tuple[int, ...]) -> None:
    before = np.arange(3.0 * math.prod(shape)).reshape(3, *shape)
    found = linear(before, before + 8.0, np.array([0.0, 0.25, 1.0]))
    assert np.array_equal(found, before + np.array([0.0, 2.0, 8.0]).reshape(3, *[1] * len(shape)))


def test_what_is_not_finite_stays_on_its_side() -> None:
    ends = [(math.inf, 1.0, math.inf), (-math.inf, math.inf, math.nan), (math.nan, 1.0, math.nan), (1e308, -1e308, 0.0)]
    a, b, expected = np.array(ends).T
    assert np.array_equal(linear(a, b, np.full(4, 0.5)), expected, equal_nan=True)
    assert np.array_equal(linear(a, b, np.zeros(4)), a, equal_nan=True)
    assert np.array_equal(linear(a, b, np.ones(4)), b, equal_nan=True)


@settings(max_examples=examples(300), deadline=None)
@given(st.floats(-math.pi, math.pi), st.floats(-math.pi, math.pi), WEIGHTS, st.sampled_from([1, -1]))
def test_about_one_axis_the_angle_grows_evenly_on_the_short_way(a: float, b: float, weight: float, sign: int) -> None:
    axis = (0.6, 0.0, 0.8)
    found = slerp(column(around(axis, a)), sign * column(around(axis, b)), column(weight))[0]
    short = math.remainder(b - a, 2 * math.pi)
    if abs(abs(short) - math.pi) < 1e-9:
        return  # both ways are as short
    expected = np.array(around(axis, a + weight * short))
    assert min(np.abs(found - expected).max(), np.abs(found + expected).max()) < 1e-14


@settings(max_examples=examples(300), deadline=None)
@given(DIRECTIONS, DIRECTIONS, WEIGHTS)
def test_a_rotation_between_two_has_length_1_and_its_share_of_the_angle(
    a: list[float], b: list[float], weight: float
) -> None:
    first, second = np.array(a) / np.linalg.norm(a), np.array(b) / np.linalg.norm(b)
    found = slerp(column(a), column(b), column(weight))[0]
    if weight in (0, 1):
        assert found.tolist() == (a, b)[int(weight)]
        return
    assert abs(np.linalg.norm(found) - 1) < 1e-15

    def apart(one: np.ndarray, other: np.ndarray) -> float:
        return 2 * math.atan2(
            *sorted((float(np.linalg.norm(one - other)), float(np.linalg.norm(one + other))))
        )  # of the two signs, the nearer

    assert apart(first, found) == pytest.approx(weight * apart(first, second), abs=1e-14)
    assert apart(found, second) == pytest.approx((1 - weight) * apart(first, second), abs=1e-14)


def test_the_order_of_the_elements_does_not_matter() -> None:
    a, b = np.random.default_rng(3).normal(size=(2, 100, 4))
    weight = np.linspace(0, 1, 100)
    back = [3, 0, 1, 2]
    assert np.allclose(slerp(a[:, back], b[:, back], weight), slerp(a, b, weight)[:, back], rtol=0, atol=1e-15)


def test_of_tiny_and_huge_quaternions_only_the_direction_counts() -> None:
    a, b = np.array([[0.0, 0, 0, 1]]), np.array([[0.0, 0, 1, 1]])
    expected = slerp(a, b, column(0.3))
    assert np.allclose(slerp(a * 1e-300, b * 1e300, column(0.3)), expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("bad", [[0.0, 0, 0, 0], [math.nan, 0, 0, 1], [math.inf, 0, 0, 1]])
def test_what_has_no_direction_leads_nowhere(bad: list[float]) -> None:
    good = [0.0, 0, 0, 2]
    assert np.isnan(slerp(column(bad), column(good), column(0.5))).all()
    assert np.isnan(slerp(column(good), column(bad), column(0.5))).all()
    assert slerp(column(good), column(bad), column(0.0)).tolist() == [good]
