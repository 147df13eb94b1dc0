"""Several recorders, forks, ends without closing, threads, and what an import costs."""

from __future__ import annotations

import gc
import math
import multiprocessing
import os
import signal
import subprocess
import sys
import textwrap
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ml_dash_mcap.errors import FieldError, StateError
from ml_dash_mcap.options import RecorderOptions
from ml_dash_mcap.recorder import Recorder
from ml_dash_mcap.recording import Recording
from tests.support import disk
from tests.support.case_ids import stable_repr

Row = dict[str, Any]

SMALL = RecorderOptions(chunk_bytes=65536, backlog_bytes=4 * 65536)


@pytest.fixture
def recorder(tmp_path: Path) -> Iterator[Recorder]:
    with Recorder(tmp_path / "run") as one:
        yield one


def test_parameters_and_metadata_survive(tmp_path: Path) -> None:
    with Recorder(
        tmp_path, RecorderOptions(segment_duration_s=1e-9), prefix="me/run", metadata={"robot": "arm"}
    ) as recorder:
        recorder.set_parameters({"lr": 0.1, "net.layers": [1, 2], "inf": math.inf, "array": np.arange(3), "gone": 1})
        recorder.topic("a", description="an arm", tags=["x", "y"], metadata={"unit": "rad"}).append(
            x=1, _ts=1.0
        ).flush()
        recorder.set_parameters({"gone": None})
        recorder.write_metadata("note", {"k": "v"})
        recorder.topic("a", description="another").append(x=2, _ts=2.0)
    assert len(disk.segments(tmp_path)) > 1
    first = disk.metadata(tmp_path, "ml_dash")[0]
    assert {name: first[name] for name in ("prefix", "robot", "segment")} == {
        "prefix": "me/run",
        "robot": "arm",
        "segment": "1",
    }
    assert disk.metadata(tmp_path, "note") == [{"k": "v"}]
    assert disk.metadata(tmp_path, "ml_dash.topic") == [{"topic": "a", "description": "another"}]
    assert disk.channel(tmp_path, "a")[0].metadata == {
        "kind": "track",
        "description": "an arm",
        "tags": '["x", "y"]',
        "metadata": '{"unit":"rad"}',
    }
    with Recording(tmp_path) as recording:
        assert recording.params == {"lr": 0.1, "net.layers": [1, 2], "inf": math.inf, "array": [0, 1, 2], "gone": None}


@pytest.mark.parametrize("value", [object(), {1, 2}, 2**70, "\ud800"], ids=stable_repr)
def test_a_parameter_that_cannot_be_stored_is_refused_by_name(recorder: Recorder, value: Any) -> None:
    with pytest.raises(FieldError, match=r"'net\.lr'"):
        recorder.set_parameters({"good": 1, "net.lr": value})


def test_two_recorders_on_one_folder_in_one_process_keep_all_rows(tmp_path: Path) -> None:
    with Recorder(tmp_path, SMALL) as one, Recorder(tmp_path, SMALL) as other:
        for number in range(3000):
            one.topic("a").append(one=number, _ts=float(number))
            other.topic("a").append(other=number, _ts=float(number))
            if number == 1500:
                one.flush()
                with Recording(tmp_path) as recording:
                    assert len(recording["a"]) > 1500
    with Recording(tmp_path) as recording:
        assert list(recording["a"].rows()) == [{"one": n, "other": n, "_ts": float(n)} for n in range(3000)]


def record_in_a_process(folder: str, number: int, barrier: Any) -> None:
    barrier.wait()
    with Recorder(folder, SMALL) as recorder:
        for row in range(2000):
            recorder.topic("shared").append(**{f"p{number}": row}, _ts=float(row))
            recorder.topic(f"own{number}").append(n=row, _ts=float(row))


def test_recorders_in_several_processes_on_one_folder_keep_all_rows(tmp_path: Path) -> None:
    context = multiprocessing.get_context("spawn")
    barrier = context.Barrier(3)
    running = [
        context.Process(target=record_in_a_process, args=(str(tmp_path), number, barrier)) for number in range(3)
    ]
    for process in running:
        process.start()
    for process in running:
        process.join()
    assert [process.exitcode for process in running] == [0, 0, 0]
    with Recording(tmp_path) as recording:
        assert list(recording["shared"].rows()) == [{"p0": n, "p1": n, "p2": n, "_ts": float(n)} for n in range(2000)]
        assert [len(recording[f"own{number}"]) for number in range(3)] == [2000] * 3


def run_python(code: str, *args: str) -> subprocess.CompletedProcess[str]:
    """Run a program in an interpreter of its own; one that hangs ends with its traceback."""
    code = "import sys\n" + textwrap.dedent(code)
    with subprocess.Popen(
        [sys.executable, "-X", "faulthandler", "-W", "ignore::DeprecationWarning", "-c", code, *args],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            out, said = process.communicate(timeout=40)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGABRT)
            out, said = process.communicate()
        return subprocess.CompletedProcess(code, process.returncode, out, said)


ENDS = {
    "falling off the end": "",
    "sys.exit": "sys.exit(3)",
    "an exception": "raise KeyError('x')",
    "a thread that goes on": textwrap.dedent(
        """
        import threading
        def go_on():
            for n in range(1000, 2000):
                t.append(n=n, _ts=float(n))
        threading.Thread(target=go_on).start()
        """
    ),
    "the recorder forgotten": "del r, t; import gc; gc.collect()",
}


@pytest.mark.parametrize("end", ENDS)
def test_a_program_that_ends_without_closing_loses_nothing(tmp_path: Path, end: str) -> None:
    record = """
        from ml_dash_mcap.recorder import Recorder
        r = Recorder(sys.argv[1])
        t = r.topic("a")
        for n in range(1000):
            t.append(n=n, _ts=float(n))
    """
    done = run_python(textwrap.dedent(record) + ENDS[end], str(tmp_path))
    assert ("Traceback" in done.stderr) == (end == "an exception"), done.stderr
    count = 2000 if end == "a thread that goes on" else 1000
    assert [row["n"] for row in disk.rows(tmp_path)["a"]] == list(range(count))
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".mcap"] * len(disk.segments(tmp_path))


def test_a_recorder_that_is_forgotten_is_closed(tmp_path: Path) -> None:
    Recorder(tmp_path).topic("a").append(x=1, _ts=1.0)
    gc.collect()
    assert disk.rows(tmp_path) == {"a": [{"x": 1, "_ts": 1.0}]}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
@pytest.mark.parametrize("end", ["os._exit(0)", "sys.exit(0)", "pass"])
def test_a_forked_child_cannot_record_and_does_no_harm(tmp_path: Path, end: str) -> None:
    done = run_python(
        f"""
        import os
        from ml_dash_mcap.recorder import Recorder
        from ml_dash_mcap.errors import StateError
        r = Recorder(sys.argv[1])
        t = r.topic("a")
        for n in range(100):
            t.append(n=n, _ts=float(n))
        pid = os.fork()
        if pid == 0:
            for use in (lambda: t.append(n=-1, _ts=1.0), lambda: t.append_batch([dict(n=-1, _ts=1.0)]), r.flush,
                        lambda: t.append_columns(n=[-1], _ts=[1.0]), lambda: r.topic("new"),
                        lambda: r.set_parameters(dict(a=1))):
                try:
                    use()
                except StateError as error:
                    assert "parent" in str(error)
                else:
                    os._exit(7)
            r.close()
            with Recorder(sys.argv[1]) as own:
                own.topic("child").append(n=0, _ts=0.0)
            {end}
        else:
            assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
            for n in range(100, 200):
                t.append(n=n, _ts=float(n))
            r.close()
        """,
        str(tmp_path),
    )
    assert (done.returncode, done.stderr) == (0, "")
    found = disk.rows(tmp_path)
    assert [row["n"] for row in found.pop("a")] == list(range(200))
    assert found == {"child": [{"n": 0, "_ts": 0.0}]}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
def test_a_fork_while_another_thread_opens_a_topic_does_not_hang(tmp_path: Path) -> None:
    done = run_python(
        """
        import os, signal, threading
        from ml_dash_mcap.capture.journal import Journal
        from ml_dash_mcap.errors import StateError
        from ml_dash_mcap.recorder import Recorder
        r = Recorder(sys.argv[1])
        old, opening, goes_on = r.topic("old"), threading.Event(), threading.Event()
        register = Journal.register
        def slowly(*definition):
            opening.set()
            goes_on.wait()
            register(*definition)
        Journal.register = slowly
        thread = threading.Thread(target=lambda: r.topic("slow").append(x=1, _ts=1.0))
        thread.start()
        opening.wait()
        pid = os.fork()
        if pid == 0:
            signal.alarm(20)
            assert r.topic("old") is old
            for use in (lambda: r.topic("new"), lambda: r.topic("old", description="more")):
                try:
                    use()
                except StateError:
                    continue
                os._exit(7)
            os._exit(0)
        assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
        goes_on.set()
        thread.join()
        r.close()
        """,
        str(tmp_path),
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert disk.rows(tmp_path) == {"slow": [{"x": 1, "_ts": 1.0}]}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
def test_forks_while_other_threads_record_neither_hang_nor_lose(tmp_path: Path) -> None:
    done = run_python(
        """
        import os, threading
        from ml_dash_mcap.recorder import Recorder
        from ml_dash_mcap.errors import StateError
        r = Recorder(sys.argv[1])
        t, stop, counts = r.topic("a"), threading.Event(), [0, 0]
        def work(number):
            while not stop.is_set():
                t.append(n=counts[number], by=number, _ts=counts[number] + number / 2)
                r.topic(f"t{counts[number] % 50}")
                counts[number] += 1
        threads = [threading.Thread(target=work, args=(number,)) for number in range(2)]
        [thread.start() for thread in threads]
        for _ in range(15):
            pid = os.fork()
            if pid == 0:
                for use in (lambda: t.append(n=1, _ts=1.0), lambda: r.topic("new in the child")):
                    try:
                        use()
                    except StateError:
                        pass
                    else:
                        os._exit(7)
                os._exit(0)
            assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
        stop.set()
        [thread.join() for thread in threads]
        r.close()
        print(*counts)
        """,
        str(tmp_path),
    )
    assert (done.returncode, done.stderr) == (0, "")
    counts = [int(text) for text in done.stdout.split()]
    found = disk.rows(tmp_path)["a"]
    assert [[row["n"] for row in found if row["by"] == number] for number in range(2)] == [
        list(range(count)) for count in counts
    ]


def test_closing_while_other_threads_append_loses_no_row_that_was_taken(tmp_path: Path) -> None:
    for attempt in range(6):
        recorder = Recorder(tmp_path / str(attempt), SMALL)
        taken: list[list[int]] = [[], [], []]
        started = threading.Barrier(4)

        def work(
            number: int, recorder: Recorder = recorder, taken: list[list[int]] = taken, started: Any = started
        ) -> None:
            topic = recorder.topic(f"t{number}")
            started.wait()
            try:
                for row in range(10**6):
                    topic.append(n=row, _ts=float(row))
                    taken[number].append(row)
            except StateError:
                pass

        running = [threading.Thread(target=work, args=(number,)) for number in range(3)]
        for thread in running:
            thread.start()
        started.wait()
        while sum(map(len, taken)) < 700 * attempt:
            pass
        recorder.close()
        for thread in running:
            thread.join()
        found = disk.rows(recorder.path)
        assert [[row["n"] for row in found.get(f"t{number}", [])] for number in range(3)] == taken


HEAVY = [
    "pyarrow",
    "rosbags",
    "google.protobuf",
    "rich",
    "obstore",
    "PIL",
    "mujoco",
    "matplotlib",
    "pandas",
    "av",
    "torch",
]


def test_the_import_loads_nothing_heavy_and_takes_less_than_a_tenth_of_a_second() -> None:
    code = """
        import time
        begin = time.perf_counter()
        import ml_dash_mcap
        took = time.perf_counter() - begin
        print(took, *(name for name in sys.argv[1:] if name in sys.modules))
    """
    runs = [run_python(code, *HEAVY).stdout.split() for _ in range(5)]
    assert runs[0][1:] == []
    assert min(float(run[0]) for run in runs) < 0.1


def test_a_recorder_loads_nothing_heavy_either() -> None:
    code = """
        import tempfile
        from ml_dash_mcap import Recorder
        with Recorder(tempfile.mkdtemp()) as r:
            r.topic("a").append(x=1, _ts=1.0)
        print(*(name for name in sys.argv[1:] if name in sys.modules))
    """
    done = run_python(code, *HEAVY)
    assert (done.stdout.split(), done.stderr) == ([], "")
