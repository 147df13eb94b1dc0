"""Whatever a user can hold says what it is when it is shown."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

import pytest

from ml_dash_mcap import Experiment, Recorder, Recording, Session, recordings, recover
from tests.test_docs import CLASSES


@pytest.fixture
def exp(tmp_path: Path) -> Iterator[Experiment]:
    with Experiment("alice/franka/demo", root=tmp_path).run as exp:
        yield exp


@pytest.mark.parametrize(
    "cls",
    [cls for cls in CLASSES if not issubclass(cls, BaseException) and Protocol not in cls.__bases__],
    ids=lambda cls: cls.__name__,
)
def test_no_public_class_is_shown_by_its_address(cls: type) -> None:
    assert cls.__repr__ is not object.__repr__


def test_what_an_experiment_gives_is_shown_with_its_name_and_what_it_holds(tmp_path: Path, exp: Experiment) -> None:
    folder = str(tmp_path / "alice/franka/demo")
    assert repr(exp.run) == "<Run of <Experiment 'alice/franka/demo', running>>"
    assert repr(exp.tracks) == "<Tracks: none yet>"
    assert repr(exp.tracks("robot")) == f"<Track 'robot' in {folder!r}, recording>"
    assert repr(exp.tracks("imu").append(q=1.0, _ts=0.0)) == f"<Track 'imu' in {folder!r}, recording>"
    assert repr(exp.tracks) == "<Tracks: 'robot', 'imu'>"
    assert repr(exp.tracks("imu").slice(0.0, 1.0)) == "TrackSlice('imu', start=0.0, end=1.0)"
    assert repr(exp.params) == "<Parameters: none yet>"
    assert repr(exp.params.set(lr=0.1, model={"layers": [1, 2]})) == "<Parameters: lr=0.1, model.layers=[1, 2]>"
    assert repr(exp.metrics) == "<Metrics: none yet>"
    assert repr(exp.metrics("train").log(loss=0.5)) == "<Metric 'train'>"
    assert repr(exp.metrics) == "<Metrics: 'train'>"
    assert repr(exp.logs) == "<Logs of 'alice/franka/demo'>"
    assert repr(exp.log(camera="left", take=1)) == "<Logs of 'alice/franka/demo', with camera, take>"
    assert repr(exp.files("frames")) == f"<Files 'frames' in {folder + '/files'!r}>"


def test_many_and_long_parameters_are_cut_short(exp: Experiment) -> None:
    exp.params.set({f"p{number}": list(range(1000)) for number in range(100)})
    shown = repr(exp.params)
    assert shown.endswith("and 90 more>")
    assert len(shown) < 600


def test_what_is_closed_says_so(tmp_path: Path) -> None:
    with Experiment("alice/franka/demo", root=tmp_path).run as exp:
        held = [exp.tracks, exp.tracks("robot"), exp.params, exp.metrics("m"), exp.logs, exp.files]
        exp.params.set(lr=0.1)
    assert [repr(one) for one in held][2] == "<Parameters: lr=0.1>"
    assert repr(held[1]).endswith(", closed>")
    assert repr(exp.run) == "<Run of <Experiment 'alice/franka/demo', completed>>"


def test_what_a_session_gives_is_shown_with_its_name(tmp_path: Path) -> None:
    with Session("demo", "robotics", local_path=tmp_path) as session:
        folder = str(tmp_path / "robotics/demo")
        assert repr(session.track("arm").append(q=1.0)) == f"<SessionTrack 'arm' in {folder!r}, recording>"
        assert repr(session.tracks) == "<Tracks: 'arm'>"
        assert repr(session.files()) == f"<SessionFiles: <Files '.' in {folder + '/files'!r}>>"
        assert repr(session.file(file_path="a.pt", prefix="/m")) == "<SessionFile file_path='a.pt', prefix='/m'>"
        assert repr(session) == "<Session 'robotics/demo', open>"
    assert repr(session) == "<Session 'robotics/demo', closed>"


def test_what_a_recorder_gives_is_shown_with_its_name(tmp_path: Path) -> None:
    with Recorder(tmp_path / "run") as recorder:
        topic = recorder.topic("imu").append(q=1.0, _ts=0.0)
        assert repr(topic) == f"<Topic 'imu' in {str(tmp_path / 'run')!r}, recording>"
        assert repr(recorder) == f"<Recorder {str(tmp_path / 'run')!r}, recording>"
    assert repr(topic) == f"<Topic 'imu' in {str(tmp_path / 'run')!r}, closed>"
    assert repr(recorder) == f"<Recorder {str(tmp_path / 'run')!r}, closed>"


def test_nothing_that_a_recording_gives_is_shown_by_its_address(tmp_path: Path, exp: Experiment) -> None:
    for step in range(20):
        exp.tracks("robot").append(q=[0.1, 0.2], _ts=step / 10 if step < 10 else step)
    with exp.episode(task="pick") as episode:
        exp.tracks("robot").append(q=[0.1, 0.2], _ts=100.0)
    exp.log("hello")
    exp.metrics("train").log(loss=0.5)
    exp.flush()
    held: list[Any] = [episode, next(recordings(tmp_path)), recover(tmp_path)]
    with Recording(exp.path) as rec:
        properties = [name for name, one in inspect.getmembers(Recording) if isinstance(one, property)]
        held += [
            rec,
            rec["robot"],
            rec.items(),
            rec.check(),
            rec.gaps("robot"),
            *(getattr(rec, name) for name in properties),
        ]
        held += [rec.topics["robot"], rec.topics["robot"].fields, rec.metrics["train"], rec.keys(), rec.values()]
        for one in held:
            assert " at 0x" not in repr(one)
            assert " at 0x" not in str(one)
