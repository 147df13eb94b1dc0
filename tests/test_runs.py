"""A folder may hold several runs: they are listed, and one of them can be read by itself."""

from __future__ import annotations

import json
import logging
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from ml_dash_mcap import Experiment, Recorder, RecorderOptions, Recording, Session, convert
from ml_dash_mcap.cli import main
from ml_dash_mcap.errors import NotFoundError, OptionError
from tests.support import disk
from tests.support.files import save


def record(root: Path, run: int, rows: int = 10, start: float = 0.0) -> str:
    """Record a run from t = 0 and return its id, as its files say by the mcap package."""
    with Experiment("a/b", root=root).run as exp:
        exp.params.set(run=run)
        for i in range(rows):
            exp.tracks("robot").append(run=run, i=i, _ts=start + i / 10)
        if run:
            exp.tracks("camera").append(run=run, _ts=start)
        exp.log(f"run {run}")
    return disk.metadata(exp.path, "ml_dash")[-1]["run"]


@pytest.fixture
def runs(tmp_path: Path) -> list[str]:
    return [record(tmp_path, run, rows=10 - run) for run in range(3)]


def test_runs_are_listed_in_the_order_in_which_they_began(tmp_path: Path, runs: list[str]) -> None:
    with Recording(tmp_path / "a/b") as rec:
        found = rec.runs
        assert [run.id for run in found] == runs
        assert [run.index for run in found] == [0, 1, 2]
        assert [(run.start, run.end, run.duration) for run in found] == [
            (0.0, 0.9, 0.9),
            (0.0, 0.8, 0.8),
            (0.0, 0.7, 0.7),
        ]
        assert [dict(run.counts) for run in found] == [
            {"robot": 10},
            {"camera": 1, "robot": 9},
            {"camera": 1, "robot": 8},
        ]
        assert [run.status for run in found] == ["completed"] * 3
        assert [path for run in found for path in run.segments] == rec.segments
        assert found[0].metadata["prefix"] == "a/b"
        assert rec.run["status"] == "completed"


@pytest.mark.parametrize("by", ["id", "beginning", "number", "from the end"])
def test_one_run_is_read_by_itself(tmp_path: Path, runs: list[str], by: str) -> None:
    for number, name in enumerate(runs):
        others = [one for one in runs if one != name]
        beginning = next(name[:n] for n in range(1, 17) if not any(one.startswith(name[:n]) for one in others))
        wanted = {"id": name, "beginning": beginning, "number": number, "from the end": number - 3}[by]
        with Recording(tmp_path / "a/b", run=wanted) as rec:
            assert [row["run"] for row in rec["robot"].rows()] == [number] * (10 - number)
            assert rec["robot"].info.count == 10 - number
            assert rec.params == {"run": number}
            assert [row["message"] for row in rec.logs] == [f"run {number}"]
            assert ("camera" in rec) == (number > 0)
            assert [(run.index, run.id) for run in rec.runs] == [(number, name)]
            assert rec.end == (9 - number) / 10
            assert rec.check()
            assert rec["robot"].to_arrow().num_rows == 10 - number
            rec.export(tmp_path / f"{number}.jsonl", format="jsonl", topics=["robot"])
        lines = [path for path in (tmp_path / f"{number}.jsonl").rglob("*") if path.is_file()] or [
            tmp_path / f"{number}.jsonl"
        ]
        assert len(lines[0].read_text().splitlines()) == 10 - number
    with Recording(tmp_path / "a/b") as rec:
        assert rec["robot"].info.count == 10
        found = {finding.topic: finding.rows for finding in rec.check() if finding.kind == "clock"}
    assert found == {"robot": 9 + 8, "camera": 1}


@pytest.mark.parametrize("wanted", ["nope", 3, -4])
def test_a_run_that_is_not_there_is_named_with_those_that_are(
    tmp_path: Path, runs: list[str], wanted: str | int
) -> None:
    with pytest.raises(NotFoundError, match="run=") as error:
        Recording(tmp_path / "a/b", run=wanted)
    assert isinstance(error.value, KeyError)
    assert repr(runs[0]) in str(error.value) if wanted == "nope" else "3 runs" in str(error.value)


@pytest.mark.parametrize("wanted", [True, 1.0, "", [0], b"x"])
def test_a_run_is_asked_for_by_text_or_number(tmp_path: Path, runs: list[str], wanted: object) -> None:
    with pytest.raises(OptionError, match="pass a run's id, or its number"):
        Recording(tmp_path / "a/b", run=wanted)  # type: ignore[arg-type]


def test_ids_that_begin_alike_are_told_apart_by_more(tmp_path: Path) -> None:
    for name in ("run-a", "run-b"):
        save(tmp_path / f"{name}.mcap", [{"robot": [{"_ts": 0.0}]}], library="someone else")
    with pytest.raises(NotFoundError, match=r"several runs begin so; there are 'run-a.mcap', 'run-b.mcap'"):
        Recording(tmp_path, run="run-")
    with Recording(tmp_path, run="run-b") as rec:
        assert rec.segments == [tmp_path / "run-b.mcap"]


def test_a_file_of_another_program_is_a_run_of_its_own(tmp_path: Path) -> None:
    save(tmp_path / "first.mcap", [{"robot": [{"_ts": 0.0}, {"_ts": 2.0}]}], library="someone else")
    with Recording(tmp_path / "first.mcap") as rec:
        (run,) = rec.runs
    assert (run.id, run.status, run.start, run.end) == ("first.mcap", "finished", 0.0, 2.0)


def test_a_run_of_many_files_is_one(tmp_path: Path) -> None:
    options = RecorderOptions(chunk_bytes=65536, backlog_bytes=262_144, segment_bytes=65536, compression="none")
    for run in range(2):
        with Recorder(tmp_path, options) as recorder:
            for i in range(3000):
                recorder.topic("robot").append(run=run, i=i, _ts=run + i / 1000)
    with Recording(tmp_path) as rec:
        assert len(rec.segments) > 4
        assert [run.counts["robot"] for run in rec.runs] == [3000, 3000]
        assert [run.status for run in rec.runs] == ["finished", "finished"]
    with Recording(tmp_path, run=1) as rec:
        assert {row["run"] for row in rec["robot"].rows()} == {1}
        assert rec["robot"].info.count == 3000


def test_two_recorders_at_once_are_two_runs(tmp_path: Path) -> None:
    with Recorder(tmp_path) as first, Recorder(tmp_path) as second:
        first.topic("robot").append(who="first", _ts=1.0)
        second.topic("robot").append(who="second", _ts=1.5)
        first.flush()
        second.flush()
        with Recording(tmp_path) as rec:
            assert {run.id: run.status for run in rec.runs} == {first.session: "recording", second.session: "recording"}
        with Recording(tmp_path, run=second.session) as rec:
            assert [row["who"] for row in rec["robot"].rows()] == ["second"]


def test_a_chosen_run_grows_and_others_stay_out(tmp_path: Path) -> None:
    options = RecorderOptions(segment_duration_s=0.01)
    with Recorder(tmp_path) as other, Recorder(tmp_path, options) as mine:
        mine.topic("robot").append(n=0, _ts=0.0)
        mine.flush()
        with Recording(tmp_path, run=mine.session) as rec:
            for n in range(1, 5):
                time.sleep(0.02)
                mine.topic("robot").append(n=n, _ts=float(n))
                other.topic("robot").append(n=-1, _ts=n + 0.5)
                mine.flush()
                other.flush()
                assert rec.refresh()
                assert [row["n"] for row in rec["robot"].rows()] == list(range(n + 1))
            assert len(rec.segments) > 1


def test_runs_say_how_they_ended(tmp_path: Path) -> None:
    record(tmp_path, 0)
    exp = Experiment("a/b", root=tmp_path).run.start()
    exp.tracks("robot").append(run=1, _ts=100.0)
    exp.run.fail(ZeroDivisionError("division by zero"))
    program = """
        import os, sys, time
        from ml_dash_mcap import Experiment
        exp = Experiment("a/b", root=sys.argv[1]).run.start()
        exp.tracks("robot").append(run=2, _ts=200.0)
        print("done", flush=True)
        time.sleep(60)
    """
    arguments = [sys.executable, "-c", textwrap.dedent(program), str(tmp_path)]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as child:
        assert child.stdout is not None and child.stdout.readline() == "done\n"
        os.kill(child.pid, signal.SIGKILL)
    with Experiment("a/b", root=tmp_path).run as exp:
        exp.tracks("robot").append(run=3, _ts=300.0)
        exp.flush()
        with Recording(exp.path) as rec:
            found = rec.runs
    assert [run.status for run in found] == ["completed", "failed", "died", "recording"]
    assert [run.end for run in found] == [0.9, 100.0, 200.0, 300.0]
    with Recording(tmp_path / "a/b", run=2) as rec:
        assert [row["run"] for row in rec["robot"].rows()] == [2]
        assert rec.run["status"] == "running"


def test_a_session_is_a_run(tmp_path: Path) -> None:
    for number in range(2):
        with Session(name="demo", workspace="robotics", local_path=tmp_path) as session:
            session.track("robot").append(n=number, _ts=float(number))
    with Recording(session.path) as rec:
        assert [dict(run.counts) for run in rec.runs] == [{"robot": 1}, {"robot": 1}]


def test_one_run_is_converted(tmp_path: Path, runs: list[str]) -> None:
    convert(tmp_path / "a/b", tmp_path / "rows.jsonl", format="jsonl", run=1, topics=["robot"])
    (written,) = [path for path in (tmp_path / "rows.jsonl").rglob("*") if path.is_file()] or [tmp_path / "rows.jsonl"]
    assert [json.loads(line)["run"] for line in written.read_text().splitlines()] == [1] * 9


# When a run begins


def test_a_run_that_begins_where_a_simulated_one_is_says_so(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    record(tmp_path, 0)
    with caplog.at_level(logging.WARNING):
        exp = Experiment("a/b", root=tmp_path)
        exp.run.start()
        warned = [one.getMessage() for one in caplog.records]
        exp.run.complete()
    assert len(warned) == 1
    assert str(exp.path) in warned[0]
    assert "on a clock of its own (up to 0.9 s)" in warned[0]
    assert "Recording(path, run=...)" in warned[0]


def test_a_run_of_logs_only_does_not_hide_the_simulated_one_before_it(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    record(tmp_path, 0)
    logging.getLogger("ml_dash_mcap").setLevel(logging.ERROR)
    for _ in range(2):
        with Experiment("a/b", root=tmp_path).run as exp:
            exp.log("nothing moved")
    logging.getLogger("ml_dash_mcap").setLevel(logging.NOTSET)
    with caplog.at_level(logging.WARNING), Recorder(tmp_path / "a/b"):
        pass
    assert ["on a clock of its own (up to 0.9 s)" in one.getMessage() for one in caplog.records] == [True]


def test_a_run_after_a_recording_that_was_played_back_says_so(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    yesterday = float(int(time.time()) - 86_400)
    with Recorder(tmp_path) as recorder:
        recorder.topic("robot").append(n=1, _ts=yesterday)
    with caplog.at_level(logging.WARNING), Recorder(tmp_path):
        pass
    assert [f"(up to {yesterday:.0f} s)" in one.getMessage() for one in caplog.records] == [True]


def test_a_run_after_one_that_was_killed_says_so_too(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    program = (
        "import os; from ml_dash_mcap import Recorder;"
        f" Recorder({str(tmp_path)!r}).topic('a').append(x=1, _ts=2.5); os.kill(os.getpid(), 9)"
    )
    assert subprocess.run([sys.executable, "-c", program]).returncode == -signal.SIGKILL
    with caplog.at_level(logging.WARNING), Recorder(tmp_path):
        pass
    assert ["on a clock of its own (up to 2.5 s)" in one.getMessage() for one in caplog.records] == [True]


def test_the_warning_is_seen_without_any_set_up(tmp_path: Path) -> None:
    program = f"from ml_dash_mcap import Recorder; Recorder({str(tmp_path)!r}).topic('a').append(x=1, _ts=0.0)"
    first, second = (
        subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True) for _ in range(2)
    )
    assert "holds a run already" not in first.stderr
    assert "holds a run already" in second.stderr


@pytest.mark.parametrize("kind", ["wall clock", "empty", "foreign", "damaged"])
def test_a_run_after_one_that_it_cannot_meet_says_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, kind: str
) -> None:
    if kind == "foreign":
        save(tmp_path / "a.mcap", [{"robot": [{"_ts": 0.0}]}], library="someone else", kinds={"robot": None})
        if "run" in (disk.metadata(tmp_path, "ml_dash") or [{}])[0]:
            pytest.skip("the file says that it is ours")
    else:
        with Recorder(tmp_path) as recorder:
            if kind == "wall clock":
                recorder.topic("robot").append(n=1, _ts=time.time())
    if kind == "damaged":
        (path,) = tmp_path.glob("*.mcap")
        path.rename(tmp_path / "a.mcap")
        (tmp_path / "b.mcap").write_bytes(b"no mcap")
    with caplog.at_level(logging.WARNING), Recorder(tmp_path):
        pass
    if kind == "damaged":
        (tmp_path / "b.mcap").unlink()
    assert caplog.records == []


# On the command line


def test_the_command_line_lists_runs_and_reads_one(
    tmp_path: Path, runs: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = str(tmp_path / "a/b")
    assert main(["info", folder, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert [(run["id"], run["status"], run["counts"]["robot"]) for run in facts["runs"]] == [
        (name, "completed", 10 - number) for number, name in enumerate(runs)
    ]
    assert main(["info", folder]) == 0
    shown = capsys.readouterr().out
    assert all(name in shown for name in runs)
    for wanted in ("-1", runs[2]):
        assert main(["cat", folder, "robot", "--run", wanted, "--format", "jsonl"]) == 0
        rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
        assert [row["run"] for row in rows] == [2] * 8
    assert main(["info", folder, "--run", "0"]) == 0
    assert runs[1] not in capsys.readouterr().out
    assert main(["info", folder, "--run", "nope"]) == 1
    assert runs[0] in capsys.readouterr().err
