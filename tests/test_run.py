"""The life of a run: started, ended, started again, and what it leaves when things go wrong."""

from __future__ import annotations

import asyncio
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ml_dash_mcap import Recording, Session, recordings
from ml_dash_mcap.errors import DamagedFileError, StateError, StorageError, UsageError
from ml_dash_mcap.experiment import Experiment
from ml_dash_mcap.run.live import Live, Status
from ml_dash_mcap.run.tracks import Track
from tests.support import disk
from tests.support.case_ids import stable_repr

PREFIX = "alice/franka/demo"


def experiment(root: Path, **given: Any) -> Experiment:
    return Experiment(PREFIX, root=root, **given)


def test_what_was_appended_in_a_run_is_on_the_disk_afterwards(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        for step in range(100):
            exp.tracks("robot").append(q=[0.1, 0.2], gripper=0.04, _ts=step / 30.0)
    found = disk.rows(tmp_path / PREFIX)["robot"]
    assert found == [{"q": [0.1, 0.2], "gripper": 0.04, "_ts": step / 30.0} for step in range(100)]


def test_the_run_says_in_the_file_that_it_ran_and_was_completed(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        assert repr(exp) == "<Experiment 'alice/franka/demo', running>"
    assert exp.run.status == "completed"
    assert [record["status"] for record in disk.metadata(exp.path, "ml_dash.run")] == ["running", "completed"]


def test_an_exception_in_the_body_marks_the_run_failed_keeps_its_rows_and_goes_on(tmp_path: Path) -> None:
    exp = experiment(tmp_path)
    with pytest.raises(ZeroDivisionError), exp.run:
        _ = exp.tracks("robot").append(q=1.0, _ts=0.0), 1 / 0
    assert exp.run.status == "failed"
    assert disk.counts(exp.path) == {"robot": 1}
    last = disk.metadata(exp.path, "ml_dash.run")[-1]
    assert (last["status"], last["error"]) == ("failed", "ZeroDivisionError: division by zero")


class Cancelled(BaseException):
    """Stands for what trio and others cancel a task with."""


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (KeyboardInterrupt(), "cancelled"),
        (asyncio.CancelledError(), "cancelled"),
        (GeneratorExit(), "cancelled"),
        (Cancelled(), "cancelled"),
        (SystemExit(), "completed"),
        (SystemExit(0), "completed"),
        (SystemExit(2), "failed"),
        (SystemExit("no robot"), "failed"),
        (ConnectionError("gone"), "failed"),
    ],
    ids=stable_repr,
)
@pytest.mark.parametrize("api", ["experiment", "session"])
def test_what_leaves_the_body_says_how_the_run_ended_and_goes_on(
    tmp_path: Path, api: str, error: BaseException, status: str
) -> None:
    def record() -> None:
        if api == "experiment":
            with experiment(tmp_path).run as exp:
                exp.tracks("robot").append(q=1.0, _ts=0.0)
                raise error
        with Session("demo", "alice/franka", local_path=tmp_path) as session:
            session.track("robot").append(q=1.0, _ts=0.0)
            raise error

    with pytest.raises(type(error)) as caught:
        record()
    assert caught.value is error
    last = disk.metadata(tmp_path / PREFIX, "ml_dash.run")[-1]
    assert (last["status"], "error" in last) == (status, status == "failed")
    assert disk.counts(tmp_path / PREFIX) == {"robot": 1}
    assert [entry.status for entry in recordings(tmp_path)] == [status]


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGINT for another process")
def test_ctrl_c_on_a_running_program_leaves_a_cancelled_run_with_all_its_rows(tmp_path: Path) -> None:
    program = f"""
import itertools, signal
from ml_dash_mcap import Experiment

signal.signal(signal.SIGINT, signal.default_int_handler)
with Experiment({PREFIX!r}, root={str(tmp_path)!r}).run as exp:
    for step in itertools.count():
        exp.tracks("robot").append(q=[0.1, 0.2], _ts=step / 1000)
        if step == 1000:
            print("recording", flush=True)
"""
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "recording\n"
        child.send_signal(signal.SIGINT)
        _, said = child.communicate(timeout=60)
    assert said.rstrip().endswith("KeyboardInterrupt")
    assert disk.metadata(tmp_path / PREFIX, "ml_dash.run")[-1]["status"] == "cancelled"
    times = [row["_ts"] for row in disk.rows(tmp_path / PREFIX)["robot"]]
    assert len(times) > 1000
    assert times == [step / 1000 for step in range(len(times))]


def test_ctrl_c_in_an_episode_says_nothing_of_its_success(tmp_path: Path) -> None:
    def record() -> None:
        with experiment(tmp_path).run as exp, exp.episode(task="pick"):
            exp.tracks("robot").append(q=1.0, _ts=0.0)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record()
    with Recording(tmp_path / PREFIX) as recording:
        assert [(one.task, one.success) for one in recording.episodes] == [("pick", None)]


def test_an_experiment_in_a_with_statement_says_to_use_its_run(tmp_path: Path) -> None:
    exp = experiment(tmp_path)
    with pytest.raises(UsageError, match=r"with Experiment\('alice/franka/demo'\)\.run as exp:") as caught, exp:
        pytest.fail("the body must not run")
    assert isinstance(caught.value, TypeError), "what Python itself raises there"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("end", "status"), [("complete", "completed"), ("fail", "failed"), ("cancel", "cancelled")])
def test_a_run_can_be_started_and_ended_by_calls(tmp_path: Path, end: str, status: str) -> None:
    exp = experiment(tmp_path)
    assert exp.run.start() is exp
    exp.tracks("robot").append(q=1.0, _ts=0.0)
    getattr(exp.run, end)()
    assert exp.run.status == status
    assert disk.metadata(exp.path, "ml_dash.run")[-1]["status"] == status
    assert disk.counts(exp.path) == {"robot": 1}


def test_the_first_end_of_a_run_counts(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        exp.run.cancel()
    exp.run.fail()
    assert exp.run.status == "cancelled"
    assert [record["status"] for record in disk.metadata(exp.path, "ml_dash.run")] == ["running", "cancelled"]


def test_starting_a_started_run_changes_nothing(tmp_path: Path) -> None:
    exp = experiment(tmp_path)
    exp.run.start()
    track = exp.tracks("robot")
    assert exp.run.start().tracks("robot") is track
    exp.run.complete()
    assert len(disk.segments(exp.path)) == 1


def test_starting_an_ended_run_adds_to_it(tmp_path: Path) -> None:
    exp = experiment(tmp_path)
    for start in (0.0, 10.0):
        with exp.run:
            exp.tracks("robot").append(q=start, _ts=start)
            seen = exp.tracks("robot").read()["count"]
    assert seen == 2
    assert [row["_ts"] for row in disk.rows(exp.path)["robot"]] == [0.0, 10.0]


def test_another_experiment_of_the_same_prefix_adds_to_it(tmp_path: Path) -> None:
    for start in (0.0, 10.0):
        with experiment(tmp_path).run as exp:
            exp.tracks("robot").append(q=start, _ts=start)
    assert disk.counts(exp.path) == {"robot": 2}


def test_a_damaged_file_of_an_earlier_run_keeps_no_run_from_starting(tmp_path: Path) -> None:
    folder = tmp_path / PREFIX
    folder.mkdir(parents=True)
    (folder / "20200101T000000.000000Z_000001.mcap").write_bytes(b"this is no MCAP file")
    with experiment(tmp_path).run as exp:
        exp.tracks("robot").append(q=1.0, _ts=0.0)
        exp.params.set(lr=0.1)
        with pytest.raises(DamagedFileError, match="20200101T000000"):
            exp.params.get()
        with pytest.raises(DamagedFileError, match="20200101T000000"):
            exp.tracks("robot").read()
    (folder / "20200101T000000.000000Z_000001.mcap").unlink()
    assert disk.counts(exp.path) == {"robot": 1}


def test_ending_a_run_that_never_started_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(StateError, match="never started"):
        experiment(tmp_path).run.complete()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "touch",
    [
        lambda exp: exp.tracks,
        lambda exp: exp.metrics,
        lambda exp: exp.params,
        lambda exp: exp.logs,
        lambda exp: exp.files,
        lambda exp: exp.log("hello"),
        lambda exp: exp.flush(),
        lambda exp: exp.stats(),
    ],
)
def test_an_experiment_that_is_not_started_says_so(tmp_path: Path, touch: Callable[[Experiment], object]) -> None:
    with pytest.raises(RuntimeError) as caught:
        touch(experiment(tmp_path))
    expected = "Experiment not started. Use 'with experiment.run:' or call experiment.run.start() first."
    assert str(caught.value) == expected


def test_an_experiment_that_has_ended_says_how_to_go_on(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        track = exp.tracks("robot").append(q=1.0, _ts=0.0)
        metric = exp.metrics("train").log(loss=0.5)
    with pytest.raises(StateError, match=r"has ended \(completed\)\. Recording\(.*demo.*\) reads it"):
        _ = exp.tracks
    for call in (track.read, track.flush, track.list_entries, metric.read, metric.stats):
        with pytest.raises(StateError, match="closed"):
            call()
    with pytest.raises(StateError, match="closed"):
        track.append(q=2.0, _ts=1.0)


def test_an_error_while_closing_does_not_replace_the_body_s_exception(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    exp = experiment(tmp_path)
    end = Live.end

    def end_and_fail(live: Live[Track], status: Status, error: BaseException | None = None) -> None:
        end(live, status, error)
        raise StorageError("no space")

    monkeypatch.setattr(Live, "end", end_and_fail)
    with pytest.raises(KeyError) as caught, exp.run:
        raise KeyError("body")
    assert "also failed: StorageError: no space" in caplog.text
    assert "no space" in "".join(getattr(caught.value, "__notes__", ["no space"]))
    with pytest.raises(StorageError, match="no space"), exp.run:
        pass
