"""Times are read as people write them, and written so that they can be read."""

from __future__ import annotations

import argparse

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ml_dash_mcap.cli import times

NOON = 1_700_049_600.0
"""2023-11-15T12:00:00Z."""


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("12.5", 12.5),
        ("0", 0.0),
        ("1e3", 1000.0),
        ("1700049600.000000123", 1700049600.000000123),
        ("2023-11-15T12:00:00Z", NOON),
        ("2023-11-15t12:00:00z".replace("t", "T"), NOON),
        ("2023-11-15 12:00", NOON),
        ("2023-11-15T13:00:00+01:00", NOON),
        ("2023-11-15T12:00:00.5Z", NOON + 0.5),
        ("2023-11-15T12:00:00.123456789Z", NOON + 0.123456),
        ("2023-11-15", NOON - 12 * 3600),
    ],
)
def test_a_time_is_seconds_or_iso_8601(text: str, seconds: float) -> None:
    assert times.parse(text) == pytest.approx(seconds, abs=1e-9)


@pytest.mark.parametrize("text", ["", "noon", "2023-13-01", "12:00", "2023-11-15T25:00"])
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="neither a number of seconds nor a time in ISO 8601"):
        times.parse(text)


@given(st.floats(1e8, 2.5e11))
def test_a_wall_clock_time_that_is_shown_can_be_given_back(seconds: float) -> None:
    assert times.parse(times.show(seconds)) == pytest.approx(seconds, abs=0.001)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (None, "-"),
        (0.0, "0.000 s"),
        (12.3456, "12.346 s"),
        (NOON, "2023-11-15T12:00:00.000Z"),
        (1e18, "1000000000000000000.000 s"),
    ],
)
def test_a_time_is_shown_so(seconds: float | None, text: str) -> None:
    assert times.show(seconds) == text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.0, "0.000 s"), (59.9, "59.900 s"), (60.0, "1 min 00.0 s"), (3599.0, "59 min 59.0 s"), (7380.0, "2 h 03 min")],
)
def test_a_duration_is_shown_so(seconds: float, text: str) -> None:
    assert times.show_duration(seconds) == text


@pytest.mark.parametrize(
    ("count", "text"),
    [(0, "0 B"), (999, "999 B"), (1000, "1.0 kB"), (1_234_567, "1.2 MB"), (5 * 10**15, "5000.0 TB")],
)
def test_a_size_is_shown_so(count: int, text: str) -> None:
    assert times.show_size(count) == text
