"""`Recording.align` reads what it needs and no more, and its values are those that the whole recording would give."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ml_dash_mcap import Recorder, RecorderOptions, Recording
from ml_dash_mcap.errors import AlignmentError, NotFoundError, RangeError, UsageError
from ml_dash_mcap.rows.align import align
from ml_dash_mcap.rows.align_methods import METHODS, Methods
from tests.support.examples import examples

SMALL = RecorderOptions(chunk_bytes=65536, backlog_bytes=262_144, sync_interval_s=0)


@pytest.fixture
def rec(tmp_path: Path) -> Iterator[Recording]:
    """A robot at 100 Hz from 0 to 10 s, a camera at 30 Hz from 1 to 8 s, and a setting that was made once."""
    with Recorder(tmp_path, SMALL) as recorder:
        recorder.topic("setting").append(gain=3, _ts=0.5)
        for i in range(1001):
            half = i / 200
            recorder.topic("robot").append(
                q=[i / 100, -i / 100], quat=[0, 0, math.sin(half), math.cos(half)], _ts=i / 100
            )
        for i in range(30, 241):
            recorder.topic("camera").append(frame=i, name=f"{i}.png", _ts=i / 30)
    with Recording(tmp_path) as recording:
        yield recording


def test_topics_come_onto_the_clock_of_one_of_them(rec: Recording) -> None:
    table = rec.align(["robot", "camera", "setting"], on="camera", how={"robot": "linear", "robot.quat": "slerp"})
    assert table.column_names == ["_ts", "robot.q", "robot.quat", "camera.frame", "camera.name", "setting.gain"]
    times = table.column("_ts").to_numpy()
    assert times.tolist() == [i / 30 for i in range(30, 241)]
    q = np.stack(table.column("robot.q").to_numpy())
    assert np.allclose(q, np.stack([times, -times], axis=1), rtol=0, atol=1e-14)
    quat = np.stack(table.column("robot.quat").to_numpy())
    assert np.allclose(quat[:, 2:], np.stack([np.sin(times / 2), np.cos(times / 2)], axis=1), rtol=0, atol=1e-14)
    assert table.column("camera.frame").to_pylist() == list(range(30, 241))
    assert set(table.column("setting.gain").to_pylist()) == {3}


def test_a_grid_lies_where_all_topics_have_rows(rec: Recording) -> None:
    table = rec.align(["robot", "camera"], hz=50, how="nearest")
    assert table.column("_ts").to_pylist() == [1.0 + i / 50 for i in range(351)]
    assert table.column("camera.frame").to_pylist()[:4] == [30, 31, 31, 32]
    assert table.column("robot.q").null_count == 0


def test_start_and_end_cut_the_clock_and_not_the_values(rec: Recording) -> None:
    table = rec.align(["robot", "setting"], on="robot", start=2.0, end=2.01)
    assert table.select(["_ts", "robot.q", "setting.gain"]).to_pylist() == [
        {"_ts": 2.0, "robot.q": [2.0, -2.0], "setting.gain": 3},
        {"_ts": 2.01, "robot.q": [2.01, -2.01], "setting.gain": 3},
    ]
    grid = rec.align(["camera"], hz=100, start=2.005, end=2.03, how="linear")
    assert grid.column("_ts").to_pylist() == [2.005, 2.005 + 1 / 100, 2.005 + 2 / 100]
    assert grid.column("camera.frame").to_pylist() == pytest.approx([60.15, 60.45, 60.75], abs=1e-9)


def test_start_and_end_set_where_a_grid_lies(rec: Recording) -> None:
    assert rec.align(["robot", "setting"], hz=100).column("_ts").to_pylist() == [0.5]  # the setting was made once
    table = rec.align(["robot", "setting"], hz=10, start=0.25, end=0.75)
    assert table.column("_ts").to_pylist() == [0.25 + i / 10 for i in range(6)]
    assert table.column("setting.gain").to_pylist() == [None, None, None, 3, 3, 3]
    assert rec.align(["robot"], hz=10, start=9.85).column("_ts").to_pylist() == [9.85, 9.85 + 1 / 10]
    assert rec.align(["robot"], hz=10, start=10.5).num_rows == 0
    assert rec.align([], hz=10).num_rows == 0


def test_the_topic_of_the_clock_need_not_be_in_the_table(rec: Recording) -> None:
    table = rec.align({"robot": ["q"]}, on="camera", end=1.05)
    assert table.column_names == ["_ts", "robot.q"]
    assert table.column("_ts").to_pylist() == [1.0, 31 / 30]


def test_columns_are_chosen_by_topic(rec: Recording) -> None:
    table = rec.align({"camera": ["frame"], "robot": None}, on="robot")
    assert table.column_names == ["_ts", "camera.frame", "robot.q", "robot.quat"]
    assert table.column("robot.q").equals(rec["robot"].to_arrow().column("q"))


def test_a_column_that_no_row_of_the_range_has_is_there_and_empty(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        for i in range(10):
            recorder.topic("a").append(x=i, **({"late": i} if i > 5 else {}), _ts=float(i))
    with Recording(tmp_path) as recording:
        for options in ({"on": "a"}, {"hz": 1.0}):
            table = recording.align({"a": ["late"]}, end=2.0, **options)  # type: ignore[arg-type]
            assert table.column("a.late").to_pylist() == [None] * 3
            assert recording.align({"a": ["late"]}, start=20.0, **options).column_names == ["_ts", "a.late"]  # type: ignore[arg-type]


def test_gaps_are_nulls(rec: Recording) -> None:
    table = rec.align(["camera"], on="robot", tolerance_s=0.1)
    times = table.column("_ts").to_numpy()
    missing = table.column("camera.frame").is_null().to_numpy()
    assert np.array_equal(missing, (times < 1.0) | (times > 8.1))


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"topics": ["robt"], "hz": 1}, NotFoundError, "no topic 'robt' .*did you mean 'robot'"),
        ({"topics": ["robot"], "on": "robt"}, NotFoundError, "no topic 'robt' .*did you mean 'robot'"),
        ({"topics": {"robot": ["p"]}, "on": "robot"}, NotFoundError, "no column 'p'"),
        ({"topics": ["robot"], "on": "robot", "how": {"robot.p": "linear"}}, NotFoundError, r"no column 'robot\.p'"),
        ({"topics": ["robot"]}, UsageError, "got neither"),
        ({"topics": ["robot"], "on": "robot", "hz": 1}, UsageError, "got both"),
        ({"topics": "robot", "hz": 1}, UsageError, "pass a list of topics"),
        ({"topics": {"robot": "q"}, "hz": 1}, UsageError, r"columns=\['q'\]"),
        ({"topics": ["robot"], "hz": 0}, AlignmentError, "hz=0"),
        ({"topics": ["robot"], "hz": "fast"}, AlignmentError, "hz='fast' is not a number"),
        ({"topics": ["robot"], "hz": 1, "how": "cubic"}, AlignmentError, "cubic"),
        ({"topics": ["robot"], "hz": 1, "tolerance_s": -1}, AlignmentError, "tolerance_s=-1"),
        ({"topics": ["robot"], "hz": 1, "tolerance_s": math.nan}, AlignmentError, "tolerance_s=nan"),
        ({"topics": ["robot"], "hz": 1, "start": 2, "end": 1}, RangeError, "lies after"),
        (
            {"topics": ["robot"], "on": "robot", "how": "slerp"},
            AlignmentError,
            r"'robot\.q' .* 'slerp' is for 4-vectors",
        ),
        ({"topics": ["camera"], "on": "robot", "how": {"camera.name": "linear"}}, AlignmentError, r"'camera\.name'"),
    ],
)
def test_a_call_that_makes_no_sense_says_why(
    rec: Recording, arguments: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        rec.align(**arguments)


def test_a_window_reads_the_window_and_the_row_before_it(rec: Recording) -> None:
    robot, before = rec["robot"], bytes_read(rec)
    robot.to_arrow(5.0, 5.1)
    of_window, before = bytes_read(rec) - before, bytes_read(rec)
    rec.align({"robot": None, "setting": None}, hz=100, start=0.0, end=0.5)
    before = bytes_read(rec)
    rec.align(["robot", "setting"], on="robot", start=5.0, end=5.1)
    assert bytes_read(rec) - before < 4 * of_window


def bytes_read(recording: Recording) -> int:
    return sum(file.source.bytes_read for file in recording._opened())


TIMES = st.one_of(
    st.sampled_from([0.5, math.nextafter(0.5, 1), 1 / 3, 2 / 3]), st.integers(0, 40).map(lambda i: i / 10)
)
ROWS = st.lists(st.tuples(TIMES, st.sampled_from(["x", "y"]), st.integers(0, 9), st.booleans()), max_size=14)


@settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(ROWS, ROWS, st.tuples(TIMES, TIMES).map(sorted), st.sampled_from(METHODS[:3]), st.sampled_from([None, 0.3, 1.0]))
def test_a_window_has_the_values_of_the_whole(
    first: list[tuple[float, str, int, bool]],
    second: list[tuple[float, str, int, bool]],
    window: list[float],
    how: str,
    tolerance_s: float | None,
) -> None:
    start, end = window
    with tempfile.TemporaryDirectory() as name:
        with Recorder(name, SMALL) as recorder:
            for topic, rows in (("a", first), ("b", second)):
                for time, field, value, flushes in rows:
                    recorder.topic(topic).append(**{field: value}, _ts=time)
                    if flushes:
                        recorder.flush()
        with Recording(name) as recording:
            topics = [topic for topic in ("a", "b") if topic in recording]
            if not topics:
                return
            tables = {topic: recording[topic].to_arrow() for topic in topics}
            tables[topics[0]] = recording[topics[0]].to_arrow(start, end)
            times = tables[topics[0]].column("_ts").to_numpy()
            tolerance = math.inf if tolerance_s is None else tolerance_s
            whole = align(times, tables, Methods(how), tolerance_s=tolerance, own=topics[0])
            found = recording.align(topics, on=topics[0], start=start, end=end, how=how, tolerance_s=tolerance_s)
            for column in whole.column_names:
                values = whole.column(column).to_pylist()
                assert values == (
                    found.column(column).to_pylist() if column in found.column_names else [None] * len(times)
                )
