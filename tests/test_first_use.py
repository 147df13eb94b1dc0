"""What somebody tries in the first hour: paths as they come, mistakes that all make, and what they get to read."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import ml_dash_mcap
from ml_dash_mcap import Experiment, Recorder, Recording, Session, convert, errors, recordings, recover
from ml_dash_mcap.cli import main
from tests.support.case_ids import stable_repr


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder that is the home folder too, with a run recorded to where runs go by default."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    with Experiment("alice/franka/demo").run as exp:
        for step in range(10):
            exp.tracks("robot").append(q=[0.1, 0.2], _ts=step / 10)
    with Session("demo", "robotics") as session:
        session.track("arm").append(q=1.0)
    return tmp_path


def message(error: type[Exception], call: Callable[[], object]) -> str:
    with pytest.raises(error) as caught:
        call()
    return str(caught.value)


RUN = ".dash/alice/franka/demo"


def test_a_run_opens_by_every_way_to_its_folder(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wanted = list(Recording(home / RUN)["robot"].rows())
    for path in (RUN, f"{RUN}/", f"~/{RUN}", Path(f"~/{RUN}"), f"./{RUN}/../demo"):
        with Recording(path) as rec:
            assert list(rec["robot"].rows()) == wanted
    monkeypatch.chdir(home / RUN)
    with Recording(".") as rec:
        assert list(rec["robot"].rows()) == wanted
    monkeypatch.chdir(home / RUN / "..")
    with Recording("demo") as rec:
        assert list(rec["robot"].rows()) == wanted


def test_home_is_home_for_every_path(home: Path) -> None:
    with Recording(f"~/{RUN}") as rec:
        assert rec.export("~/out/robot.csv") == home / "out/robot.csv"
    assert convert(f"~/{RUN}", "~/out/robot.parquet") == home / "out/robot.parquet"
    assert (home / "out/robot.csv").exists()
    assert (home / "out/robot.parquet").exists()
    assert [entry.path for entry in recordings("~/.dash")] == [home / RUN]
    assert recover("~/.dash").left == []
    assert not (home / "~").exists()


def test_a_prefix_in_place_of_a_path_is_answered_with_the_path(home: Path) -> None:
    assert f"did you mean '{RUN}'?" in message(FileNotFoundError, lambda: Recording("alice/franka/demo"))
    assert "did you mean '.dreamlake/robotics/demo'?" in message(FileNotFoundError, lambda: Recording("robotics/demo"))
    assert "did you mean" not in message(FileNotFoundError, lambda: Recording("bob/franka/demo"))


@pytest.mark.parametrize("given", [5, None, 1.5, b"run", {"path": "run"}.items], ids=stable_repr)
def test_what_is_no_path_is_refused_with_what_to_pass(home: Path, given: Any) -> None:
    calls: dict[str, Callable[[], object]] = {
        "path=": lambda: recover(given),
        "src=": lambda: convert(given, "out"),
        "dest=": lambda: convert(RUN, given),
        "root=": lambda: recordings(given),
    }
    for name, call in calls.items():
        said = message(errors.UsageError, call)
        assert said.startswith(name) and "pass a path" in said
    assert "pass a path" in message(errors.UsageError, lambda: Recording(given))
    with Recording(RUN) as rec:
        assert message(errors.UsageError, lambda: rec.export(given)).startswith("dest=")


def test_limits_that_are_none_are_refused_with_what_to_pass(home: Path) -> None:
    for limits in (5, {"chunk_bytes": 5}):
        assert "pass Limits(...)" in message(errors.UsageError, lambda limits=limits: Recording(RUN, limits=limits))  # type: ignore[misc]


def test_a_file_for_text_is_refused_where_bytes_are_written(home: Path) -> None:
    with Recording(RUN) as rec:
        assert "sys.stdout.buffer" in message(TypeError, lambda: rec["robot"].write(io.StringIO()))  # type: ignore[arg-type]
        out = io.BytesIO()
        rec["robot"].write(out, end=0.0)
        assert out.getvalue() == b'{"_ts":0.0,"q":[0.1,0.2]}\n'


def test_one_row_in_place_of_a_list_is_refused_with_what_to_write(home: Path) -> None:
    row = {"q": 1.0, "_ts": 1.0}
    with Recorder("new") as recorder, Session("other", "robotics") as session:
        for batch in (recorder.topic("robot").append_batch, session.track("robot").append_batch):
            assert "one row is append(**row)" in message(TypeError, lambda batch=batch: batch(row))  # type: ignore[misc]
        assert "append(**row)" in message(TypeError, lambda: recorder.topic("robot").append(row))


def test_a_time_that_is_none_is_called_as_its_argument_is(home: Path) -> None:
    with Recording(RUN) as rec:
        assert message(ValueError, lambda: rec["robot"].at("x")) == "time='x' is not a number of seconds"  # type: ignore[arg-type]


def test_a_name_that_is_not_there_is_refused_with_where_it_was_sought(home: Path) -> None:
    with Recording(RUN) as rec:
        calls: list[Callable[[], object]] = [
            lambda: rec["robt"],
            lambda: rec.topics["robt"],
            lambda: rec.gaps("robt"),
            lambda: rec.check(["robt"]),
            lambda: rec.export("x.csv", topics=["robt"]),
        ]
        for call in calls:
            assert message(KeyError, call).endswith(f"did you mean 'robot'? ({RUN})")
        assert message(KeyError, lambda: rec["robot"].to_arrow(columns=["qq"])).endswith("(topic 'robot')")


@pytest.mark.parametrize("name", ["pandas", "polars"])
def test_a_package_that_is_not_installed_is_answered_with_how_to_install_it(
    home: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, name, None)  # what makes an import fail
    with Recording(RUN) as rec, pytest.raises(ModuleNotFoundError, match=f"pip install {name}") as caught:
        getattr(rec["robot"], f"to_{name}")()
    assert caught.value.name == name


def test_ls_lists_what_lies_below_a_folder_with_a_file_in_it(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with Recording(RUN) as rec:
        (home / "window.mcap").write_bytes(rec["robot"].read(format="mcap"))
        bag = rec.export("bag", format="rosbag2", storage="sqlite3")
    assert main(["ls"]) == 0
    said = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [line[:2] for line in said[1:]] == [
        [".", "finished"],
        [RUN, "completed"],
        [".dreamlake/robotics/demo", "completed"],
    ]
    for path in (RUN, "window.mcap", str(bag)):
        assert main(["ls", path]) == 0
        assert capsys.readouterr().out.splitlines()[1].split()[:2] == ["robot", "10"]


def test_info_says_that_a_run_died_which_nobody_ended(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    exp = Experiment("alice/franka/demo", root=tmp_path)
    exp.run.start().tracks("robot").append(q=1.0, _ts=0.0)
    exp.flush()
    assert main(["info", str(exp.path)]) == 0
    assert "status: recording" in capsys.readouterr().out
    assert exp.run.live is not None
    exp.run.live.recorder.close()  # what the end of the process does
    assert main(["info", str(exp.path)]) == 0
    assert "status: died" in capsys.readouterr().out


def test_every_error_and_warning_can_be_imported_from_the_package() -> None:
    for name, one in vars(errors).items():
        if isinstance(one, type) and one.__module__ == errors.__name__:
            assert getattr(ml_dash_mcap, name) is one
            assert name in ml_dash_mcap.__all__
    assert sorted(ml_dash_mcap.__all__) == ml_dash_mcap.__all__
    assert set(ml_dash_mcap.__all__) <= set(dir(ml_dash_mcap))
    with pytest.raises(AttributeError, match="Recordng"):
        ml_dash_mcap.Recordng  # noqa: B018
