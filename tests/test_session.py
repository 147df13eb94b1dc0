"""A Session: dreamlake's words, and what lies on the disk afterwards."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ml_dash_mcap.errors import FieldError, OptionError, PrefixError
from ml_dash_mcap.session import Session
from tests.support import disk


def session(root: Path, **given: Any) -> Session:
    return Session(name="demo", workspace="robotics", local_path=root, **given)


# The life of a session


def test_what_was_appended_in_a_session_is_on_the_disk_afterwards(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        opened.track("loss").append(value=0.5, epoch=1, _ts=1.0)
    assert disk.rows(tmp_path / "robotics" / "demo")["loss"] == [{"value": 0.5, "epoch": 1, "_ts": 1.0}]


def test_the_default_folder_is_dot_dreamlake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert Session("demo", "robotics").path == tmp_path / ".dreamlake" / "robotics" / "demo"


def test_a_session_can_be_opened_and_closed_by_calls_and_more_than_once(tmp_path: Path) -> None:
    opened = session(tmp_path)
    for ts in (0.0, 1.0):
        assert opened.open() is opened
        assert opened.open() is opened
        opened.track("loss").append(value=ts, _ts=ts)
        opened.close()
        opened.close()
    assert disk.counts(opened.path) == {"loss": 2}
    assert [record["status"] for record in disk.metadata(opened.path, "ml_dash.run")] == ["running", "completed"] * 2


def test_an_exception_in_the_body_keeps_the_rows_and_goes_on(tmp_path: Path) -> None:
    opened = session(tmp_path)
    with pytest.raises(ZeroDivisionError), opened:
        _ = opened.track("loss").append(value=1.0), 1 / 0
    assert disk.counts(opened.path) == {"loss": 1}
    assert disk.metadata(opened.path, "ml_dash.run")[-1]["status"] == "failed"


@pytest.mark.parametrize(
    ("what", "touch"),
    [
        ("track", lambda opened: opened.track("loss")),
        ("tracks", lambda opened: opened.tracks),
        ("parameters", lambda opened: opened.parameters()),
        ("log", lambda opened: opened.log("hello")),
        ("files", lambda opened: opened.files()),
        ("file", lambda opened: opened.file()),
        ("stats", lambda opened: opened.stats()),
    ],
)
def test_a_closed_session_says_so(tmp_path: Path, what: str, touch: Callable[[Session], object]) -> None:
    opened = session(tmp_path)
    for _ in range(2):
        with pytest.raises(RuntimeError) as caught:
            touch(opened)
        assert str(caught.value) == (
            f"Cannot use {what} on closed session. Use 'with Session(...) as session:' or call session.open() first."
        )
        with opened:
            touch(opened)


def test_a_track_of_a_closed_session_takes_and_gives_nothing(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        track = opened.track("loss").append(value=1.0)
    for call in (
        lambda: track.append(value=2.0),
        lambda: track.append_batch([{"value": 2.0}]),
        track.flush,
        track.read,
    ):
        with pytest.raises(RuntimeError, match="closed"):
            call()
    assert disk.counts(opened.path) == {"loss": 1}


def test_a_remote_address_is_refused_with_the_reason(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="recorded to local files"):
        session(tmp_path, remote="http://localhost:3000")


def test_an_unknown_argument_is_a_type_error(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="unknown argument folder="):
        session(tmp_path, folder="/experiments")


@pytest.mark.parametrize(
    ("name", "workspace"), [("", "w"), ("n", ""), ("../n", "w"), ("n", ".."), ("/n", "w"), ("n", "/w")]
)
def test_a_name_that_leaves_the_folder_is_refused(tmp_path: Path, name: str, workspace: str) -> None:
    with pytest.raises(PrefixError, match=r"name=|workspace="):
        Session(name, workspace, local_path=tmp_path)


def test_what_is_said_about_a_session_is_in_the_first_metadata_record(tmp_path: Path) -> None:
    with session(tmp_path, description="a demo", tags=["x"], metadata={"a": 1}) as opened:
        opened.track("loss").append(value=1.0)
    record = disk.metadata(opened.path, "ml_dash")[0]
    assert (record["prefix"], record["description"], record["tags"], record["metadata"]) == (
        "robotics/demo",
        "a demo",
        '["x"]',
        '{"a": 1}',
    )


# Time stamps


def test_time_stamps_left_out_are_the_wall_clock_and_never_the_same(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        before = time.time()
        for value in range(1000):
            opened.track("loss").append(value=value)
        after = time.time()
    times = [row["_ts"] for row in disk.rows(opened.path)["loss"]]
    assert len(set(times)) == 1000
    assert times == sorted(times)
    assert before <= times[0] <= times[-1] <= after + 0.001


def test_none_means_left_out(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        opened.track("loss").append(value=1.0, _ts=None)
    assert disk.rows(opened.path)["loss"][0]["_ts"] > 1e9


def test_minus_one_is_the_last_time_stamp_used_on_any_track_by_any_thread(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        opened.track("pose").append(x=1.0, _ts=5.0)
        thread = threading.Thread(target=lambda: opened.track("pose").append(x=2.0, _ts=7.0))
        thread.start()
        thread.join()
        opened.track("image").append(frame=0, _ts=-1)
        opened.track("image").append(frame=1, _ts=-1.0)
    assert disk.merged(opened.path)["image"] == {7.0: {"frame": 1, "_ts": 7.0}}


def test_minus_one_before_any_other_is_the_wall_clock(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        opened.track("image").append(frame=0, _ts=-1)
    assert disk.rows(opened.path)["image"][0]["_ts"] > 1e9


@pytest.mark.parametrize("ts", ["abc", "1.5", [1.0], True, object()])
def test_a_time_stamp_that_is_no_number_is_a_value_error(tmp_path: Path, ts: object) -> None:
    with session(tmp_path) as opened, pytest.raises(ValueError, match=r"_ts must be a number \(seconds since epoch\)"):
        opened.track("loss").append(value=1.0, _ts=ts)


@pytest.mark.parametrize("ts", [float("nan"), float("inf"), -0.5, -2])
def test_a_time_stamp_that_mcap_cannot_say_is_a_value_error(tmp_path: Path, ts: float) -> None:
    with session(tmp_path) as opened, pytest.raises(ValueError, match="'loss'"):
        opened.track("loss").append(value=1.0, _ts=ts)


def test_a_field_may_be_called_timestamp(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        opened.track("system").append(cpu=45.2, timestamp=123.0, _ts=1.0)
        assert opened.track("system").read()["data"][0]["data"] == {"timestamp": 123.0, "cpu": 45.2, "_ts": 1.0}


# The rest of dreamlake's words


def test_parameters_and_logs_and_figures(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        opened.parameters().set(model={"lr": 0.001}, batch_size=32)
        assert opened.parameters().get() == {"model.lr": 0.001, "batch_size": 32}
        opened.log("Starting", metadata={"a": 1}, b=2)
        fluent = opened.log(metadata={"epoch": 1})
        assert fluent is not None
        fluent.warn("High loss", loss=1.5)
        with pytest.raises(FieldError, match="Invalid log level: 'nope'"):
            opened.log("x", level="nope")
        assert opened.stats()["dropped"] == 0
    logged = disk.rows(opened.path)["ml_dash/log"]
    assert [(row["level"], row["message"], row["metadata"]) for row in logged] == [
        (2, "Starting", {"a": 1, "b": 2}),
        (3, "High loss", {"epoch": 1, "loss": 1.5}),
    ]


def test_a_session_shows_its_name_and_whether_it_is_open(tmp_path: Path) -> None:
    opened = session(tmp_path)
    assert repr(opened) == "<Session 'robotics/demo', closed>"
    with opened:
        assert repr(opened) == "<Session 'robotics/demo', open>"
