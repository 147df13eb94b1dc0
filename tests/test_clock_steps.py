"""Time that steps back on a topic is counted, in the recorder and in the file, with the rows that merge because of it."""

from __future__ import annotations

import contextlib
import errno
import itertools
import json
import os
import signal
import subprocess
import sys
import tempfile
import textwrap
import time
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from ml_dash_mcap import Experiment, Recorder, RecorderOptions, Recording
from ml_dash_mcap.capture import writer
from ml_dash_mcap.inspect.findings import Report
from tests.faulty_os import calls_go_through, fails
from tests.support import disk
from tests.support.examples import examples

SMALL = RecorderOptions(chunk_bytes=65_536, backlog_bytes=262_144)


def recorded_steps(folder: Path, topic: str = "robot") -> dict[str, int]:
    """What the metadata records of a recording add up to, read by the mcap package; each block counts once."""
    blocks = {}
    for path in disk.segments(folder):
        with disk._open(path) as reader:
            records = [(record.name, record.metadata) for record in reader.iter_metadata()]
        run = next(values["run"] for name, values in records if name == "ml_dash")
        for name, values in records:
            if name == "ml_dash.steps_back":
                blocks[run, values["block"]] = json.loads(values["topics"]).get(topic, {})
    names = ("steps_back", "merged", "overwritten")
    return {name: sum(values.get(name, 0) for values in blocks.values()) for name in names}


def messages_in(folder: Path) -> int:
    """How many messages the files hold, by their statistics."""
    count = 0
    for path in disk.segments(folder):
        with path.open("rb") as stream:
            summary = make_reader(stream).get_summary()
        assert summary is not None and summary.statistics is not None
        count += summary.statistics.message_count
    return count


def check(folder: Path) -> Report:
    with Recording(folder) as rec:
        return rec.check()


def merged_said(report: Report) -> int:
    return sum(one.rows for one in report if one.kind == "clock")


def steps_of(times: list[float]) -> int:
    return sum(after < before - 0.05 for before, after in pairwise(times))


def test_three_episodes_from_zero_in_one_buffer_are_told_with_the_rows_that_merged(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        for episode in range(3):
            for i in range(100):
                recorder.topic("robot").append(q=[float(episode)], _ts=i / 100)
                recorder.topic("fine").append(n=i, _ts=episode + i / 100)
        recorder.flush()
        stats = recorder.stats()
    assert (stats["written"], stats["merged"], stats["steps_back"]) == (600, 200, 2)
    assert stats["steps_back_by_topic"] == {"robot": 2}
    with Recording(tmp_path) as rec:
        assert rec["robot"].info.count == 100
    (finding,) = report = check(tmp_path)
    assert not report
    assert (finding.topic, finding.kind, finding.severity, finding.rows) == ("robot", "clock", "error", 200)
    assert finding.what == (
        "time steps back 2 times, by 0.99 s at most, and 200 rows are merged with rows of the same time from before"
    )


def test_columns_are_counted_as_rows_are(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        for episode in range(3):
            recorder.topic("robot").append_columns(_ts=[i / 100 for i in range(100)], q=[float(episode)] * 100)
        recorder.flush()
        assert recorder.stats()["steps_back"] == 2
    assert merged_said(check(tmp_path)) == 200


def test_fields_that_come_late_are_no_step_of_the_clock(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        for i in range(100):
            recorder.topic("robot").append(q=i, _ts=i / 10)
            if i >= 3:
                recorder.topic("robot").append(detected=i - 3, _ts=(i - 3) / 10)
    report = check(tmp_path)
    assert report
    assert [(one.kind, one.severity, one.rows) for one in report] == [("late", "note", 97)]
    with Recording(tmp_path) as rec:
        assert rec["robot"].info.count == 100


def test_threads_that_are_held_up_for_a_moment_step_nothing_back(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        for i in range(100):
            recorder.topic("robot").append(q=i, _ts=1.0 + i / 100 - (0.04 if i % 2 else 0.0))
        recorder.flush()
        assert recorder.stats()["steps_back"] == 0
    assert recorded_steps(tmp_path)["steps_back"] == 0


@settings(max_examples=examples(60), deadline=None)
@given(
    times=st.lists(st.integers(0, 30).map(lambda tenth: tenth / 10), max_size=60),
    flushes=st.sets(st.integers(0, 59), max_size=4),
)
def test_as_many_steps_are_counted_as_the_times_have(times: list[float], flushes: set[int]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        with Recorder(folder, SMALL) as recorder:
            for number, at in enumerate(times):
                recorder.topic("robot").append(n=number, _ts=at)
                if number in flushes:
                    recorder.flush()
            recorder.flush()
            stats = recorder.stats()
        assert stats["steps_back"] == recorded_steps(Path(folder))["steps_back"] == steps_of(times)
        assert stats["written"] - stats["merged"] == messages_in(Path(folder))


PASSES = st.lists(st.tuples(st.integers(0, 20), st.integers(5, 25)), min_size=1, max_size=5)


@settings(max_examples=examples(80), deadline=None)
@given(passes=PASSES, flushes=st.sets(st.integers(0, 100), max_size=5), restarts=st.booleans())
def test_the_rows_that_are_told_as_merged_are_those_that_are_gone(
    passes: list[tuple[int, int]], flushes: set[int], restarts: bool
) -> None:
    """Each pass over the times is of even steps and begins well before the last one ended, or where it ended."""
    appended: list[int] = []
    begins = [0]
    for first, length in passes:
        start = first if not appended or first <= appended[-1] - 5 else appended[-1] + 1
        begins.append(len(appended))
        appended += range(start, start + length)
    with tempfile.TemporaryDirectory() as folder:
        recorder = Recorder(folder, SMALL)
        for number, tick in enumerate(appended):
            if restarts and number and number == begins[len(begins) // 2]:
                recorder.close()
                recorder = Recorder(folder, SMALL)
            recorder.topic("robot").append(n=number, _ts=tick / 10)
            if number in flushes:
                recorder.flush()
        recorder.close()
        with Recording(folder) as rec:
            left, report = rec["robot"].info.count, rec.check()
    assert left == len(set(appended))
    assert merged_said(report) == len(appended) - left
    assert bool(report) or any(one.kind in ("clock", "gap") for one in report)


KILLED = """
    import sys, time
    from ml_dash_mcap import Recorder, RecorderOptions
    folder, flush_at, count = sys.argv[1], eval(sys.argv[2]), int(sys.argv[3])
    recorder = Recorder(folder, RecorderOptions(chunk_bytes=65536, backlog_bytes=1 << 20, flush_interval_s=60.0,
                                                sync_interval_s=0, segment_bytes=65536))
    for n in range(count):
        recorder.topic("robot").append(n=n, pad="x" * 20, _ts=(n % 70) / 100)
        recorder.topic("setting").append(n=n, _ts=float(n))
        if n in flush_at:
            recorder.flush()
    print("done", flush=True)
    time.sleep(60)
"""


@pytest.mark.parametrize("flush_at", [[], [10], [69], [70], [105], [35, 139], [34, 69, 104, 139, 174], [209]])
def test_the_count_survives_a_kill(tmp_path: Path, flush_at: list[int]) -> None:
    kill(tmp_path, flush_at, 210)
    times = [(n % 70) / 100 for n in range(210)]
    report = check(tmp_path)  # which recovers first
    assert recorded_steps(tmp_path)["steps_back"] == steps_of(times) == 2
    assert merged_said(report) == 140
    assert "2 times" in next(one for one in report if one.kind == "clock").what


def test_the_count_survives_a_kill_at_any_moment(tmp_path: Path) -> None:
    for attempt, delay in enumerate((0.0, 0.02, 0.05, 0.1, 0.2, 0.3)):
        folder = tmp_path / str(attempt)
        kill(folder, [], 10_000_000, after_s=delay)
        with Recording(folder) as rec:
            last = max(row["n"] for row in rec["robot"].rows())
            report = rec.check()
        assert recorded_steps(folder)["steps_back"] == steps_of([(n % 70) / 100 for n in range(last + 1)])
        assert merged_said(report) == last + 1 - min(70, last + 1)


def kill(folder: Path, flush_at: list[int], count: int, after_s: float | None = None) -> None:
    arguments = [sys.executable, "-c", textwrap.dedent(KILLED), str(folder), repr(flush_at), str(count)]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        if after_s is None:
            assert child.stdout.readline() == "done\n"
        else:
            while not list(folder.glob("*.mcap*")):
                time.sleep(0.01)
            time.sleep(after_s)
        os.kill(child.pid, signal.SIGKILL)


def test_a_block_that_is_told_twice_counts_once(tmp_path: Path) -> None:
    """As after a crash that took a block's chunks, but not the record before them, and a recovery that wrote it again."""
    with Recorder(tmp_path) as recorder:
        for n in range(200):
            recorder.topic("robot").append(n=n, _ts=(n % 100) / 100)
        recorder.flush()
        (values,) = [
            {
                "block": "0",
                "topics": '{"robot": {"steps_back": 1, "by_ns": 990000000, "merged": 100, "overwritten": 100}}',
            }
        ]
        recorder.write_metadata("ml_dash.steps_back", values)
    assert merged_said(check(tmp_path)) == 100


@pytest.mark.parametrize(
    "text", ["", "5", "[]", "{", '{"robot": 5}', '{"robot": {"overwritten": -5, "steps_back": "x"}}']
)
def test_a_record_that_makes_no_sense_is_no_finding(tmp_path: Path, text: str) -> None:
    with Recorder(tmp_path) as recorder:
        recorder.topic("robot").append(n=1, _ts=1.0)
        recorder.write_metadata("ml_dash.steps_back", {"block": "9", "topics": text})
    assert list(check(tmp_path)) == []


def test_runs_that_begin_again_are_told_with_the_rows_that_merge(tmp_path: Path) -> None:
    for run in range(3):
        with Experiment("a/b", root=tmp_path).run as exp:
            for i in range(100):
                exp.tracks("robot").append(q=float(run), _ts=i / 100)
    report = check(tmp_path / "a/b")
    assert not report
    (finding,) = report
    assert (finding.kind, finding.severity, finding.rows) == ("clock", "error", 200)


def test_small_options_change_no_count(tmp_path: Path) -> None:
    times = [(n % 50) / 100 for n in range(1000)]
    with Recorder(tmp_path, RecorderOptions(batch_rows=7)) as recorder:
        for n, at in enumerate(times):
            recorder.topic("robot").append(n=n, _ts=at)
        recorder.flush()
        assert recorder.stats()["steps_back"] == steps_of(times)
    assert merged_said(check(tmp_path)) == 950


@pytest.mark.skipif(sys.platform != "linux", reason="calls are told apart through /proc")
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO], ids=["no space", "input/output error"])
def test_a_block_that_is_written_again_after_a_fault_counts_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    monkeypatch.setattr(writer, "_FIRST_RETRY_S", 0.005)
    times = [(n % 50) / 100 for n in range(200)]
    for number in itertools.count(1):
        folder = tmp_path / str(number)
        folder.mkdir()
        plan = fails(lambda current, name, number=number: current == number, code, halfway=True)  # type: ignore[misc]
        with calls_go_through(folder, plan) as calls:
            try:
                recorder = Recorder(folder, SMALL)
            except OSError:  # it could not begin
                continue
            for n, at in enumerate(times):
                recorder.topic("robot").append(n=n, _ts=at)
                if n % 70 == 69:
                    with contextlib.suppress(OSError):  # it says so, and goes on trying
                        recorder.flush()
            recorder.flush()
            assert recorder.stats()["steps_back"] == 3
            recorder.close()
        assert recorded_steps(folder)["steps_back"] == 3
        assert merged_said(check(folder)) == 150
        if calls.count < number:
            assert number > 10
            return
