"""Forks, ends without close, threads, and several recorders on one folder."""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

import ml_dash_mcap
from ml_dash_mcap import Recorder, RecorderOptions, Recording
from tests.support import disk

ROOT = Path(ml_dash_mcap.__file__).parents[1]
THREADS, ROWS = 8, 3000


def python(script: str, *arguments: object) -> subprocess.Popen[str]:
    """Start a program; a fork in one with threads is what is tested, so Python's warning about it is no failure."""
    return subprocess.Popen(
        [sys.executable, "-W", "ignore::DeprecationWarning", "-c", script, *map(str, arguments)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )


def finish(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    try:
        out, err = process.communicate(timeout=60)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise
    return process.returncode, out, err


def rows_of(folder: Path) -> dict[str, list[dict[str, Any]]]:
    """The tracks' rows in the finished files."""
    return {topic: rows for topic, rows in disk.rows(folder).items() if not topic.startswith("ml_dash/")}


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


# Forks

_FORK = """
import gc, json, os, sys
from ml_dash_mcap import Recorder
from ml_dash_mcap.errors import StateError

folder, leave = sys.argv[1:]
recorder = Recorder(folder)
arm = recorder.topic("arm")
for n in range(100):
    arm.append(n=n, _ts=n)
read_end, write_end = os.pipe()
child = os.fork()
if child == 0:
    said = []
    calls = [
        lambda: arm.append(n=-1, _ts=500.0),
        lambda: arm.append(n=-1, _ts=500.0, big="x" * 3_000_000),
        lambda: arm.append_batch([{"n": -1, "_ts": 500.0}]),
        lambda: arm.append_columns(n=[-1], _ts=[500.0]),
        lambda: recorder.set_parameters({"a": 1}),
        lambda: recorder.topic("new"),
        recorder.flush,
        arm.flush,
    ]
    for call in calls:
        try:
            call()
            said.append("taken")
        except StateError as error:
            said.append("fork" if "fork" in str(error) else str(error))
    os.write(write_end, json.dumps(said).encode())
    if leave == "close":
        recorder.close()
    if leave == "collect":
        del recorder, arm, calls, call
        gc.collect()
    if leave == "_exit":
        os._exit(7)
    sys.exit(7)
os.close(write_end)
said = b"".join(iter(lambda: os.read(read_end, 65536), b""))
_, status = os.waitpid(child, 0)
for n in range(100, 200):
    arm.append(n=n, _ts=n)
recorder.close()
print(json.dumps([os.waitstatus_to_exitcode(status), json.loads(said)]))
"""


@pytest.mark.parametrize("leave", ["_exit", "exit", "close", "collect"])
def test_a_forked_child_may_not_append_and_leaves_its_parents_rows_unharmed(tmp_path: Path, leave: str) -> None:
    code, out, err = finish(python(_FORK, tmp_path / "run", leave))
    assert (code, err) == (0, "")
    assert json.loads(out) == [7, ["fork"] * 8]
    assert rows_of(tmp_path / "run") == {"arm": [{"n": n, "_ts": float(n)} for n in range(200)]}
    assert names_in(tmp_path / "run") == [path.name for path in disk.segments(tmp_path / "run")]
    assert len(disk.segments(tmp_path / "run")) == 1


_FORK_WHILE_APPENDING = """
import os, sys, threading
from ml_dash_mcap import Recorder

recorder = Recorder(sys.argv[1])
stop = threading.Event()
counts = [0] * 4

def work(number):
    topic = recorder.topic(f"t{number}")
    while not stop.is_set():
        topic.append(n=counts[number], text="x" * 200, _ts=counts[number])
        counts[number] += 1

threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
for thread in threads:
    thread.start()
for _ in range(20):
    child = os.fork()
    if child == 0:
        try:
            recorder.topic("t0").append(n=-1, _ts=1.0)
        except RuntimeError:
            os._exit(0)
        os._exit(1)
    assert os.waitpid(child, 0)[1] == 0
stop.set()
for thread in threads:
    thread.join()
recorder.close()
print(*counts)
"""


def test_forks_in_the_midst_of_appending_threads_neither_hang_nor_lose_a_row(tmp_path: Path) -> None:
    code, out, err = finish(python(_FORK_WHILE_APPENDING, tmp_path))
    assert (code, err) == (0, "")
    counts = [int(count) for count in out.split()]
    found = {topic: [row["n"] for row in rows] for topic, rows in rows_of(tmp_path).items()}
    assert found == {f"t{number}": list(range(count)) for number, count in enumerate(counts)}


_MULTIPROCESSING = """
import multiprocessing, sys
from ml_dash_mcap import Recorder

recorder = Recorder(sys.argv[1])
arm = recorder.topic("arm")

def work(number):
    try:
        arm.append(n=-1, _ts=1.0)
        refused = False
    except RuntimeError:
        refused = True
    with Recorder(sys.argv[1]) as own:
        for n in range(50):
            own.topic(f"child {number}").append(n=n, _ts=n)
    return refused

for n in range(50):
    arm.append(n=n, _ts=n)
with multiprocessing.get_context("fork").Pool(3) as pool:
    print(pool.map(work, range(3), chunksize=1))
    pool.close()
    pool.join()
for n in range(50, 100):
    arm.append(n=n, _ts=n)
recorder.close()
"""


def test_a_multiprocessing_worker_opens_a_recorder_of_its_own(tmp_path: Path) -> None:
    code, out, err = finish(python(_MULTIPROCESSING, tmp_path))
    assert (code, out, err) == (0, "[True, True, True]\n", "")
    assert rows_of(tmp_path) == {
        "arm": [{"n": n, "_ts": float(n)} for n in range(100)],
        **{f"child {number}": [{"n": n, "_ts": float(n)} for n in range(50)] for number in range(3)},
    }
    assert names_in(tmp_path) == [path.name for path in disk.segments(tmp_path)]


# Ends without close

_NO_CLOSE = """
import sys
from ml_dash_mcap import Experiment, Recorder

folder, api, end = sys.argv[1:]
if api == "recorder":
    recorder = Recorder(folder)
    topic = recorder.topic
else:
    experiment = Experiment("run", root=folder)
    experiment.run.start()
    topic = experiment.tracks
for n in range(500):
    topic("arm").append(n=n, _ts=n)
if end == "raise":
    raise ValueError("the loop broke")
if end == "exit":
    sys.exit(3)
"""


@pytest.mark.parametrize("api", ["recorder", "experiment"])
@pytest.mark.parametrize(("end", "code"), [("return", 0), ("raise", 1), ("exit", 3)])
def test_a_process_that_ends_without_close_loses_nothing(tmp_path: Path, api: str, end: str, code: int) -> None:
    folder = tmp_path / "run"
    got, out, err = finish(python(_NO_CLOSE, tmp_path if api == "experiment" else folder, api, end))
    last = err.splitlines()[-1:]
    assert (got, out, last) == (code, "", ["ValueError: the loop broke"] if end == "raise" else [])
    assert rows_of(folder) == {"arm": [{"n": n, "_ts": float(n)} for n in range(500)]}
    assert [path.name for path in folder.iterdir() if path.is_file()] == [disk.segments(folder)[0].name]


def test_a_recorder_that_is_dropped_without_close_still_writes_its_rows(tmp_path: Path) -> None:
    gc.disable()  # so that it is this thread, and not a background one, that finds it
    try:
        recorder = Recorder(tmp_path)
        for n in range(500):
            recorder.topic("arm").append(n=n, _ts=float(n))
        del recorder
        gc.collect()
    finally:
        gc.enable()
    assert rows_of(tmp_path) == {"arm": [{"n": n, "_ts": float(n)} for n in range(500)]}
    assert names_in(tmp_path) == [disk.segments(tmp_path)[0].name]


def test_a_topic_keeps_its_recorder_alive(tmp_path: Path) -> None:
    topic = Recorder(tmp_path).topic("arm")
    gc.collect()
    topic.append(n=1, _ts=1.0).flush()
    with Recording(tmp_path) as recording:
        assert list(recording["arm"]) == [{"n": 1, "_ts": 1.0}]
    (recorder,) = (each for each in gc.get_objects() if isinstance(each, Recorder) and each.path == tmp_path)
    recorder.close()
    assert rows_of(tmp_path) == {"arm": [{"n": 1, "_ts": 1.0}]}


# Threads


def _append_from_threads(recorder: Recorder) -> list[dict[str, Any]]:
    """Append from all threads at once; returns the figures that were seen meanwhile."""
    samples: list[dict[str, Any]] = []
    barrier = threading.Barrier(THREADS + 1)

    def work(number: int) -> None:
        own = recorder.topic(f"own {number}")
        barrier.wait()
        for n in range(ROWS):
            recorder.topic("shared").append(thread=number, n=n, _ts=float(n * THREADS + number))
            own.append(n=n, _ts=float(n))

    threads = [threading.Thread(target=work, args=(number,)) for number in range(THREADS)]
    for thread in threads:
        thread.start()
    barrier.wait()
    for thread in threads:
        while thread.is_alive():
            samples.append(recorder.stats())
            thread.join(0.001)
    return samples


def _check_figures(samples: list[dict[str, Any]]) -> None:
    for stats in samples:
        assert stats["accepted"] == stats["written"] + stats["waiting"] + stats["dropped"]
        assert stats["dropped"] == sum(stats["dropped_by_topic"].values())
        assert min(stats["accepted"], stats["written"], stats["waiting"], stats["dropped"]) >= 0
        assert stats["failure"] is None
    for name in ("accepted", "written", "dropped", "bytes_written"):
        series = [stats[name] for stats in samples]
        assert series == sorted(series)


def test_eight_threads_on_shared_and_own_topics_lose_nothing_and_the_figures_add_up(tmp_path: Path) -> None:
    options = RecorderOptions(chunk_bytes=128 * 1024, backlog_bytes=1024 * 1024, flush_interval_s=0.05)
    with Recorder(tmp_path, options) as recorder:
        samples = _append_from_threads(recorder)
    last = recorder.stats()
    _check_figures([*samples, last])
    total = 2 * THREADS * ROWS
    figures = {name: last[name] for name in ("accepted", "written", "waiting", "dropped", "dropped_by_topic")}
    assert figures == {"accepted": total, "written": total, "waiting": 0, "dropped": 0, "dropped_by_topic": {}}
    found = rows_of(tmp_path)
    shared = sorted((row["thread"], row["n"], row["_ts"]) for row in found.pop("shared"))
    assert shared == [(t, n, float(n * THREADS + t)) for t in range(THREADS) for n in range(ROWS)]
    assert found == {f"own {t}": [{"n": n, "_ts": float(n)} for n in range(ROWS)] for t in range(THREADS)}


def test_rows_that_eight_threads_drop_are_counted_and_all_others_are_written(tmp_path: Path) -> None:
    options = RecorderOptions(chunk_bytes=64 * 1024, backlog_bytes=128 * 1024, on_full="drop", compression_level=19)
    with Recorder(tmp_path, options) as recorder:
        samples = _append_from_threads(recorder)
    last = recorder.stats()
    _check_figures([*samples, last])
    assert last["dropped"] > 0
    assert (last["accepted"], last["waiting"]) == (2 * THREADS * ROWS, 0)
    offered = {"shared": THREADS * ROWS, **{f"own {number}": ROWS for number in range(THREADS)}}
    found = {topic: len(rows) for topic, rows in rows_of(tmp_path).items()}
    assert {topic: found.get(topic, 0) + last["dropped_by_topic"].get(topic, 0) for topic in offered} == offered
    assert sum(found.values()) == last["written"]


# Several recorders on one folder


def test_two_recorders_on_one_folder_in_one_process_keep_all_rows(tmp_path: Path) -> None:
    with Recorder(tmp_path) as first, Recorder(tmp_path) as second:
        for n in range(0, 200, 2):
            first.topic("arm").append(n=n, _ts=float(n))
            second.topic("arm").append(n=n + 1, _ts=float(n + 1))
            second.topic("other").append(n=n, _ts=float(n))
        first.flush()
        first.topic("late").append(n=1, _ts=1.0)
    found = rows_of(tmp_path)
    found["arm"].sort(key=lambda row: row["_ts"])
    assert found == {
        "arm": [{"n": n, "_ts": float(n)} for n in range(200)],
        "other": [{"n": n, "_ts": float(n)} for n in range(0, 200, 2)],
        "late": [{"n": 1, "_ts": 1.0}],
    }
    assert len(disk.segments(tmp_path)) == 2
    assert names_in(tmp_path) == [path.name for path in disk.segments(tmp_path)]
    with Recording(tmp_path) as recording:
        assert list(recording["arm"]) == [{"n": n, "_ts": float(n)} for n in range(200)]


_IN_STEP = """
import sys
from ml_dash_mcap import Recorder

folder, first = sys.argv[1], int(sys.argv[2])
with Recorder(folder) as recorder:
    print("open", flush=True)
    sys.stdin.readline()
    for n in range(first, 2000, 2):
        recorder.topic("arm").append(n=n, _ts=n)
    recorder.flush()
    print("flushed", flush=True)
    sys.stdin.readline()
"""


def test_two_recorders_on_one_folder_in_two_processes_keep_all_rows(tmp_path: Path) -> None:
    processes = [python(_IN_STEP, tmp_path, first) for first in (0, 1)]
    try:
        for word in ("open\n", "flushed\n"):
            for process in processes:
                assert process.stdout is not None
                assert process.stdout.readline() == word
            if word == "flushed\n":
                with Recording(tmp_path) as recording:
                    assert list(recording["arm"]) == [{"n": n, "_ts": float(n)} for n in range(2000)]
            for process in processes:
                assert process.stdin is not None
                process.stdin.write("\n")
                process.stdin.flush()
    finally:
        ends = [finish(process) for process in processes]
    assert ends == [(0, "", ""), (0, "", "")]
    rows = sorted(rows_of(tmp_path)["arm"], key=lambda row: row["_ts"])
    assert rows == [{"n": n, "_ts": float(n)} for n in range(2000)]
    assert names_in(tmp_path) == [path.name for path in disk.segments(tmp_path)]


# Import


def test_importing_the_library_loads_no_reader_of_foreign_formats() -> None:
    script = "import sys, ml_dash_mcap; print(sorted(n for n in sys.modules if n.split('.')[0] in ('pyarrow', 'rosbags') or n.startswith('google.protobuf')))"
    assert finish(python(script)) == (0, "[]\n", "")


def test_importing_the_library_takes_less_than_a_tenth_of_a_second() -> None:
    def best_s(script: str) -> float:
        times = []
        for _ in range(5):
            start = time.perf_counter()
            assert finish(python(script)) == (0, "", "")
            times.append(time.perf_counter() - start)
        return min(times)

    assert best_s("import ml_dash_mcap") - best_s("pass") < 0.1
