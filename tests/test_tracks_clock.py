"""What is logged lies where the robot was when it was logged, whatever clock the tracks run on."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ml_dash_mcap import Experiment, Recorder, Recording
from ml_dash_mcap.capture.tracks_clock import NOW_S, TracksClock
from ml_dash_mcap.codecs import json_merge as merge
from tests.support import disk
from tests.support.examples import examples

GPS_EPOCH_S = 315_964_800.0
LEAP_SECONDS = 18.0


def spans_s(folder: Path) -> list[float]:
    """How long each file is, from its first message to its last on any topic, by the mcap package."""
    spans = []
    for path in disk.segments(folder):
        with disk._open(path) as reader:
            times = [message.log_time for _, _, message in reader.iter_messages()]
        spans.append((max(times) - min(times)) / 1e9 if times else 0.0)
    return spans


CLOCKS = {
    "near 0": lambda now: 0.0,
    "since boot": lambda now: 123_456.0,
    "since 2000": lambda now: now - 946_684_800.0,
    "of 2015, played back": lambda now: 1_420_070_400.0,
    "of yesterday": lambda now: now - 86_400.0,
    "an hour ago": lambda now: now - 3600.0,
    "a minute ago": lambda now: now - 60.0,
    "GPS seconds since 1980": lambda now: now - GPS_EPOCH_S + LEAP_SECONDS,
    "GPS on Unix's epoch": lambda now: now + LEAP_SECONDS,
    "TAI": lambda now: now + 37.0,
    "of tomorrow": lambda now: now + 86_400.0,
}


@pytest.mark.parametrize("flushed", [False, True], ids=["in one block", "flushed"])
@pytest.mark.parametrize("begin", CLOCKS.values(), ids=CLOCKS.keys())
def test_events_lie_among_the_rows_on_every_clock(tmp_path: Path, begin: object, flushed: bool) -> None:
    start = begin(time.time())  # type: ignore[operator]
    with Experiment("a/b", root=tmp_path).run as exp:
        exp.log("before")
        exp.metrics("loss").log(value=0.0)
        exp.files("out").save_text("hello", to="a.txt")
        if flushed:
            exp.flush()
        for number in range(10):
            exp.tracks("robot").append(n=number, _ts=start + number / 10)
            exp.log(f"row {number}")
            exp.metrics("loss").log(value=1.0)
            if flushed and number == 5:
                exp.flush()
        with exp.episode():
            exp.tracks("robot").append(n=10, _ts=start + 1.0)
        exp.files("out").save_text("hello", to="b.txt")
        exp.log("after")
    assert max(spans_s(exp.path)) < 1.001
    rows = disk.rows(exp.path)["ml_dash/log"]
    assert [row["message"] for row in rows] == ["before", *(f"row {number}" for number in range(10)), "after"]
    at = {row["message"]: row["_ts"] for row in rows}
    assert {number: at[f"row {number}"] for number in range(10)} == {
        number: start + number / 10 for number in range(10)
    }
    assert at["after"] == start + 1.0
    if not flushed:
        assert at["before"] == start
    with Recording(exp.path) as rec:
        (episode,) = rec.episodes
        assert start + 0.9 <= episode.start <= episode.end == start + 1.0  # type: ignore[operator]


@pytest.mark.parametrize("lag", [0.0, 0.3, 2.0])
def test_a_clock_of_now_is_left_alone(tmp_path: Path, lag: float) -> None:
    with Experiment("a/b", root=tmp_path).run as exp:
        before = time.time()
        exp.log("before")
        exp.tracks("robot").append(n=0, _ts=time.time() - lag)
        time.sleep(0.05)
        exp.log("later")
        after = time.time()
    (first, second) = disk.rows(exp.path)["ml_dash/log"]
    assert before <= first["_ts"] < second["_ts"] <= after
    assert second["_ts"] - first["_ts"] >= 0.05
    assert len(disk.segments(exp.path)) == 1


def test_a_time_that_the_caller_gave_an_event_stays(tmp_path: Path) -> None:
    now = time.time()
    with Experiment("a/b", root=tmp_path).run as exp:
        exp.metrics("loss").log(value=1.0, _ts=now)
        exp.metrics("loss").log(value=2.0)
        exp.tracks("robot").append(n=0, _ts=now - 86_400.0)
    assert [row["_ts"] for row in disk.rows(exp.path)["ml_dash/metrics/loss"]] == [now - 86_400.0, now]


@pytest.mark.parametrize("message", ["a \ud800 surrogate", "\\", '"_ts":5}', "\0", "x" * 100_000, "é\U0001f600"])
def test_whatever_an_event_says_moves_with_it(tmp_path: Path, message: str) -> None:
    fields = {"_t": 1.0, "big": 2**64 - 1, "nan": float("nan"), "bytes": b"\xff", "deep": [[{"_ts": [1.5]}]]}
    rows = []
    for ts in (time.time(), time.time() - 86_400.0):
        with Experiment(f"a/{ts}", root=tmp_path).run as exp:
            try:
                exp.log(message, **fields)
            except (TypeError, ValueError):  # refused when it was logged
                exp.log("refused")
            exp.metrics("loss").log(**fields)
            exp.tracks("robot").append(n=0, _ts=ts)
        with Recording(exp.path) as rec:
            (row,), (point,) = rec.logs, rec.metrics["loss"]
        assert abs(row.pop("_ts") - ts) < NOW_S
        assert abs(point.pop("_ts") - ts) < NOW_S
        del row["timestamp"], row["name"]
        rows.append((repr(row), repr(point)))
    assert rows[0] == rows[1]


def test_an_event_that_cannot_be_moved_costs_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(payload: bytes, seconds: float) -> bytes:
        if b"second" in payload:
            raise RecursionError("too deep")
        return real(payload, seconds)

    real = merge.with_time
    monkeypatch.setattr(merge, "with_time", fail)
    began = time.time()
    with caplog.at_level(logging.WARNING), Experiment("a/b", root=tmp_path).run as exp:
        exp.log("first")
        exp.log("second")
        exp.tracks("robot").append(n=0, _ts=5.0).flush()
        assert exp.stats()["fallbacks"] == {"moving an event to the tracks' clock": 1}
    assert exp.run.status == "completed"
    at = {row["message"]: row["_ts"] for row in disk.rows(exp.path)["ml_dash/log"]}
    assert at["first"] == 5.0
    assert at["second"] >= began
    assert disk.rows(exp.path)["robot"] == [{"n": 0, "_ts": 5.0}]
    assert "keeps its wall-clock time" in caplog.text


def test_events_of_a_killed_recorder_follow_its_clock_too(tmp_path: Path) -> None:
    program = """
        import os, sys, time
        from ml_dash_mcap import Experiment, RecorderOptions
        exp = Experiment("a/b", root=sys.argv[1], options=RecorderOptions(flush_interval_s=60.0, sync_interval_s=0))
        exp.run.start()
        exp.log("before")
        exp.metrics("loss").log(value=1.0, _ts=7.0)
        start = time.time() - 86_400.0
        for number in range(10):
            exp.tracks("robot").append(n=number, _ts=start + number / 10)
            exp.log("among")
        print(start, flush=True)
        time.sleep(60)
    """
    child = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(program), str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    start = float(child.stdout.readline())
    os.kill(child.pid, signal.SIGKILL)
    child.wait()
    child.stdout.close()
    with Recording(tmp_path / "a/b") as rec:
        assert [row["_ts"] for row in rec.logs] == [start, *(start + number / 10 for number in range(10))]
        assert [row["_ts"] for row in rec.metrics["loss"]] == [7.0]
        assert rec["robot"].info.count == 10


def test_the_recorders_time_is_that_of_its_tracks(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        assert abs(recorder.time() - time.time()) < 1.0
        recorder.topic("robot").append(n=0, _ts=1.7e9)
        assert recorder.time() == 1.7e9
        recorder.topic("robot").append(n=0, _ts=4.5)
        assert recorder.time() == 4.5


# The clock by itself


class Wall:
    """A wall clock that is moved by hand."""

    def __init__(self, now_s: float = 1.8e9) -> None:
        self.now_s = now_s

    def __call__(self) -> float:
        return self.now_s


def test_a_robot_may_stand_still_for_hours() -> None:
    wall = Wall()
    clock = TracksClock(wall)
    wall.now_s += 1.0
    clock.look(1.8e9 + 0.9)
    wall.now_s += 7200.0
    assert clock.time(1.8e9 + 0.9) == (1.8e9 + 7201.0, True)


def test_rows_that_come_after_hours_without_a_look_are_of_now() -> None:
    wall = Wall()
    clock = TracksClock(wall)
    wall.now_s += 7200.0
    assert clock.time(1.8e9 + 3600.0) == (1.8e9 + 7200.0, True)


def test_a_wall_clock_that_is_set_is_the_wall_clock_yet() -> None:
    wall = Wall(1000.0)
    clock = TracksClock(wall)
    clock.look(1000.5)
    wall.now_s = 1.8e9
    assert clock.time(1.8e9 - 0.1) == (1.8e9, True)
    wall.now_s = 1.7e9
    assert clock.time(1.7e9 - 0.1) == (1.7e9, True)


def test_one_row_that_comes_late_changes_nothing() -> None:
    wall = Wall()
    clock = TracksClock(wall)
    clock.look(1.8e9)
    wall.now_s += 1.0
    clock.look(1.8e9 - 40.0)
    assert clock.time(1.8e9 - 40.0) == (1.8e9 + 1.0, True)
    wall.now_s += 20.0
    assert clock.time(1.8e9 - 41.0) == (1.8e9 - 41.0, False)


@settings(max_examples=examples(200), deadline=None)
@given(
    offset=st.one_of(st.floats(-1e9, -NOW_S - 1.5), st.floats(NOW_S + 0.5, 1e9)),
    steps=st.lists(st.tuples(st.floats(0.0, 1.0), st.booleans()), min_size=1, max_size=30),
)
def test_a_clock_that_runs_beside_the_wall_clock_is_told_at_every_look(
    offset: float, steps: list[tuple[float, bool]]
) -> None:
    wall = Wall()
    clock = TracksClock(wall)
    last: float | None = None
    for step, appends in steps:
        wall.now_s += step
        if appends or last is None:
            last = wall.now_s + offset
        assert clock.time(last) == (last, False)


@settings(max_examples=examples(200), deadline=None)
@given(
    lag=st.floats(0.0, NOW_S),
    steps=st.lists(st.tuples(st.floats(0.0, 1e5), st.booleans()), min_size=1, max_size=30),
)
def test_rows_of_now_are_told_however_seldom_they_come(lag: float, steps: list[tuple[float, bool]]) -> None:
    wall = Wall()
    clock = TracksClock(wall)
    last: float | None = None
    for step, appends in steps:
        wall.now_s += step
        if appends:
            last = wall.now_s - lag
        assert clock.time(last) == (wall.now_s, True)
