"""The recordings below a folder, and how each stands."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from ml_dash_mcap import Experiment, Recorder, Recording, Session, recordings
from ml_dash_mcap.catalog import CatalogEntry, is_recording
from ml_dash_mcap.errors import MissingRecordingError
from tests.support.files import save

ROOT = Path(__file__).resolve().parent.parent
ROW = [{"n": 1, "_ts": 0.0}, {"n": 2, "_ts": 2.5}]


def status(root: Path) -> dict[str, str]:
    return {entry.path.relative_to(root).as_posix(): entry.status for entry in recordings(root)}


def test_an_entry_says_what_is_known_at_a_glance(tmp_path: Path) -> None:
    first = save(tmp_path / "run/a.mcap", [{"arm": ROW, "ml_dash/log": ROW}])
    second = save(tmp_path / "run/b.mcap", [{"cam": [{"_ts": 3.0}]}])
    size = first.stat().st_size + second.stat().st_size
    (entry,) = recordings(tmp_path)
    assert entry == CatalogEntry(tmp_path / "run", "finished", 0.0, 3.0, topics=2, files=2, bytes=size)
    assert entry.duration == 3.0


def test_recordings_come_by_path_hidden_folders_and_other_files_left_out(tmp_path: Path) -> None:
    for name in ("b/two", "a", "b/one", ".hidden", "b/one/deeper"):
        save(tmp_path / name / "a.mcap", [{"arm": ROW}])
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes/x.txt").touch()
    assert list(status(tmp_path)) == ["a", "b/one", "b/one/deeper", "b/two"]


def test_the_folders_that_runs_are_recorded_to_by_default_are_not_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with Experiment("alice/franka/demo").run as exp:
        exp.tracks("arm").append(**ROW[0])
    with Session("demo", "robotics") as session:
        session.track("arm").append(**ROW[0])
    save(tmp_path / "lab/.dash/bob/ur5/demo/a.mcap", [{"arm": ROW}])
    save(tmp_path / ".git/a.mcap", [{"arm": ROW}])
    wanted = [".dash/alice/franka/demo", ".dreamlake/robotics/demo", "lab/.dash/bob/ur5/demo"]
    assert list(status(tmp_path)) == wanted
    assert [str(entry.path) for entry in recordings(".")] == wanted
    with pytest.raises(MissingRecordingError, match=r"below it: \.dash/alice/franka/demo, \.dreamlake/robotics/demo"):
        Recording(tmp_path)


def test_a_status_is_how_the_run_ended_or_that_it_has_not(tmp_path: Path) -> None:
    with Experiment("good", root=tmp_path).run as exp:
        exp.tracks("arm").append(**ROW[0])
    with pytest.raises(ZeroDivisionError), Experiment("bad", root=tmp_path).run as exp:
        exp.tracks("arm").append(n=1 / 0, _ts=0.0)
    save(tmp_path / "plain/a.mcap", [{"arm": ROW}])
    save(tmp_path / "cut/a.mcap.active", [{"arm": ROW}])
    with Recorder(tmp_path / "alive") as recorder:
        recorder.topic("arm").append(**ROW[0])
        recorder.flush()
        wanted = {"alive": "recording", "bad": "failed", "cut": "unfinished", "good": "completed", "plain": "finished"}
        assert status(tmp_path) == wanted


def test_a_run_whose_process_was_killed_has_died_and_is_recovered(tmp_path: Path) -> None:
    child = f"""
import os, signal
from ml_dash_mcap import Experiment
exp = Experiment("run", root={str(tmp_path)!r}).run.start()
exp.tracks("arm").append(n=1, _ts=0.5)
os.kill(os.getpid(), signal.SIGKILL)
"""
    done = subprocess.run([sys.executable, "-c", child], env={**os.environ, "PYTHONPATH": str(ROOT)}, timeout=60)
    assert done.returncode == -signal.SIGKILL
    (entry,) = recordings(tmp_path)
    assert (entry.status, entry.topics, entry.start) == ("died", 1, 0.5)


def test_a_recorder_without_rows_yet_is_recording(tmp_path: Path) -> None:
    with Recorder(tmp_path / "run"):
        assert status(tmp_path) == {"run": "recording"}


def test_what_cannot_be_read_is_listed_with_what_is_wrong(tmp_path: Path) -> None:
    save(tmp_path / "good/a.mcap", [{"arm": ROW}])
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad/a.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(50))
    bad, good = recordings(tmp_path)
    assert (bad.status, good.status) == ("damaged", "finished")
    assert bad.problem


def test_a_folder_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(MissingRecordingError, match="no folder here"):
        recordings(tmp_path / "nowhere")


def test_a_recording_is_a_file_or_a_folder_with_mcap_files(tmp_path: Path) -> None:
    path = save(tmp_path / "run/a.mcap.active", [{"arm": ROW}])
    assert is_recording(path)
    assert is_recording(tmp_path / "run")
    assert not is_recording(tmp_path)
    assert not is_recording(tmp_path / "nowhere")
