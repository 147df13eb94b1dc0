"""A check tells what is wrong with a recording, once, where it is, and nothing that is not."""

from __future__ import annotations

import math
import subprocess
import sys
import textwrap
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import Message

from ml_dash_mcap import Experiment, Recorder, RecorderOptions, Recording
from ml_dash_mcap.errors import NotFoundError, RangeError, UsageError
from ml_dash_mcap.inspect import gaps, time_steps_back
from ml_dash_mcap.inspect import row_spacing as spacings
from ml_dash_mcap.inspect.findings import Finding, Report
from ml_dash_mcap.inspect.gaps import Gap
from tests.support.assemble import bundle
from tests.support.examples import examples
from tests.support.files import draft, finished, message, save, unfinished

EPOCH = 1_700_000_000.0
SMALL_SEGMENTS = {"chunk_bytes": 65536, "backlog_bytes": 262_144, "segment_bytes": 65536, "compression": "none"}


def record(folder: Path, times: Iterable[float], **options: Any) -> Path:
    """Append a row at each time, in that order."""
    with Recorder(folder, RecorderOptions(**options)) as recorder:
        for number, time in enumerate(times):
            recorder.topic("robot").append(n=number, _ts=float(time))
    return folder


def check(path: Path, topics: list[str] | None = None) -> Report:
    with Recording(path) as rec:
        return rec.check(topics)


# Gaps


def test_a_gap_is_where_rows_are_too_far_apart(tmp_path: Path) -> None:
    record(tmp_path, [0.0, 0.5, 1.0, 3.0, 3.5, 4.0, 5.0, 5.5])
    with Recording(tmp_path) as rec:
        assert rec.gaps("robot") == [Gap(1.0, 3.0, 3), Gap(4.0, 5.0, 1)]
        assert rec.gaps("robot", longer_than_s=1.0) == [Gap(1.0, 3.0, 3)]
        assert rec.gaps("robot", longer_than_s=0.25)[0] == Gap(0.0, 0.5, 0)
        assert rec.gaps("robot")[0].duration == 2.0


def test_a_topic_without_two_spacings_has_no_gap(tmp_path: Path) -> None:
    for count in range(3):
        record(tmp_path / str(count), range(count + 1))
        with Recording(tmp_path / str(count)) as rec:
            assert rec.gaps("robot") == []


def test_rows_of_one_time_and_late_ones_make_no_gap(tmp_path: Path) -> None:
    record(tmp_path, [0.0, 1.0, 1.0, 3.0, 2.0, 4.0, 4.0, 5.0])
    with Recording(tmp_path) as rec:
        assert rec.gaps("robot") == []


def test_a_gap_needs_a_topic_and_a_time_above_0(tmp_path: Path) -> None:
    record(tmp_path, range(3))
    with Recording(tmp_path) as rec:
        with pytest.raises(NotFoundError, match="did you mean 'robot'"):
            rec.gaps("robt")
        for bad in (0, -1.0, math.nan, "long"):
            with pytest.raises(RangeError, match="longer_than_s="):
                rec.gaps("robot", bad)  # type: ignore[arg-type]


@settings(max_examples=examples(100), deadline=None)
@given(st.lists(st.integers(0, 400), min_size=3, unique=True).map(sorted), st.one_of(st.none(), st.integers(1, 50)))
def test_gaps_are_the_spacings_above_the_limit(times: list[int], longer_than: int | None) -> None:
    spacings = [b - a for a, b in pairwise(times)]
    median = (
        sorted(spacings)[len(spacings) // 2]
        if len(spacings) % 2
        else sum(sorted(spacings)[len(spacings) // 2 - 1 :][:2]) / 2
    )
    limit = 1.5 * median if longer_than is None else longer_than
    expected = [Gap(a / 1e9, b / 1e9, max(round((b - a) / median) - 1, 0)) for a, b in pairwise(times) if b - a > limit]
    assert gaps.among(np.array(times, np.uint64), longer_than) == expected


# Nothing wrong


@pytest.mark.parametrize("start", [0.0, EPOCH])
def test_a_good_recording_is_fine(tmp_path: Path, start: float) -> None:
    rng = np.random.default_rng(1)
    with Recorder(tmp_path, RecorderOptions(chunk_bytes=65536, backlog_bytes=262_144, segment_bytes=65536)) as recorder:
        recorder.topic("setting").append(gain=1, _ts=start)
        for i in range(3000):
            recorder.topic("robot").append(q=[0.1] * 7, _ts=start + i / 100)
            recorder.topic("robot").append(v=[0.1] * 7, _ts=start + i / 100)
            recorder.topic("jittery").append(x=i, _ts=start + (i + 0.1 * rng.random()) / 100)
    with Recording(tmp_path) as rec:
        assert len(rec.segments) > 2
        report = rec.check()
    assert list(report) == []
    assert report
    assert str(report) == "nothing found in 3 topics"


def test_a_recording_that_goes_on_another_day_is_fine(tmp_path: Path) -> None:
    for day in range(3):
        record(tmp_path, EPOCH + day * 86_400 + np.arange(100) / 10)
    assert list(check(tmp_path)) == []


def test_an_empty_recording_is_fine(tmp_path: Path) -> None:
    with Recorder(tmp_path):
        assert list(check(tmp_path)) == []
    assert list(check(tmp_path)) == []


def test_a_recording_in_progress_is_fine(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        for i in range(100):
            recorder.topic("robot").append(n=i, _ts=i / 10)
        recorder.flush()
        assert list(check(tmp_path)) == []


def test_the_log_before_the_first_row_is_no_other_clock(tmp_path: Path) -> None:
    with Experiment("a/b", root=tmp_path).run as exp:
        exp.log("starting")
        exp.flush()
        for i in range(10):
            exp.tracks("robot").append(q=i, _ts=i / 10)
    assert list(check(exp.path)) == []


# Each kind of finding


def test_a_gap_is_told_with_what_is_missing(tmp_path: Path) -> None:
    record(tmp_path, [i / 10 for i in range(100) if not 50 <= i < 55 and i != 80])
    report = check(tmp_path)
    (found,) = report
    assert not report
    assert (found.topic, found.kind, found.severity, found.time) == ("robot", "gap", "warning", 4.9)
    assert (found.count, found.rows) == (2, 6)
    assert [(one.time, one.rows) for one in found.occurrences] == [(4.9, 5), (7.9, 1)]
    assert [str(one) for one in found.occurrences] == [
        "at 4.9 s: no row for 0.6 s, in which there are 5 as a rule",
        "at 7.9 s: no row for 0.2 s, in which there are 1 as a rule",
    ]
    assert found.what == f"2 gaps, in which there are 6 rows as a rule; the longest {found.occurrences[0]}"
    assert str(found) == found.what


def test_regular_rows_of_which_many_are_missing_are_gaps_and_not_jitter(tmp_path: Path) -> None:
    record(tmp_path, [i / 10 for i in range(200) if i % 10])
    assert {one.kind for one in check(tmp_path)} == {"gap"}


def test_spacings_that_vary_are_measured_and_nothing_to_act_on(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    times = (np.arange(1000) + 0.45 * rng.random(1000)) / 100
    report = check(record(tmp_path, times))
    assert list(report) == []
    (measured,) = report.spacings
    widths = np.diff(times)
    low, middle, high = np.quantile(widths, (0.05, 0.5, 0.95))
    assert (measured.topic, measured.count, measured.is_even) == ("robot", 999, False)
    assert measured.usual == pytest.approx(middle, abs=1e-9)
    assert (measured.low, measured.high) == (pytest.approx(low, abs=1e-9), pytest.approx(high, abs=1e-9))
    assert (measured.longest, measured.longest_at) == (
        pytest.approx(widths.max(), abs=2e-9),
        pytest.approx(times[widths.argmax()], abs=1e-9),
    )
    assert measured.long == int((widths > 1.5 * middle).sum())


def test_a_hole_in_an_irregular_topic_is_a_gap_if_it_is_clearly_longer_than_the_rest(tmp_path: Path) -> None:
    times = np.cumsum(np.random.default_rng(3).exponential(size=1000))
    record(tmp_path, [time + (1000.0 if i >= 500 else 0.0) for i, time in enumerate(times)])
    worst = [one for one in check(tmp_path) if one.kind in ("gap", "clock")]
    assert any(math.isclose(place.time or 0, times[499], abs_tol=1e3) for one in worst for place in one.occurrences)


def test_rows_that_were_written_late_are_told_stretch_by_stretch(tmp_path: Path) -> None:
    times = [i / 10 for i in range(100)]
    late = [*times[:50], *times[60:70], *times[50:60], *times[70:90], times[91], times[90], *times[92:]]
    report = check(record(tmp_path, late))
    (found,) = report
    assert report  # reading sorts them
    assert (found.topic, found.kind, found.severity, found.count, found.rows) == ("robot", "late", "note", 2, 11)
    assert [str(one) for one in found.occurrences] == [
        "at 5 s: 10 rows written after one of 1.9 s later",
        "at 9 s: 1 row written after one of 0.1 s later",
    ]
    assert found.what == (f"11 rows at 2 places written after one of a later time; the latest {found.occurrences[0]}")


@pytest.mark.parametrize("flushes", [False, True])
def test_a_clock_that_is_set_back_is_told(tmp_path: Path, flushes: bool) -> None:
    options = {"batch_rows": 7} if flushes else {}
    report = check(record(tmp_path, [EPOCH + i / 10 - (2.05 if i >= 50 else 0.0) for i in range(100)], **options))
    (found,) = (one for one in report if one.kind == "clock")
    assert found.time == pytest.approx(EPOCH + 5.0 - 2.05)
    assert found.what == "the clock steps back by 1.95 s, after 1700000004.9 s"
    assert [one.kind for one in report] == ["clock"]


def test_a_simulation_that_begins_again_and_again_is_told_each_time(tmp_path: Path) -> None:
    report = check(record(tmp_path, [i / 10 + 0.001 * count for count in (100, 80, 90) for i in range(count)]))
    (found,) = (one for one in report if one.kind == "clock")
    assert (found.severity, found.count, found.rows) == ("warning", 2, 0)
    assert [(one.time, one.what) for one in found.occurrences] == [
        (0.08, "the clock steps back by 9.92 s, after 10 s"),
        (0.09, "the clock steps back by 7.89 s, after 7.98 s"),
    ]


def test_a_simulation_that_begins_again_in_the_next_run_is_told(tmp_path: Path) -> None:
    for _ in range(2):
        record(tmp_path, [i / 10 for i in range(100)])
    (found,) = check(tmp_path)
    assert found == Finding(
        "robot",
        "clock",
        0.0,
        "the times of the next recorder begin here, before the end of the last one at 9.9 s, and 100 rows are merged with"
        " rows of the same time there; Recording(path, run=...) reads one run",
    )
    assert (found.severity, found.rows) == ("error", 100)


def test_a_simulation_that_begins_again_in_the_next_run_at_other_times_is_told(tmp_path: Path) -> None:
    for offset in (0.0, 0.05):
        record(tmp_path, [i / 10 + offset for i in range(100)])
    (found,) = check(tmp_path)
    what = "the times of the next recorder begin here, before the end of the last one at 9.9 s"
    assert (found, found.severity) == (Finding("robot", "clock", 0.05, what), "warning")


def test_a_recording_that_is_played_back_into_another_is_told(tmp_path: Path) -> None:
    for _ in range(2):
        record(tmp_path, [EPOCH + i / 10 for i in range(100)])
    (found,) = check(tmp_path)
    assert (found.kind, found.severity, found.rows) == ("clock", "error", 100)


def test_two_recorders_at_one_time_are_fine(tmp_path: Path) -> None:
    with Recorder(tmp_path) as first, Recorder(tmp_path) as second:
        for i in range(100):
            (first if i % 2 else second).topic("robot").append(n=i, _ts=EPOCH + i / 10)
    assert list(check(tmp_path)) == []


def test_times_that_leap_on_are_told_once(tmp_path: Path) -> None:
    report = check(record(tmp_path, [i / 10 + (3600 if i >= 50 else 0) for i in range(100)]))
    assert list(report) == [
        Finding("robot", "clock", 3605.0, "times leap on by 3600.1 s, after 4.9 s: the clock was set, or nothing ran")
    ]


def test_wall_clock_times_among_times_near_0_are_told(tmp_path: Path) -> None:
    report = check(record(tmp_path, [time for i in range(50) for time in (i / 10, EPOCH + i / 10)]))
    assert list(report) == [
        Finding("robot", "clock", 0.0, "two kinds of clocks on one topic: 50 rows near 0, 50 rows in wall-clock time")
    ]


def test_topics_on_different_clocks_are_told(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        for i in range(10):
            recorder.topic("robot").append(n=i, _ts=i / 10)
            recorder.topic("camera").append(n=i, _ts=EPOCH + i / 10)
    assert list(check(tmp_path)) == [
        Finding(None, "clock", None, "two kinds of clocks: near 0 on 'robot', wall-clock time on 'camera'")
    ]
    assert list(check(tmp_path, ["robot"])) == []


def test_rows_that_the_recorder_refused_are_told(tmp_path: Path) -> None:
    options = RecorderOptions(on_full="drop", chunk_bytes=65_536, backlog_bytes=131_072)
    for _ in range(2):
        with Recorder(tmp_path, options) as recorder:
            for i in range(5000):
                recorder.topic("noise").append(samples=[0.1] * 200, _ts=EPOCH + i / 1000)
            dropped = recorder.stats()["dropped"]
            assert dropped
    with Recording(tmp_path) as rec:
        said = [int(values["noise"]) for name, values in rec.metadata if name == "ml_dash.drops"]
        (found,) = (one for one in rec.check() if one.kind == "drops")
    assert found == Finding(
        "noise", "drops", None, f"{sum(said)} rows refused, because the recorder's backlog was full"
    )


def test_rows_of_a_segment_that_is_gone_are_told_by_their_sequence_numbers(tmp_path: Path) -> None:
    record(tmp_path, [i / 10 for i in range(6000)], **SMALL_SEGMENTS)
    first, second, *_ = sorted(tmp_path.glob("*.mcap"))
    with Recording(second) as rec:
        lost = rec["robot"].info
    second.unlink()
    with Recording(first) as rec:
        kept = rec["robot"].info
    report = check(tmp_path)
    (found,) = (one for one in report if one.kind == "missing")
    numbers = f"{kept.count} to {kept.count + lost.count - 1}"
    assert found == Finding(
        "robot", "missing", kept.end, f"{lost.count} rows missing after this one (sequence numbers {numbers})"
    )
    assert {one.kind for one in report} <= {"missing", "gap", "clock"}
    assert list(check(first)) == []


def test_a_file_in_the_middle_of_a_recording_is_fine_by_itself(tmp_path: Path) -> None:
    record(tmp_path, [i / 10 for i in range(6000)], **SMALL_SEGMENTS)
    assert list(check(sorted(tmp_path.glob("*.mcap"))[1])) == []


@pytest.mark.breaks_files
def test_a_damaged_chunk_is_told_and_the_others_are_judged(tmp_path: Path) -> None:
    record(tmp_path, [i / 10 for i in range(10_000)], chunk_bytes=65536, backlog_bytes=262_144)
    (path,) = tmp_path.glob("*.mcap")
    with Recording(path) as rec:
        chunk = rec._opened()[0].index.chunks[2]
    data = bytearray(path.read_bytes())
    data[chunk.offset + chunk.length - 10] ^= 1
    path.write_bytes(data)
    for on_damage in ("raise", "skip"):
        with Recording(tmp_path, on_damage=on_damage) as rec:
            report = rec.check()
            assert [(one.topic, one.kind) for one in report][:2] == [(None, "damage"), ("robot", "missing")]
            assert {one.severity for one in report.findings[:2]} == {"error"}
            assert f"{path}, byte {chunk.offset}: " in report.findings[0].what
            assert list(rec.check()) == list(report)


def test_a_file_that_was_cut_is_told(tmp_path: Path) -> None:
    drafted = draft([{"robot": [{"_ts": i / 10} for i in range(20)]}], library="someone else")
    whole = unfinished(drafted)
    (tmp_path / "a.mcap").write_bytes(whole)
    (found,) = check(tmp_path / "a.mcap")
    assert (found.kind, found.time) == ("damage", None)
    assert found.what.endswith(f"a.mcap, byte {len(whole)}: the file has no end; what lay behind this is lost")
    (tmp_path / "b.mcap").write_bytes(whole[:-20])
    assert [one.kind for one in check(tmp_path / "b.mcap")] == ["damage"]


# Other tools' files


def foreign(path: Path, sequences: list[int]) -> Path:
    drafted = draft([{"robot": [{"_ts": 0.0}]}], kinds={"robot": None}, library="someone else")
    messages: list[Message] = [message({"_ts": i / 10}, 1, sequence) for i, sequence in enumerate(sequences)]
    drafted.data[2:] = bundle(messages)
    path.write_bytes(finished(drafted))
    return path


@pytest.mark.parametrize(
    "sequences",
    [[0] * 20, list(range(20)), list(range(0, 60, 3)), [2**32 - 10 + i if i < 10 else i - 10 for i in range(20)]],
)
def test_other_tools_may_number_as_they_like(tmp_path: Path, sequences: list[int]) -> None:
    assert list(check(foreign(tmp_path / "a.mcap", sequences))) == []


def test_a_hole_in_numbers_that_go_by_ones_is_told(tmp_path: Path) -> None:
    (found,) = check(foreign(tmp_path / "a.mcap", [*range(10), *range(15, 25)]))
    assert found == Finding("robot", "missing", 0.9, "5 rows missing after this one (sequence numbers 10 to 14)")


# The report


def test_a_report_is_read_aloud_the_worst_first(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    swapped = [i / 10 for i in range(30)]
    swapped[9], swapped[8] = swapped[8], swapped[9]
    drafted = [
        {
            "robot": [{"_ts": i / 10} for i in range(100) if i % 20],
            "imu": [{"_ts": i / 10} for i in (*range(9), 11)],
            "arm": [{"_ts": time} for time in swapped],
        }
    ]
    save(path, drafted)
    report = check(path)
    assert not report
    assert str(report).splitlines() == [
        "2 warnings and 1 note in 3 topics",
        "warning: imu: gap: at 0.8 s: no row for 0.3 s, in which there are 2 as a rule",
        "warning: robot: gap: 4 gaps, in which there are 4 rows as a rule;"
        " the longest at 1.9 s: no row for 0.2 s, in which there are 1 as a rule",
        "note: arm: late: at 0.8 s: 1 row written after one of 0.1 s later",
    ]


def test_of_very_many_alike_the_first_are_listed_and_all_are_counted(tmp_path: Path) -> None:
    times = [i / 10 for i in range(5000)]
    times[1::2], times[::2] = times[::2], times[1::2]
    (found,) = check(record(tmp_path, times))
    assert (found.count, found.rows, len(found.occurrences)) == (2500, 2500, 1000)


def test_of_very_many_alike_the_worst_is_listed_wherever_it_is(tmp_path: Path) -> None:
    ticks = [tick for tick in range(8000) if tick % 3 != 2 and not 7000 < tick < 7010]
    (found,) = check(record(tmp_path, [tick / 10 for tick in ticks]))
    assert found.kind == "gap"
    assert found.time == 700.0 == found.occurrences[-1].time
    assert found.rows == 8000 - len(ticks)


@pytest.mark.parametrize("threads", [1, 3])
def test_a_python_loop_at_1_khz_is_fine(tmp_path: Path, threads: int) -> None:
    """A real loop in a process of its own, with what a scheduler and a garbage collector do to it."""
    subprocess.run([sys.executable, "-c", textwrap.dedent(LOOP), str(tmp_path), str(threads)], check=True, timeout=60)
    with Recording(tmp_path) as rec:
        report = rec.check()
    longest = max(one.longest for one in report.spacings)
    allowed = ["gap"] if longest > 0.1 else []  # the machine stood still: that is worth a look
    assert [one.kind for one in report if one.severity != "note"] == allowed * len(
        [one for one in report.spacings if one.longest > 0.1]
    )
    assert len(report) <= 2 * threads
    assert {one.topic for one in report.spacings} == {f"loop{number}" for number in range(threads)}
    for one in report.spacings:
        assert 0.0009 <= one.usual <= 0.01
    assert len(str(report).splitlines()) <= 1 + 3 * threads


LOOP = """
    import sys, threading, time
    from ml_dash_mcap import Recorder
    recorder = Recorder(sys.argv[1])
    def loop(number):
        topic, due = recorder.topic(f"loop{number}"), time.perf_counter()
        for i in range(2000):
            topic.append(q=[0.1] * 7, i=i, _ts=time.time())
            due += 0.001
            time.sleep(max(due - time.perf_counter(), 0.0))
    threads = [threading.Thread(target=loop, args=(number,)) for number in range(int(sys.argv[2]))]
    [one.start() for one in threads]
    [one.join() for one in threads]
    recorder.close()
"""


def loop_times(seed: int, hiccups_s: list[float]) -> np.ndarray:
    """Times of a loop at 1 kHz that is held up now and then and catches up, as measured."""
    rng = np.random.default_rng(seed)
    due, now, times = 0.0, 0.0, []
    at = dict(zip(rng.choice(5000, len(hiccups_s), replace=False).tolist(), hiccups_s, strict=True))
    for tick in range(5000):
        now = max(now + 20e-6, due + rng.exponential(60e-6)) + at.get(tick, 0.0)
        times.append(EPOCH + now)
        due += 1e-3
    return np.array(times)


def test_a_loop_that_is_held_up_for_a_moment_now_and_then_is_fine(tmp_path: Path) -> None:
    hiccups = [0.002] * 40 + [0.01] * 20 + [0.05] * 3
    report = check(record(tmp_path, loop_times(1, hiccups)))
    assert list(report) == []
    assert report
    (measured,) = report.spacings
    assert 50 <= measured.long <= 70
    assert f"{measured.long} above 1.5 times the usual" in str(report)


def test_a_loop_that_sleeps_after_its_work_and_is_held_up_often_is_fine(tmp_path: Path) -> None:
    """`while True: append(...); sleep(0.001)` beside other programs: what is lost is never caught up with."""
    rng = np.random.default_rng(5)
    widths = 1.09e-3 + rng.exponential(20e-6, 4000)
    held = rng.choice(4000, 140, replace=False)
    widths[held] += rng.uniform(0.6e-3, 20e-3, 140)
    report = check(record(tmp_path, EPOCH + np.cumsum(widths)))
    assert list(report) == []
    (measured,) = report.spacings
    assert 130 <= measured.long <= 140
    assert len(str(report).splitlines()) == 2


def test_a_loop_that_stands_still_is_told(tmp_path: Path) -> None:
    (found,) = check(record(tmp_path, loop_times(2, [0.01] * 10 + [0.5])))
    assert (found.kind, found.count) == ("gap", 1)
    assert 0.5 <= found.occurrences[0].size <= 0.502


def test_pictures_of_which_every_tenth_is_missing_are_told_though_their_times_are_measured(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    times = [EPOCH + (i + 0.1 * rng.random()) / 30 for i in range(600) if i % 10 != 5]
    (found,) = check(record(tmp_path, times))
    assert (found.kind, found.count, found.rows) == ("gap", 60, 60)


@settings(max_examples=examples(100), deadline=None)
@given(st.lists(st.integers(1, 50), min_size=5, max_size=60), st.sampled_from([1_000_000, 10_000_000, 33_333_333]))
def test_on_a_grid_every_row_that_is_not_there_is_counted(ticks: list[int], period_ns: int) -> None:
    """Of a simulation whose usual step is one tick, so that most rows are one tick apart."""
    steps = [1] * (20 * len(ticks)) + ticks
    widths = np.array(steps, np.uint64) * np.uint64(period_ns)
    limit = spacings.limit_ns(widths)
    assert [int(width) > limit for width in widths] == [step > 1 for step in steps]


def test_a_check_of_some_topics_looks_at_these(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        for i in range(20):
            recorder.topic("good").append(n=i, _ts=i / 10)
            recorder.topic("bad").append(n=i, _ts=i / 10 if i < 10 else 5 + i / 10)
    with Recording(tmp_path) as rec:
        assert rec.check(["good"]).topics == ("good",)
        assert rec.check(["good"])
        assert not rec.check(["bad"])
        with pytest.raises(NotFoundError, match="did you mean 'good'"):
            rec.check(["god"])
        with pytest.raises(UsageError, match=r"topics=\['good'\]"):
            rec.check("good")


# The order of writing, by itself


def in_ns(*times: float) -> np.ndarray:
    return np.array([round(time * 1e9) for time in times], np.uint64)


@settings(max_examples=examples(200), deadline=None)
@given(st.lists(st.integers(0, 60), max_size=20))
def test_every_row_behind_an_earlier_one_is_late_or_after_a_step(times: list[int]) -> None:
    lates, steps = time_steps_back.find(np.array(times, np.uint64))
    told = {place for late in lates for place in range(late.first, late.first + late.count)}
    starts = [0, *(step.at for step in steps if step.to_ns < step.from_ns), len(times)]
    for start, stop in pairwise(starts):
        behind = {at for at in range(start, stop) if times[at] < max(times[start : at + 1])}
        assert behind == told & set(range(start, stop))


def test_a_clock_may_be_set_on_and_back() -> None:
    times = in_ns(0, 1, 2, 3, 5000, 5001, 5002, 4, 5, 6, 7)
    lates, steps = time_steps_back.find(times)
    assert lates == []
    assert [(step.at, step.from_ns, step.to_ns) for step in steps] == [
        (4, 3 * 10**9, 5000 * 10**9),
        (7, 5002 * 10**9, 4 * 10**9),
    ]
